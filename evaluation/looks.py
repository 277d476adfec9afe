# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a person sees of a surface: the sample site's mesh from places that no photo was taken at, against the truth.

    python -m evaluation.looks WORKSPACE SITE [--mesh FILE] [--out FOLDER] [--json]

SITE/truth/looks holds 24 views: 12 at eye level about the building and in its court, 12 as a drone. The mesh is brought
into the truth's frame by the cameras and drawn from each. Of the pixels that truly show the building: *right* is where
the mesh lies within 10 or 20 cm of the true surface there (the distance along the ray, times the cosine at which the
ray meets the true surface, at least 0.2), *empty* where one sees no mesh, or only what lies more than a metre behind;
*wrong* all else, and *unmarked* what of that is marked neither as filled nor as weak. *Hidden* is what of the empty
lies more than 0.4 m from SITE/truth/cloud.npz, the places that three photos see or more. PSNR (dB) and SSIM of the
colours count the pixels right within 20 cm, after one gain for each channel over all views. The textured mesh is taken
where there is one, else mesh.ply with its vertex colours. `--out` keeps pictures: truth, mesh, and right (grey), wrong
(red), empty (blue).
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree
from skimage.metrics import structural_similarity

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.records import View
from curecon_blender.core.surface.mesh import Mesh, mesh_file, read_mesh, textured_folder
from curecon_blender.core.texture.rendering import psnr, render

from .alignment import align_cameras, read_centres
from .cloud_metrics import read_points

NEAR, NEARER = 0.2, 0.1  # metres: right
BEHIND = 1.0  # metres behind the true surface from which on one looks through a hole
LEAST_COSINE = 0.2
FAR = 0.4  # metres
EYE_LEVEL = 12  # the first views
_ELSEWHERE = 0xFFFF


@dataclass(frozen=True, kw_only=True)
class Looks:
    """Percentages of the building's pixels, and the colours' PSNR and SSIM where right within 20 cm."""

    right_10cm: float
    right_20cm: float
    wrong: float
    unmarked: float
    empty: float
    hidden: float
    psnr: float
    ssim: float


@dataclass(frozen=True)
class Truth:
    """The views with z-depth (V,H,W) in metres: 0 in the sky, infinite beyond the building, where nothing counts; and
    which places (V,H,W) bool no three photos see."""

    views: tuple[View, ...]
    depth: np.ndarray
    pictures: np.ndarray
    hidden: np.ndarray


def read_truth(site: Path) -> Truth:
    """The views of SITE/truth/looks."""
    folder = site / "truth" / "looks"
    with np.load(folder / "looks.npz") as file:
        stored, poses, focal = file["depth"], file["cam_from_world"], float(file["focal"])
        depth = np.where(stored == _ELSEWHERE, np.inf, stored * float(file["unit"])).astype(np.float32)
    height, width = depth.shape[1:]
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    views = tuple(View(name=f"{number + 1:02d}.jpg", image=f"{number + 1:02d}.jpg", width=width, height=height, K=K,
                       cam_from_world=pose[:3], near=0.1, far=1000.0, sources=())
                  for number, pose in enumerate(poses))
    seen = cKDTree(read_points(site / "truth" / "cloud.npz"))
    hidden = np.stack([_far(view, true, seen) for view, true in zip(views, depth, strict=True)])
    return Truth(views, depth, np.stack([images.read_rgb(folder / view.image) for view in views]), hidden)


def _far(view: View, true: np.ndarray, seen: cKDTree) -> np.ndarray:
    """Which of the building's pixels (H,W) bool show a place that lies farther than FAR from all of `seen`."""
    far = (true > 0) & np.isfinite(true)
    y, x = np.nonzero(far)
    rays = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], axis=1) @ np.linalg.inv(view.K).T
    places = (rays * true[far][:, None] - view.cam_from_world[:, 3]) @ view.cam_from_world[:, :3]
    far[far] = np.isinf(seen.query(places, distance_upper_bound=FAR, workers=-1)[0])
    return far


def measure(mesh: Mesh, pages: list[np.ndarray], truth: Truth, out: Path | None = None) -> tuple[Looks, Looks, Looks]:
    """All views, those at eye level, those of the drone, for a mesh in the frame of the truth."""
    rows, drawn, told = [], [], []
    marked = mesh.filled if mesh.weak is None else mesh.filled | mesh.weak
    for view, true in zip(truth.views, truth.depth, strict=True):
        picture, depth, shown = render(mesh, pages, view)
        told.append((shown >= 0) & marked[np.maximum(shown, 0)])
        rows.append(_judge(depth, true, view))
        drawn.append(picture)
    pictures, verdicts = np.stack(drawn), np.stack(rows)
    right = verdicts >= 2
    gain = truth.pictures[right].mean(axis=0) / np.maximum(pictures[right].mean(axis=0), 1) if right.any() else 1.0
    matched = np.clip(np.rint(pictures * gain), 0, 255).astype(np.uint8)
    if out is not None:
        _write(out, truth, pictures, verdicts)
    groups = slice(None), slice(None, EYE_LEVEL), slice(EYE_LEVEL, None)
    every, eye, drone = (_summary(verdicts[group], np.stack(told)[group], matched[group], truth.pictures[group],
                                  truth.hidden[group]) for group in groups)
    return every, eye, drone


