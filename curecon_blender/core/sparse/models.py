# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models on disk: finding, reading and checking a given one, fitting it to the photos, writing ours."""

from __future__ import annotations

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
from ..base.messages import Reporter
from ..base.reading import FARTHEST
from ..base.records import Frame, Lens, Photo, PhotoSet
from ..photos.record import photo_finder
from .model_files import check_binary
from .record import FRAME_FILE, read_frame

# What pycolmap raises on malformed files.
_READ_ERRORS = (ValueError, LookupError, RuntimeError, MemoryError, TypeError, ArithmeticError, OSError)
MAPPED, ADJUSTED = "sparse/mapped", "sparse"  # places of components in a workspace: as mapped, in the site frame
SIZE_TOLERANCE = 0.01  # relative difference of aspect ratios that rounding to whole pixels can make


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
        f"{folder} {what}.",
        remedy="Choose the folder with cameras.txt and images.txt, or cameras.bin and images.bin.", path=folder,
    )


def _is_model(folder: Path) -> bool:
    return any(all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images"))
               for suffix in (".bin", ".txt"))


def read_model(folder: Path) -> pycolmap.Reconstruction:
    """The COLMAP model in `folder`, text or binary, with or without points. Raises SparseError when malformed."""
    suffix = ".bin" if all((folder / f"{name}.bin").is_file() for name in ("cameras", "images")) else ".txt"
    with tempfile.TemporaryDirectory() as scratch:
        if not (folder / f"points3D{suffix}").is_file():  # cameras alone: pycolmap wants the file, if empty
            shutil.copytree(folder, scratch, dirs_exist_ok=True, ignore=lambda _, names: [
                name for name in names if Path(name).suffix != suffix
            ])
            (Path(scratch) / f"points3D{suffix}").write_bytes(bytes(8) if suffix == ".bin" else b"")
            source = Path(scratch)
        else:
            source = folder
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
                f"The COLMAP model in {folder} cannot be read: its {suffix} files are damaged, cut short or do not "
                f"belong together ({_first_line(error)}).",
                remedy="Export the model again (COLMAP: File > Export model), all of its files into one folder.",
                path=folder,
            ) from error
    for camera in model.cameras.values():
        if not _is_usable(camera):
            raise SparseError(
                f"Camera {camera.camera_id} of the model in {folder} ({camera.model_name}) cannot be used.",
                remedy="Use perspective or fisheye cameras with all of their parameters, not panoramas.", path=folder,
            )
    return model


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


def fit_to_photos(
    model: pycolmap.Reconstruction, photo_set: PhotoSet, folder: Path, reporter: Reporter
) -> pycolmap.Reconstruction:
    """A given model with its images named as the photos, at the photos' size, without images that have no photo.

    Poses are kept exactly, and so are cameras, unless the photos have another resolution. Raises SparseError when
    fewer than three photos are left, or a photo's size contradicts its camera.
    """
    find = photo_finder(photo_set.photos)
    matched: dict[int, Photo] = {}
    missing = []
    for image_id in sorted(model.reg_image_ids()):
        photo = find(model.image(image_id).name)
        if photo is None or photo in matched.values():
            missing.append(model.image(image_id).name)
        else:
            matched[image_id] = photo
    if len(matched) < 3:
        raise SparseError(
            f"Only {len(matched)} of the {model.num_reg_images()} images in the model {folder} are among the photos.",
            remedy="Choose the folder with the photos from which the model was made; their file names must agree.",
            path=folder,
        )
    if missing:
        reporter.warning(f"{len(missing)} images of the model have no photo and were left out: {listed(missing)}.")
    _scale_to_photos(model, matched, folder)
    for image_id in model.reg_image_ids():
        if image_id not in matched:
            model.deregister_frame(model.image(image_id).frame_id)
    model.tear_down()
    for image_id, photo in matched.items():
        model.image(image_id).name = photo.name
    return model


def _scale_to_photos(model: pycolmap.Reconstruction, matched: dict[int, Photo], folder: Path) -> None:
    sizes: dict[int, tuple[int, int]] = {}
    for image_id, photo in matched.items():
        camera = model.camera(model.image(image_id).camera_id)
        ratio = (photo.width / camera.width) / (photo.height / camera.height)
        first = sizes.setdefault(camera.camera_id, (photo.width, photo.height))
        if abs(ratio - 1) > SIZE_TOLERANCE or first != (photo.width, photo.height):
            raise SparseError(
                f"{photo.name} has {photo.width}x{photo.height} pixels, but its camera in the model {folder} has "
                f"{camera.width}x{camera.height}.",
                remedy="Use the photos from which the model was made (scaled evenly at most, not cropped or turned).",
                path=photo.path,
            )
    for image_id in matched:
        image = model.image(image_id)
        camera, (width, height) = model.camera(image.camera_id), sizes[image.camera_id]
        if (camera.width, camera.height) != (width, height):
            for point in image.points2D:
                point.xy = point.xy * (width / camera.width, height / camera.height)
    for camera_id, (width, height) in sizes.items():
        camera = model.camera(camera_id)
        if (camera.width, camera.height) != (width, height):
            camera.rescale(width, height)
    model.update_point_3d_errors()


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
            f"The sparse model could not be written whole to {folder.parent}.",
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


def given_frame(folder: Path) -> Frame:
    """The frame of a given model: what its own record says, if it is one of ours, else that nothing is known of it."""
    if (folder / FRAME_FILE).is_file():
        return read_frame(folder)
    return Frame(
        scale="unknown", up="given",
        note="Cameras and frame are those of the given model; its scale and axes were taken as they are.",
    )


def listed(names: list[str], most: int = 5) -> str:
    """The first few names, and how many more there are."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"
