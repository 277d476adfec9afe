# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How true a texture is: renders from cameras that were held out of texturing, against their photos.

    python -m evaluation.texture WORKSPACE [--mesh FILE] [--every 8] [--page-size 4096] [--out FOLDER] [--json]

The mesh of the workspace's first component is textured without every n-th view, with and without levelling of the
photos, and rendered from the views left out, at the size of their undistorted pictures. PSNR (dB) and SSIM count the
pixels that show a face which is measured and seen; SSIM's 7x7 window may reach beyond them. The photos' exposure
differs, so both are also given after one gain for each photo and channel, and of a levelled texture as seen through the
photo's lens, whose falloff of light the other photos of its camera told ("matched"). A *seam* is an edge whose two
faces lie in different charts; its step is the colour difference (CIEDE2000) that one sees across its middle; 1 is just
noticeable. `--out` keeps renders beside photos.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import structural_similarity

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.graphs import connected_components
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Component
from curecon_blender.core.base.sampling import sample
from curecon_blender.core.surface.mesh import Mesh, mesh_file, read_mesh
from curecon_blender.core.surface.triangles import face_neighbours, triangle_areas
from curecon_blender.core.texture.falloff import read_cameras, through_lens
from curecon_blender.core.texture.rendering import matched, psnr, render
from curecon_blender.core.texture.texture import TextureOptions, texture_mesh
from curecon_blender.core.views import record as views_record


@dataclass(frozen=True, kw_only=True)
class TextureErrors:
    """Means over the held-out photos. `psnr` in dB, `ssim` at most 1, both also `matched` in exposure; `covered`, the
    share of the photos' pixels that count; `use`, the share of the pages that faces cover; `below_a_texel`, the share
    of faces smaller than one; `seams`, the share of the edges that are one, and `seam_step`, their median step."""

    level: bool
    psnr: float
    ssim: float
    psnr_matched: float
    ssim_matched: float
    covered: float
    pages: int
    use: float
    below_a_texel: float
    charts: int
    seams: float
    seam_step: float
    filled: float
    seconds: float
    cpu_seconds: float
    peak_memory_gib: float


def evaluate(
    mesh: Mesh, component: Component, workspace: Path, options: TextureOptions, out: Path | None = None
) -> TextureErrors:
    """Texture without `options.exclude`, render from these views and compare with their undistorted pictures."""
    before, start = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        textured = texture_mesh(mesh, component, workspace, options, folder, Reporter())
        seconds, after = time.monotonic() - start, resource.getrusage(resource.RUSAGE_SELF)
        pages, cameras = [images.read_rgb(folder / name) for name in textured.pages], read_cameras(folder)
    assert textured.uv is not None
    areas = triangle_areas(textured.uv)
    use, small = float(areas.sum() / len(pages)), float((areas * pages[0].shape[0] ** 2 < 1).mean())
    charts, seams, step = seam_steps(textured, pages)
    scores = []
    for view in component.views:
        if view.name not in options.exclude:
            continue
        photo = images.read_rgb(workspace / view.image)
        picture, _, shown = render(textured, pages, view)
        counted = (shown >= 0) & textured.recorded[np.maximum(shown, 0)]
        if not counted.any():
            continue
        alike = matched(through_lens(picture, view, cameras), photo, counted)
        scores.append((*_compare(picture, photo, counted), *_compare(alike, photo, counted), counted.mean()))
        if out is not None:
            images.write_jpeg(out / f"{view.name}_{'level' if options.level else 'raw'}.jpg",
                              np.concatenate([picture, photo], axis=1))
    means = np.mean(scores, axis=0) if scores else np.full(5, np.nan)
    return TextureErrors(
        level=options.level, psnr=float(means[0]), ssim=float(means[1]), psnr_matched=float(means[2]),
        ssim_matched=float(means[3]), covered=float(means[4]), pages=len(pages), use=use,
        below_a_texel=small, charts=charts, seams=seams, seam_step=step,
        filled=float(1 - textured.recorded.mean()), seconds=seconds,
        cpu_seconds=after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        peak_memory_gib=after.ru_maxrss / 2**20,
    )


