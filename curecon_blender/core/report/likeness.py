# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How like its photos a textured mesh looks from where they were taken."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from ..base import images
from ..base.messages import Reporter
from ..base.records import Component
from ..surface.mesh import Mesh, textured_folder
from ..texture.falloff import read_cameras, through_lens
from ..texture.rendering import matched, psnr, render

MOST = 9  # photos that are compared, evenly chosen
LEAST_SHOWN = 0.1  # of a picture that the mesh must cover to be compared
HEIGHT = 480  # pixels of the pair that is shown
_GAP, _PAPER = 12, (255, 255, 255)


@dataclass(frozen=True)
class Likeness:
    """`psnr` in dB of each photo that was compared, where the mesh shows what is measured and seen, through the photo's
    lens and after one gain a channel; and of the one in the middle the photo beside the mesh. The photos are those that
    the texture was made of: this is what meshing and texturing have lost, and no test by photos that took no part."""

    psnr: list[float]
    pair: Image.Image | None


def compare(textured: Mesh, component: Component, workspace: Path, reporter: Reporter) -> Likeness:
    """Raises PhotoError and WorkspaceError for a file of the workspace that is damaged, and Cancelled."""
    folder = workspace / textured_folder(component.index)
    pages, cameras = [images.read_rgb(folder / page) for page in textured.pages], read_cameras(folder)
    views = [view for view in component.views if (workspace / view.image).is_file()]
    if not pages or not views:
        return Likeness([], None)
    found = []
    for number in sorted(set(np.linspace(0, len(views) - 1, MOST).round().astype(int).tolist())):
        reporter.check_cancelled()
        photo = images.read_rgb(workspace / views[number].image)
        picture, _, shown = render(textured, pages, views[number])
        counted = (shown >= 0) & textured.recorded[np.maximum(shown, 0)]
        if picture.shape == photo.shape and counted.mean() >= LEAST_SHOWN:
            picture = matched(through_lens(picture, views[number], cameras), photo, counted)
            picture[shown < 0] = _PAPER
            found.append((psnr(picture, photo, counted), _side_by_side(photo, picture)))
    found.sort(key=lambda one: one[0])
    return Likeness([value for value, _ in found], found[len(found) // 2][1] if found else None)


def _side_by_side(photo: np.ndarray, picture: np.ndarray) -> Image.Image:
    width = round(HEIGHT * photo.shape[1] / photo.shape[0])
    pair = Image.new("RGB", (2 * width + _GAP, HEIGHT), _PAPER)
    for left, shown in ((0, photo), (width + _GAP, picture)):
        pair.paste(Image.fromarray(shown).resize((width, HEIGHT), Image.Resampling.LANCZOS), (left, 0))
    return pair
