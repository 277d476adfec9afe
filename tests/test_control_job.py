# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points in a job on the sample site, from files to figures: nothing of matching and mapping is repeated."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from conftest import QUICK, SITE, SITE_PHOTOS, Run, curecon

from curecon_blender.core.adjust.control import read_control
from curecon_blender.core.base.geodesy import enu_to_geodetic
from curecon_blender.core.base.records import GeoPosition

PLACES = np.array([[20.0, 0, 12], [-20, 3, 12], [0, 20, 12], [2, -20, 12], [6, 4, 0], [-5, -6, 0], [1, 9, 0]])
CHECKS = ("p5", "p6")


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Points of the site with their true coordinates, and their true marks in the halved photos."""
    origin = GeoPosition(**json.loads((SITE / "truth" / "origin.json").read_text()))
    points = ["name,latitude,longitude,height,role"]
    for number, (latitude, longitude, height) in enumerate(enu_to_geodetic(PLACES, origin)):
        role = "check" if f"p{number}" in CHECKS else "control"
        points.append(f"p{number},{latitude:.9f},{longitude:.9f},{height:.4f},{role}")
    truth, marks = pycolmap.Reconstruction(str(SITE / "truth")), ["photo,name,px,py"]
    for image in truth.images.values():
        for number, place in enumerate(PLACES):
            x, y, z = image.cam_from_world().matrix() @ [*place, 1]
            px, py = 450 * x / z + 300, 450 * y / z + 225
            if image.name in SITE_PHOTOS and z > 0 and 0 < px < 600 and 0 < py < 450:
                marks.append(f"{image.name},p{number},{px:.3f},{py:.3f}")
    (tmp_path / "points.csv").write_text("\n".join(points))
    (tmp_path / "marks.csv").write_text("\n".join(marks))
    return tmp_path / "points.csv", tmp_path / "marks.csv"


def test_control_in_a_job(
    files: tuple[Path, Path], finished: tuple[Path, Run], site_photos: Path, tmp_path: Path
) -> None:
    work = tmp_path / "work"
    shutil.copytree(finished[0], work)
    again = ["reconstruct", site_photos, "--workspace", work, *QUICK, "--until", "views"]
    ran = curecon(*again, "--control", *files)
    assert ran.code == 0, ran.said
    assert "sparse: already done" in ran.said and "adjust: already done" not in ran.said
    (component,) = ran.summary["components"]
    assert component["up"] == "control" and "5 control points" in component["note"]
    told = component["control"]
    assert (told["control"]["points"], told["check"]["points"]) == (5, 2) and "left_out" not in told
    pixel = 45 / 450  # metres on the ground
    assert told["check"]["plan"] < 1.5 * pixel and told["check"]["height"] < 3 * pixel
    # What a check point is off is told anew, and nothing is adjusted to it.
    kept = json.loads((work / "control.json").read_text())
    next(point for point in kept["points"] if point["name"] == "p6")["place"][2] += 1.0
    (work / "control.json").write_text(json.dumps(kept))
    ran = curecon(*again)
    assert "adjust: already done" in ran.said and "views: already done" in ran.said
    assert ran.summary["components"][0]["control"]["check"]["height"] == pytest.approx(np.sqrt(0.5), abs=0.15)
    # A file that cannot be used costs nothing of what there was.
    before = read_control(work)
    files[0].write_text(files[0].read_text().replace("p3", "p2"))
    failed = curecon(*again, "--control", *files)
    assert failed.code == 12 and "points.csv, line 5" in failed.said
    assert read_control(work) == before
    assert "adjust: already done" in curecon(*again).said
