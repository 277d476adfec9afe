# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a lens takes from the light towards the corners of its photos (falloff, or vignetting): undone in a texture, and
kept beside it in falloff.json, so that the texture can be held against a photo as the lens shows it.

A photo's sRGB values are multiplied by exp(a t + b t^2), where t is the squared tangent of the angle from the optical
axis, and `lens` (2,) holds a and b.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import write_json
from ..base.language import Text
from ..base.reading import FARTHEST, Shape, Within, build, read_json
from ..base.records import View

FILE_NAME = "falloff.json"
DARKEST_CORNER = 0.4  # of the light on the axis


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera by its undistorted photos: their size in pixels, `K` (3,3), and its `lens`."""

    width: Annotated[int, Within(1, 1_000_000)]
    height: Annotated[int, Within(1, 1_000_000)]
    K: Annotated[np.ndarray, Shape(3, 3)]
    lens: Annotated[np.ndarray, Shape(2)]

    def took(self, view: View) -> bool:
        """Undistorted photos of one camera of the sparse model, and only they, have one K."""
        return (view.width, view.height) == (self.width, self.height) and bool((view.K == self.K).all())


def factor(lens: np.ndarray, t: np.ndarray) -> np.ndarray:
    """What undoes the falloff of a `lens` (...,2) at `t` (...), 1 on the axis."""
    result: np.ndarray = np.exp(t * (lens[..., 0] + t * lens[..., 1]))
    return result


def off_axis(points: np.ndarray) -> np.ndarray:
    """t (n,) of points (n,3) in the camera's frame."""
    result: np.ndarray = (points[:, 0] ** 2 + points[:, 1] ** 2) / points[:, 2] ** 2
    return result


def off_axis_picture(view: View | Camera, step: int = 1) -> np.ndarray:
    """t at every `step`-th pixel of a camera's picture, both ways."""
    x = (np.arange(0.5, view.width, step) - view.K[0, 2]) / view.K[0, 0]
    y = (np.arange(0.5, view.height, step) - view.K[1, 2]) / view.K[1, 1]
    return (x**2 + y[:, None] ** 2).astype(np.float32)


def corner(view: View | Camera) -> float:
    """t at the farthest corner of a camera's picture."""
    x, y = (max(view.K[i, 2], size - view.K[i, 2]) / view.K[i, i] for i, size in enumerate((view.width, view.height)))
    return float(x**2 + y**2)


def through_lens(picture: np.ndarray, view: View, cameras: Sequence[Camera]) -> np.ndarray:
    """An even picture (H,W,3) of the size of `view` as its lens shows it, float64; itself where its lens is not among
    those of the `cameras`."""
    for camera in cameras:
        if camera.took(view):
            return picture / factor(camera.lens, off_axis_picture(view))[..., None]
    return picture


def write_cameras(folder: Path, views: Sequence[View], lenses: np.ndarray) -> None:
    """Keep the lenses (V,2) of the photos `views` in a texture's folder, one of each camera."""
    cameras: list[Camera] = []
    for view, lens in zip(views, lenses, strict=True):
        if not any(camera.took(view) for camera in cameras):
            cameras.append(Camera(width=view.width, height=view.height, K=view.K, lens=lens))
    write_json(folder / FILE_NAME, [{**asdict(one), "K": one.K.tolist(), "lens": one.lens.tolist()} for one in cameras])


def read_cameras(folder: Path) -> tuple[Camera, ...]:
    """The cameras of a texture's folder; none where their falloff was not undone. Raises WorkspaceError for a damaged
    file."""
    path = folder / FILE_NAME
    try:
        cameras: tuple[Camera, ...] = build(tuple[Camera, ...], read_json(path), "cameras")
        for camera in cameras:
            _check(camera)
    except FileNotFoundError:
        return ()
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))), remedy="Delete that file and run Reconstruct again.",
            path=path,
        ) from error
    return cameras


def _check(camera: Camera) -> None:
    """Raises ValueError for a lens that does not darken all the way to the corner, or more than a lens can."""
    if not (min(camera.K[0, 0], camera.K[1, 1]) >= 1 and np.abs(camera.K).max() <= FARTHEST):
        raise ValueError("a camera has no focal length")
    t, (a, b) = corner(camera), camera.lens
    if not (a >= 0 and a + 2 * b * t >= -1e-9 and t * (a + t * b) <= 1e-9 - np.log(DARKEST_CORNER)):
        raise ValueError("no lens has this falloff")