def _judge(depth: np.ndarray, true: np.ndarray, view: View) -> np.ndarray:
    """Of each pixel (H,W) int8: -1 not the building, 0 empty, 1 wrong, 2 right within NEAR, 3 within NEARER."""
    building = (true > 0) & np.isfinite(true)
    y, x = np.mgrid[: view.height, : view.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(view.K).T
    length = np.linalg.norm(rays, axis=-1)
    along = (depth - true) * length
    cosine = _cosine(rays * np.where(building, true, 0)[..., None], rays / length[..., None])
    with np.errstate(invalid="ignore"):
        off = np.abs(along) * np.maximum(cosine, LEAST_COSINE)
    verdict = np.where((depth <= 0) | (along > BEHIND), 0, np.where(off <= NEARER, 3, np.where(off <= NEAR, 2, 1)))
    return np.where(building, verdict, -1).astype(np.int8)


def _cosine(points: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Between unit rays (H,W,3) and the surface's normals at points (H,W,3) in the camera's frame, (H,W), from the
    nearer neighbour on each axis: over an edge the other one is another surface."""
    sides = []
    for axis in (0, 1):
        step = np.diff(points, axis=axis)
        pad = [(0, 0)] * 3
        pad[axis] = (0, 1)
        ahead = np.pad(step, pad, mode="edge")
        pad[axis] = (1, 0)
        back = np.pad(step, pad, mode="edge")
        shorter = np.linalg.norm(ahead, axis=-1) < np.linalg.norm(back, axis=-1)
        sides.append(np.where(shorter[..., None], ahead, back))
    normal = np.cross(sides[0], sides[1])
    unit = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    cosine: np.ndarray = np.abs((unit * rays).sum(axis=-1))
    return cosine


def _summary(
    verdicts: np.ndarray, marked: np.ndarray, pictures: np.ndarray, truth: np.ndarray, hidden: np.ndarray
) -> Looks:
    building = verdicts >= 0
    share = [100 * float((verdicts[building] == kind).mean()) for kind in range(4)]
    right = verdicts >= 2
    noise = ssim = float("nan")
    if right.any():
        noise = psnr(pictures, truth, right)
        maps = [structural_similarity(a, b, channel_axis=2, full=True)[1] for a, b in zip(pictures, truth, strict=True)]
        ssim = float(np.stack(maps)[right].mean())
    return Looks(right_10cm=share[3], right_20cm=share[2] + share[3], wrong=share[1], empty=share[0],
                 unmarked=100 * float((verdicts == 1)[building & ~marked].sum() / max(building.sum(), 1)),
                 hidden=100 * float(((verdicts == 0) & hidden).sum() / max(building.sum(), 1)), psnr=noise, ssim=ssim)


def _write(out: Path, truth: Truth, pictures: np.ndarray, verdicts: np.ndarray) -> None:
    colours = np.array([[40, 80, 230], [230, 50, 40], [150, 150, 150], [190, 190, 190], [0, 0, 0]], np.uint8)
    for view, true, picture, verdict in zip(truth.views, truth.pictures, pictures, verdicts, strict=True):
        images.write_jpeg(out / view.image, np.concatenate([true, picture, colours[verdict]], axis=1))


def report(workspace: Path, site: Path, mesh_path: Path | None = None, out: Path | None = None
           ) -> tuple[Looks, Looks, Looks]:
    """Measure the mesh of a workspace (component 0). Raises WorkspaceError where a file is missing."""
    if mesh_path is None:
        textured = workspace / textured_folder(0) / "mesh.ply"
        mesh_path = textured if textured.exists() else workspace / mesh_file(0)
    mesh = read_mesh(mesh_path)
    to_truth = align_cameras(read_centres(workspace), read_centres(site / "truth"))
    pages = [images.read_rgb(mesh_path.parent / name) for name in mesh.pages]
    placed = replace(mesh, vertices=to_truth.apply(mesh.vertices).astype(np.float32))
    return measure(placed, pages, read_truth(site), out)


def text(looks: tuple[Looks, Looks, Looks]) -> str:
    """As a table, for people."""
    lines = [f"{'':16}{'right 10cm':>11}{'20cm':>7}{'wrong':>7}{'unmarked':>9}{'empty':>7}{'hidden':>7}"
             f"{'PSNR':>7}{'SSIM':>7}"]
    for name, r in zip(("all views", "at eye level", "as a drone"), looks, strict=True):
        lines.append(f"{name:16}{r.right_10cm:11.1f}{r.right_20cm:7.1f}{r.wrong:7.1f}{r.unmarked:9.1f}{r.empty:7.1f}"
                     f"{r.hidden:7.1f}{r.psnr:7.2f}{r.ssim:7.3f}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.looks", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("site", type=Path)
    parser.add_argument("--mesh", type=Path, help="another mesh than the workspace's, in its frame")
    parser.add_argument("--out", type=Path, help="folder for pictures of every view")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    args = parser.parse_args(arguments)
    try:
        looks = report(args.workspace, args.site, args.mesh, args.out)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    print(json.dumps([asdict(part) for part in looks]) if args.json else text(looks))
    return 0


if __name__ == "__main__":
    sys.exit(main())
