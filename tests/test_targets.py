# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Coded targets are found where they are, and become marks of the points that bear their numbers."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import Run, curecon
from PIL import Image

from curecon_blender.core.adjust.control import ControlPoint, ControlSet, read_control, write_control
from curecon_blender.core.adjust.targets import numbered
from curecon_blender.core.base.records import Photo, PhotoSet
from curecon_blender.core.photos.record import write_photos

SIZE = (1200, 900)
PLACES = {"gcp3": (300.0, 250.0), "gcp7": (800.0, 600.0)}


def point(name: str) -> ControlPoint:
    return ControlPoint(name=name, system="local", given=(1.0, 2.0, 0.0), place=(1.0, 2.0, 0.0))


def picture(homography: np.ndarray, numbers: dict[int, tuple[float, float]]) -> np.ndarray:
    """A flat ground with 4X4_50 targets about places of it (pixels), seen in perspective."""
    ground = np.full((SIZE[1], SIZE[0]), 150, np.uint8)
    ground += np.random.default_rng(0).integers(0, 30, ground.shape, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for number, (x, y) in numbers.items():
        board = np.pad(cv2.aruco.generateImageMarker(dictionary, number, 60), 10, constant_values=255)
        left, top = int(x) - 40, int(y) - 40
        ground[top : top + 80, left : left + 80] = board
    shift = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # OpenCV's pixel centres are at 0
    flat = cv2.warpPerspective(ground, np.linalg.inv(shift) @ homography @ shift, SIZE, borderValue=150)
    return np.repeat(cv2.GaussianBlur(flat, (0, 0), 0.7)[..., None], 3, axis=2)


@pytest.fixture
def workspace(tmp_path: Path) -> tuple[Path, list[np.ndarray]]:
    """A checked job of two photos in perspective, the second turned by EXIF, with three points."""
    views = [np.array([[0.9, 0.1, 40], [-0.05, 0.95, 30], [1e-4, -5e-5, 1]]),
             np.array([[0.85, -0.2, 150], [0.15, 0.9, -40], [-5e-5, 8e-5, 1]])]
    photos = []
    for number, view in enumerate(views, start=1):
        path = tmp_path / f"DJI_{number}.JPG"
        shown = Image.fromarray(picture(view, {3: PLACES["gcp3"], 7: PLACES["gcp7"], 9: (900.0, 200.0)}))
        exif = Image.Exif()
        if number == 2:
            exif[274] = 3
            shown = shown.transpose(Image.Transpose.ROTATE_180)
        shown.save(path, quality=95, exif=exif)
        photos.append(Photo(name=path.name, path=path, width=SIZE[0], height=SIZE[1], camera="c", focal_px=None))
    folder = tmp_path / "work"
    folder.mkdir()
    write_photos(folder, PhotoSet(photos=tuple(photos)))
    write_control(folder, ControlSet(points=(point("gcp3"), point("gcp7"), point("wall"))))
    return folder, views


def test_targets_become_marks(workspace: tuple[Path, list[np.ndarray]]) -> None:
    folder, views = workspace
    ran = curecon("control", folder, "--find-targets", "--export", folder / "gcp_list.txt")
    assert ran.code == 0, ran.said
    marks = read_control(folder).marks
    assert len(marks) == 4
    for mark in marks:
        x, y, w = views[int(mark.photo[4]) - 1] @ [*PLACES[mark.point], 1]
        assert (mark.x, mark.y) == pytest.approx((x / w, y / w), abs=0.15)
    assert "9 (2 photos)" in ran.said  # a target whose number no point bears
    assert len((folder / "gcp_list.txt").read_text().splitlines()) == 5


def test_no_targets_and_no_points_are_told(workspace: tuple[Path, list[np.ndarray]]) -> None:
    folder, _ = workspace
    other: Run = curecon("control", folder, "--find-targets", "--dictionary", "APRILTAG_36h11")
    assert other.code == 12 and "No coded target" in other.said
    assert len(read_control(folder).points) == 3
    write_control(folder, ControlSet())
    assert "no control points yet" in curecon("control", folder, "--find-targets").said


def test_numbers_that_two_points_end_in_are_none_s() -> None:
    control = ControlSet(points=tuple(map(point, ("gcp03", "wall", "T12", "north 3", "A-7b"))))
    assert numbered(control) == {12: "T12"}


def test_the_command_imports_and_tells(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("name,east,north,height\na,1,2,3\nb,4,5,6\n")
    ran = curecon("control", tmp_path / "work", "--import", tmp_path / "points.csv", "--system", "local")
    assert ran.code == 0, ran.said
    assert [one["name"] for one in ran.summary["control"]] == ["a", "b"]
    (tmp_path / "bad.csv").write_text("name,east,north,height\na,1,2,3\na,4,5,6\n")
    failed = curecon("control", tmp_path / "work", "--import", tmp_path / "bad.csv", "--system", "local")
    assert failed.code == 12 and "bad.csv, line 3" in failed.said
    assert len(read_control(tmp_path / "work").points) == 2
