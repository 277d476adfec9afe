# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A look at a COLMAP model's binary files before pycolmap reads them: it believes every count and reference in them,
and would ask for any amount of memory, or end the process."""

from __future__ import annotations

import struct
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

_NO_POINT = (1 << 64) - 1
_LONGEST_NAME = 4096
_POINT = 51  # bytes: number, place, colour, error, and how many elements its track has
_OBSERVATION = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<u8")])
_ELEMENT = np.dtype([("image", "<u4"), ("observation", "<u4")])


def check_binary(folder: Path) -> None:
    """Raises ValueError where the files promise more than they hold or name what is not there."""
    cameras = _read_cameras(_Bytes(folder / "cameras.bin"))
    sensors = {(0, camera) for camera in cameras}
    images = _read_images(_Bytes(folder / "images.bin"), cameras)
    points = _read_points(_Bytes(folder / "points3D.bin"), images)
    for observations in images.values():
        named = observations["point"][observations["point"] != _NO_POINT]
        if not np.isin(named, points).all():
            raise ValueError("an image names a point that is not there")
    if (folder / "rigs.bin").is_file():
        rigs = _read_rigs(_Bytes(folder / "rigs.bin"), sensors)
        if (folder / "frames.bin").is_file():
            _read_frames(_Bytes(folder / "frames.bin"), rigs, set(images))


class _Bytes:
    """A file's content, taken piece by piece."""

    def __init__(self, path: Path) -> None:
        self._name, self._content, self._place = path.name, path.read_bytes(), 0

    def take(self, form: str) -> tuple[Any, ...]:
        form = "<" + form
        self._need(struct.calcsize(form))
        values = struct.unpack_from(form, self._content, self._place)
        self._place += struct.calcsize(form)
        return values

    def count(self, least: int, form: str = "Q") -> int:
        """A number of things of at least so many bytes each, which must follow."""
        (count,) = self.take(form)
        self._need(count * least)
        return int(count)

    def array(self, kind: np.dtype) -> np.ndarray:
        count = self.count(kind.itemsize)
        values = np.frombuffer(self._content, kind, count, self._place)
        self._place += count * kind.itemsize
        return values

    def tracks(self) -> tuple[list[int], np.ndarray]:
        """The numbers of a file's points, and the elements of all their tracks. Without the other methods' detours:
        there are hundreds of thousands."""
        numbers, tracks, number = [], [], struct.Struct("<Q").unpack_from
        for _ in range(self.count(_POINT)):
            self._need(_POINT)
            numbers.append(number(self._content, self._place)[0])
            (length,) = number(self._content, self._place + _POINT - 8)
            self._place += _POINT
            self._need(length * _ELEMENT.itemsize)
            tracks.append(self._content[self._place : self._place + length * _ELEMENT.itemsize])
            self._place += length * _ELEMENT.itemsize
        return numbers, np.frombuffer(b"".join(tracks), _ELEMENT)

    def name(self) -> None:
        end = self._content.find(b"\0", self._place, self._place + _LONGEST_NAME)
        if end < 0:
            raise ValueError(f"{self._name} has a name without an end")
        self._content[self._place : end].decode()
        self._place = end + 1

    def _need(self, size: int) -> None:
        if size > len(self._content) - self._place:
            raise ValueError(f"{self._name} is cut short")


def _unique(values: list[int], what: str) -> list[int]:
    if len(set(values)) != len(values):
        raise ValueError(f"two {what} have one number")
    return values


@cache
def _parameters() -> dict[int, int]:
    """How many parameters each of COLMAP's camera models has, by its number."""
    kinds = [kind for name, kind in pycolmap.CameraModelId.__members__.items() if name != "INVALID"]
    return {int(kind): len(pycolmap.Camera.create_from_model_id(1, kind, 1.0, 2, 2).params) for kind in kinds}


def _read_cameras(file: _Bytes) -> set[int]:
    numbers = []
    for _ in range(file.count(24)):
        number, kind, _width, _height = file.take("IiQQ")
        if kind not in _parameters():
            raise ValueError(f"camera {number} is of an unknown model")
        file.take(f"{_parameters()[kind]}d")
        numbers.append(number)
    return set(_unique(numbers, "cameras"))


def _read_images(file: _Bytes, cameras: set[int]) -> dict[int, np.ndarray]:
    numbers, observations = [], []
    for _ in range(file.count(73)):
        number, *_pose, camera = file.take("I7dI")
        if camera not in cameras:
            raise ValueError(f"image {number} names a camera that is not there")
        file.name()
        numbers.append(number)
        observations.append(file.array(_OBSERVATION))
    return dict(zip(_unique(numbers, "images"), observations, strict=True))


def _read_points(file: _Bytes, images: dict[int, np.ndarray]) -> np.ndarray:
    numbers, elements = file.tracks()
    known = np.array(sorted(images), np.uint32)
    held = np.array([len(images[image]) for image in known.tolist()], np.uint32)
    if len(elements):
        place = np.searchsorted(known, elements["image"]).clip(max=len(known) - 1) if len(known) else None
        if place is None or (known[place] != elements["image"]).any() or (held[place] <= elements["observation"]).any():
            raise ValueError("a point names an observation that is not there")
    return np.array(_unique(numbers, "points"), np.uint64)


def _read_rigs(file: _Bytes, sensors: set[tuple[int, int]]) -> dict[int, set[tuple[int, int]]]:
    rigs: dict[int, set[tuple[int, int]]] = {}
    for _ in range(file.count(8)):
        rig, count = file.take("II")
        held = []
        for place in range(count):
            held.append(file.take("iI"))
            if place > 0 and file.take("B")[0]:
                file.take("7d")
        if rig in rigs or len(set(held)) != len(held) or not set(held) <= sensors:
            raise ValueError(f"rig {rig} is there twice, or names a camera that is not there")
        rigs[rig] = set(held)
    return rigs


def _read_frames(file: _Bytes, rigs: dict[int, set[tuple[int, int]]], images: set[int]) -> None:
    frames, seen = [], []
    for _ in range(file.count(68)):
        frame, rig, *_pose = file.take("II7d")
        frames.append(frame)
        for _ in range(file.count(16, "I")):
            sensor, number, image = file.take("iIQ")
            if (sensor, number) not in rigs.get(rig, ()) or image not in images:
                raise ValueError(f"frame {frame} names a camera or an image that is not there")
            seen.append(image)
    _unique(frames, "frames")
    _unique(seen, "frames' images")
