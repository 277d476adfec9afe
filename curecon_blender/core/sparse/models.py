# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models on disk: finding, reading and checking a given one, writing ours."""

from __future__ import annotations

import codecs
import os
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from ..base.errors import SparseError, WorkspaceError
from ..base.files import disk_errors, partial_path, write_json
from ..base.images import MAX_PIXELS
from ..base.language import Text
from ..base.reading import FARTHEST
from ..base.records import Lens
from .model_files import check_binary

# What pycolmap raises on malformed files.
_READ_ERRORS = (ValueError, LookupError, RuntimeError, MemoryError, TypeError, ArithmeticError, OSError)
MAPPED, ADJUSTED = "sparse/mapped", "sparse"  # places of components in a workspace: as mapped, in the site frame
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def find_models(folder: Path) -> list[Path]:
    """The folders that hold the models meant by `folder`: itself, its `sparse`, or `0`, `1`... in either.

    Raises SparseError when there is none.
    """
    for base in (folder, folder / "sparse"):
        if _is_model(base):
            return [base]
        if base.is_dir():
            numbered = [path for path in base.iterdir() if path.name.isdecimal() and _is_model(path)]
            if numbered:
                return sorted(numbered, key=lambda path: int(path.name))
    what = "does not exist" if not folder.exists() else "holds no COLMAP model (cameras and images, .txt or .bin)"
    raise SparseError(
        Text("{} {}.", folder, Text(what)),
        remedy="Choose the folder with cameras.txt and images.txt, or cameras.bin and images.bin.", path=folder,
    )


def _is_model(folder: Path) -> bool:
    return any(all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images"))
               for suffix in (".bin", ".txt"))


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """The COLMAP model in `folder`, text or binary, with or without points. Raises SparseError when malformed."""
    suffix = ".bin" if all((folder / f"{name}.bin").is_file() for name in ("cameras", "images")) else ".txt"
    with tempfile.TemporaryDirectory() as scratch:
        source = _plain(folder, suffix, Path(scratch))
        model = pycolmap.Reconstruction()
        try:
            if suffix == ".bin":
                check_binary(source)
                model.read_binary(source)
            else:
                model.read_text(source)
                _restore_names(model, source / "images.txt")
                _check_references(model)
            _check_numbers(model)
        except _READ_ERRORS as error:
            raise SparseError(
                Text("The COLMAP model in {} cannot be read: its {} files are damaged, cut short or do not belong "
                     "together ({}).", folder, suffix, Text(_first_line(error))),
                remedy="Export the model again (COLMAP: File > Export model), all of its files into one folder.",
                path=folder,
            ) from error
    for camera in model.cameras.values():
        if not _is_usable(camera):
            raise SparseError(
                Text("Camera {} of the model in {} ({}) cannot be used.", camera.camera_id, folder, camera.model_name),
                remedy="Use perspective or fisheye cameras with all of their parameters, not panoramas.", path=folder,
            )
    return model


def _plain(folder: Path, suffix: str, scratch: Path) -> Path:
    """The folder, or a copy of its model that pycolmap can read: with a file of points, and without the marks that
    editors put before a text. Raises SparseError."""
    files = [path for path in folder.iterdir() if path.suffix == suffix and path.is_file()]
    marked = {path.name: code for path in files if suffix == ".txt" and (code := _code(path))}
    points = f"points3D{suffix}"
    if not marked and (folder / points).is_file():
        return folder
    for path in files:
        shutil.copyfile(path, scratch / path.name)
    for name, code in marked.items():
        try:
            text = (folder / name).read_text(encoding=code)
        except UnicodeError as error:
            raise SparseError(
                Text("{} is no text ({}).", folder / name, Text(str(error))),
                remedy="Export the model again.", path=folder / name
            ) from error
        (scratch / name).write_text(text, encoding="utf-8")
    if not (folder / points).is_file():  # cameras alone
        (scratch / points).write_bytes(bytes(8) if suffix == ".bin" else b"")
    return scratch


def _code(path: Path) -> str:
    """How a text is written that begins with a byte order mark, else ""."""
    with open(path, "rb") as file:
        head = file.read(3)
    return next((code for mark, code in _MARKS.items() if head.startswith(mark)), "")


