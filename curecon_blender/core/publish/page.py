# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a site's page shows beside its tiles: figures, pictures, the report."""

from __future__ import annotations

import io
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..base.errors import PhotoError
from ..base.files import PRESENTATION, atomic_write, disk_errors
from ..base.images import read_rgb
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import EXACT
from ..base.reading import read_json
from ..deliver.ortho import CloudView, Grid, MeshView
from ..report.write import FOLDER as REPORT
from .film import LARGEST, without_metadata
from .levels import Level

_THUMBNAIL = (640, 400)
_TOWARDS = np.array([0.45, -0.75, 0.55])  # the thumbnail's viewer: from the south east and above
_GROUND = (231, 235, 240)
_PICTURE, _QUALITY = 2400, 85  # longest side in pixels, JPEG
_MOST_PICTURES = 40
_FILM = "film.mp4"
# Renders of the site without any writing on them; sheets say when photos were taken.
_STILLS, _ALL = ("still_*.png",), ("*.png", "*.jpg", "*.jpeg")
# Where report.json has what the page tells: nothing in these figures says where, when or by whom.
_FIGURES: dict[str, tuple[str | int, ...]] = {
    "pixel": ("clearness", "pixel", "median"), "reprojection": ("correctness", "reprojection_error"),
    "sigma_plan": ("correctness", "sigmas", "within", 0), "sigma_height": ("correctness", "sigmas", "within", 1),
    "seen_well": ("integrity", "seen_well"), "photos": ("integrity", "placed"),
    "control": ("correctness", "control", "rms"), "check": ("correctness", "check", "rms"),
}


def figures(report: Path, index: int, points: int, faces: int, reporter: Reporter) -> dict[str, float]:
    """A part's figures from the accuracy report, by their names here; none, with a warning, where the report is of
    another state of the site."""
    again = "Its figures are left out. Press Accuracy Report, then publish again."
    try:
        parts = read_json(report)["parts"]
        part = next(part for part in parts if part["index"] == index)
        if part["points"] != points or part["faces"] != faces:
            reporter.warning(Text("The accuracy report is of another state of the site. {}", Text(again)))
            return {}
        found = {name: _at(part, way) for name, way in _FIGURES.items()}
    except FileNotFoundError:
        reporter.warning("There is no accuracy report: the page says nothing of how exact the site is. Press Accuracy "
                         "Report, then publish again.")
        return {}
    except (OSError, ValueError, LookupError, TypeError, StopIteration) as error:
        reporter.warning(Text("{} cannot be read ({}). {}", report, Text(str(error)), Text(again)))
        return {}
    return {name: value for name, value in found.items() if value is not None}


def _at(record: Any, way: tuple[str | int, ...]) -> float | None:
    """The number there; of three, along the axes, their length."""
    for step in way:
        if isinstance(record, Mapping):
            record = record.get(step)
        elif isinstance(record, list) and isinstance(step, int) and step < len(record):
            record = record[step]
        else:
            return None
    numbers = record if isinstance(record, list) and len(record) == 3 else [record]
    if not all(isinstance(one, int | float) and math.isfinite(one) for one in numbers):
        return None
    return math.hypot(*numbers) if len(numbers) > 1 else numbers[0]


def pictures(workspace: Path, location: str, folder: Path, reporter: Reporter) -> list[str]:
    """Copies of the presentation's pictures, without their names and metadata; what was made, relative to the site's
    folder. Below EXACT those alone that have no writing on them. Raises WorkspaceError, Cancelled."""
    source = workspace / PRESENTATION
    patterns = _ALL if location == EXACT else _STILLS
    found = sorted({path for pattern in patterns for path in source.glob(pattern) if path.is_file()})
    if len(found) > _MOST_PICTURES:
        reporter.warning(Text("{} holds {} pictures; the first {} are published.", source, len(found), _MOST_PICTURES))
    made: list[str] = []
    for path in found[:_MOST_PICTURES]:
        reporter.check_cancelled()
        try:
            picture = read_rgb(path, _PICTURE)
        except PhotoError as error:
            reporter.warning(Text("A picture is left out: {}", error.message))
            continue
        name = f"pictures/{len(made) + 1}.jpg"
        with disk_errors(folder):
            (folder / "pictures").mkdir(exist_ok=True)
        write_picture(folder / name, picture)
        made.append(name)
    return made


def film(workspace: Path, folder: Path, reporter: Reporter) -> str | None:
    """The presentation's film without its metadata, relative to the site's folder; None where there is none that can be
    shown. Raises WorkspaceError."""
    source = workspace / PRESENTATION / _FILM
    try:
        size = source.stat().st_size
        if size > LARGEST:
            raise ValueError(f"it has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f}")
        shown = without_metadata(source.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        reporter.warning(Text("The film {} is left out ({}).", source, Text(str(error))))
        return None
    with atomic_write(folder / _FILM) as file:
        file.write(shown)
    return _FILM


def report(workspace: Path, location: str, folder: Path) -> str | None:
    """The full accuracy report's copy, relative to the site's folder; None where there is none, or below EXACT. Raises
    WorkspaceError."""
    source = workspace / REPORT / "report.pdf"
    if location != EXACT or not source.is_file():
        return None
    with source.open("rb") as file, atomic_write(folder / source.name) as out:
        shutil.copyfileobj(file, out)
    return source.name


def write_picture(path: Path, picture: np.ndarray) -> None:
    """A picture (H,W,3) uint8 as JPEG without metadata. Raises WorkspaceError."""
    encoded = io.BytesIO()
    Image.fromarray(picture).save(encoded, "JPEG", quality=_QUALITY)
    with atomic_write(path) as file:
        file.write(encoded.getbuffer())


def thumbnail_of_surface(level: Level, places: np.ndarray) -> np.ndarray:
    """The surface (H,W,3) uint8 from obliquely above; `places` (N,3) are its vertices in the site frame."""
    grid = _grid(places)
    return _drawn(MeshView(level.mesh, places, level.pages, grid, np.ones(len(level.mesh.faces), bool)), grid)


def thumbnail_of_cloud(places: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """The cloud (H,W,3) uint8 from obliquely above."""
    grid = _grid(places)
    return _drawn(CloudView(places, colours, 1.5 * grid.pixel, grid), grid)


def _grid(places: np.ndarray) -> Grid:
    towards = _TOWARDS / np.linalg.norm(_TOWARDS)
    right = np.cross([0, 0, 1], towards)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(towards, right), towards])
    low, high = np.quantile(places @ axes[:2].T, [0.01, 0.99], axis=0)
    width, height = _THUMBNAIL
    pixel = max(float(((high - low) / [width, height]).max()), 1e-9)
    middle = (low + high) / 2
    return Grid(axes=axes, left=float(middle[0] - pixel * width / 2), top=float(middle[1] + pixel * height / 2),
                pixel=pixel, width=width, height=height)


def _drawn(view: MeshView | CloudView, grid: Grid) -> np.ndarray:
    view.strip(0, grid.height)
    drawn = view.colours(0, 0, grid.height, grid.width)
    return np.where(drawn[..., 3:] > 0, drawn[..., :3], np.array(_GROUND, np.uint8))