def seam_steps(mesh: Mesh, pages: list[np.ndarray]) -> tuple[int, float, float]:
    """The number of charts, the share of the mesh's inner edges that are seams, and their median step (CIEDE2000)."""
    assert mesh.uv is not None and mesh.page is not None
    neighbours = face_neighbours(mesh.faces)
    face, edge = np.nonzero(neighbours > np.arange(len(mesh.faces))[:, None])
    other = neighbours[face, edge]
    middles = []
    for which, start in ((face, mesh.faces[face, edge]), (other, mesh.faces[face, (edge + 1) % 3])):
        corner = (mesh.faces[which] == start[:, None]).argmax(axis=1)
        middles.append((mesh.uv[which, corner] + mesh.uv[which, (corner + 1) % 3]) / 2)
    apart = (np.abs(middles[0] - middles[1]).max(axis=1) > 1e-6) | (mesh.page[face] != mesh.page[other])
    chart = connected_components(np.stack([face, other], axis=1)[~apart], len(mesh.faces))
    colours = []
    for which, middle in ((face, middles[0]), (other, middles[1])):
        colour = np.zeros((int(apart.sum()), 3), np.float32)
        for number, page in enumerate(pages):
            here = mesh.page[which[apart]] == number
            u, v = middle[apart][here].T
            colour[here] = sample(page, u * page.shape[1], (1 - v) * page.shape[0])
        colours.append(rgb2lab(colour[None] / 255)[0])
    step = float(np.median(deltaE_ciede2000(*colours))) if apart.any() else 0.0
    return int(chart.max(initial=-1)) + 1, float(apart.mean()), step


def _compare(picture: np.ndarray, photo: np.ndarray, counted: np.ndarray) -> tuple[float, float]:
    """PSNR in dB and SSIM over the pixels `counted` (H,W)."""
    _, similarity = structural_similarity(picture, photo, channel_axis=2, full=True)
    return psnr(picture, photo, counted), float(similarity[counted].mean())


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="evaluation.texture", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--mesh", type=Path, help="default: the workspace's mesh.ply")
    parser.add_argument("--every", type=int, default=8, help="hold out every n-th view (default 8)")
    parser.add_argument("--page-size", type=int, default=4096)
    parser.add_argument("--out", type=Path, help="folder for renders beside their photos")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    try:
        component = views_record.read(given.workspace)[0]
        mesh = read_mesh(given.mesh or given.workspace / mesh_file(component.index))
        held_out = tuple(view.name for view in component.views[given.every // 2 :: max(given.every, 2)])
        results = [
            evaluate(mesh, component, given.workspace, TextureOptions(
                page_size=given.page_size, level=level, exclude=held_out), given.out)
            for level in (True, False)
        ]
    except CuReconError as error:
        print(f"{error}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    if given.json:
        print(json.dumps([asdict(result) for result in results]))
        return 0
    print(f"held out: {', '.join(held_out)}")
    for result in results:
        print(f"{'levelled' if result.level else 'not levelled'}: "
              f"PSNR {result.psnr:.2f} dB, SSIM {result.ssim:.3f}; matched in exposure {result.psnr_matched:.2f} dB, "
              f"{result.ssim_matched:.3f}; covered {result.covered:.0%}; "
              f"{result.pages} page(s), {result.use:.0%} used; {result.charts} charts, {result.below_a_texel:.0%} of "
              f"faces below a texel; {result.seams:.1%} of edges are seams, median step {result.seam_step:.2f}; "
              f"filled faces {result.filled:.0%}; {result.seconds:.0f} s, {result.cpu_seconds:.0f} CPU s, "
              f"peak {result.peak_memory_gib:.2f} GiB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