def _check_numbers(model: pycolmap.Reconstruction) -> None:
    """Raises ValueError where a place or a pose is no number, or beyond reach."""
    poses = [model.image(i).cam_from_world().matrix() for i in model.reg_image_ids()]
    places = [point.xyz for point in model.points3D.values()]
    for values in (np.array(poses), np.array(places)):
        if values.size and not (np.abs(values) < FARTHEST).all():
            raise ValueError("a place or a pose is no number, or beyond reach")


def _check_references(model: pycolmap.Reconstruction) -> None:
    """What `check_binary` sees in a binary model beforehand. Raises ValueError or IndexError."""
    for image_id in model.reg_image_ids():
        for observation in model.image(image_id).get_observation_points2D():
            model.point3D(observation.point3D_id)
    for point_id, point in model.points3D.items():
        for element in point.track.elements:
            if model.image(element.image_id).points2D[element.point2D_idx].point3D_id != point_id:
                raise ValueError(f"point {point_id} and its observations do not agree")


def _is_usable(camera: pycolmap.Camera) -> bool:
    if camera.is_spherical() or not camera.verify_params() or not 0 < camera.width * camera.height <= MAX_PIXELS:
        return False
    focal = [camera.params[i] for i in camera.focal_length_idxs()]
    return bool((np.abs(camera.params) < FARTHEST).all() and min(focal) > 1e-3)


def _restore_names(model: pycolmap.Reconstruction, images: Path) -> None:
    """Names with spaces, which pycolmap reads from a text model only as far as the first space."""
    lines = iter(images.read_text(encoding="utf-8").splitlines())
    for line in lines:
        if line.strip() and not line.startswith("#"):
            fields = line.split(maxsplit=9)
            model.image(int(fields[0])).name = fields[9].strip()
            next(lines, None)  # the image's 2D points


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def write_components(
    workspace: Path, place: str, components: list[tuple[pycolmap.Reconstruction, dict[str, Any]]]
) -> None:
    """Put the components in place of `workspace/place/0`, `1`..., each folder all or nothing: a model, and records by
    the name of their JSON file."""
    folder = workspace
    with disk_errors(folder / place):
        for part in place.split("/"):
            folder = folder / part
            folder.mkdir(exist_ok=True)
        for index, (model, records) in enumerate(components):
            partial = partial_path(folder / str(index))
            shutil.rmtree(partial, ignore_errors=True)
            partial.mkdir()
            model.write_binary(partial)
            _check_written(model, partial)
            for name, record in records.items():
                write_json(partial / name, asdict(record))
        for old in folder.iterdir():
            if old.name.isdigit():
                shutil.rmtree(old)
        for index in range(len(components)):
            os.replace(partial_path(folder / str(index)), folder / str(index))


def _check_written(model: pycolmap.Reconstruction, folder: Path) -> None:
    """Read a model back: pycolmap says nothing when the disk is full."""
    try:
        whole = pycolmap.Reconstruction(folder).num_points3D() == model.num_points3D()
    except _READ_ERRORS:
        whole = False
    if not whole:
        raise WorkspaceError(
            Text("The sparse model could not be written whole to {}: the disk is full or does not answer.",
                 folder.parent),
            remedy="Free some space, then run it again: finished work is kept.", path=folder.parent,
        )


def lens_of(camera: pycolmap.Camera) -> Lens | None:
    """The camera as a Lens; None for a kind that has more to it, such as a fisheye."""
    name, numbers = camera.model_name, [float(number) for number in camera.params]
    if name in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        numbers.insert(1, numbers[0])
    elif name not in ("PINHOLE", "OPENCV", "FULL_OPENCV") or any(numbers[9:]):
        return None
    if name in ("SIMPLE_RADIAL", "RADIAL"):
        numbers = [*numbers, *[0.0] * (6 - len(numbers))]
    fx, fy, cx, cy, k1, k2, p1, p2, k3 = [*numbers[:9], *[0.0] * (9 - len(numbers))]
    return Lens(f=fx, aspect=fy / fx, cx=cx, cy=cy, k1=k1, k2=k2, p1=p1, p2=p2, k3=k3)


def listed(names: list[str], most: int = 5) -> str:
    """The first few names, and how many more there are."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
