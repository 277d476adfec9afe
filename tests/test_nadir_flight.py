# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sample site's second flight: its truth is that of its pictures, and its metadata are read as a drone's."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import ROOT
from PIL import Image

from curecon_blender.core.photos.metadata import read_metadata

FLIGHT = ROOT / "samples" / "tulou_nadir"


@pytest.fixture
def samples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "samples"))


def test_true_cameras_and_lens_put_the_targets_where_the_photos_show_them() -> None:
    finder = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    marks = [line.split() for line in (FLIGHT / "targets" / "gcp_list.txt").read_text().splitlines()[1:]]
    off, missed = [], 0
    for name in sorted({mark[5] for mark in marks}):
        corners, numbers, _ = finder.detectMarkers(cv2.imread(str(FLIGHT / "photos" / name), cv2.IMREAD_GRAYSCALE))
        found = {} if numbers is None else dict(zip(numbers.ravel().tolist(), corners, strict=True))
        for mark in (mark for mark in marks if mark[5] == name):
            number = int(mark[6].removeprefix("T"))
            missed += number not in found
            if number in found:
                off.append(found[number][0].mean(axis=0) + 0.5 - np.array(mark[3:5], float))
    assert missed <= 0.2 * len(marks)
    assert np.abs(np.mean(off, axis=0)).max() < 0.25
    assert np.abs(off).max() < 1.5


@pytest.mark.usefixtures("samples")
def test_its_photos_tell_what_a_drone_without_calibration_tells(tmp_path: Path) -> None:
    from nadir_flight import LENS, SIGMAS, nadir_flight
    from site_flight import save_photo

    recorded, picture = nadir_flight(), np.asarray(Image.open(FLIGHT / "photos" / "DJI_0007.JPG"))
    assert len(recorded["rtk"]) == len(list((FLIGHT / "photos").iterdir())) == 20
    save_photo(picture, recorded["rtk"][6], tmp_path / "rtk.jpg")
    plain, rtk = read_metadata(FLIGHT / "photos" / "DJI_0007.JPG"), read_metadata(tmp_path / "rtk.jpg")
    assert plain.gps_sigmas is None and rtk.gps_sigmas == SIGMAS["rtk"]
    assert plain.gimbal == rtk.gimbal and plain.relative_altitude == rtk.relative_altitude
    assert plain.lens is None and rtk.lens is None
    told = plain.focal_px
    assert told is not None and 0.975 < told / (LENS.f * picture.shape[1] / 1200) < 0.985  # EXIF's whole millimetres


@pytest.mark.usefixtures("samples")
def test_its_lens_undistorts_what_it_distorts() -> None:
    from nadir_flight import HEIGHT, LENS, WIDTH

    corners = np.array([[0.0, 0.0], [WIDTH, 0.0], [WIDTH, HEIGHT], [600.0, 450.0]])
    assert LENS.distort(LENS.undistort(corners)) == pytest.approx(corners, abs=1e-8)
