# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be delivered, and what must not be: each is said, and nothing is lost or left half."""

from __future__ import annotations

import shutil
import subprocess
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio
from conftest import Run, curecon
from little_site import CREDIT, FRAME, drawn, little_site, read
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import FORMATS
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.deliver.geotiff import NO_HEIGHT
from curecon_blender.core.deliver.placement import DeliverError, Placement
from curecon_blender.core.deliver.write import Choices, write
from curecon_blender.core.surface.mesh import Mesh, write_mesh


def test_a_workspace_without_a_mesh_gives_what_it_can_and_says_so(finished: tuple[Path, Run], tmp_path: Path) -> None:
    shutil.copytree(finished[0], tmp_path / "w")
    run = curecon("export", tmp_path / "w", "--format", "contours", "dsm", "laz", "orthomosaic")
    assert run.code == 0, run.said
    assert [one["format"] for one in run.summary["left_out"]] == ["contours"]
    assert "contours is left out" in run.said and "Build Mesh first" in run.said
    folder = tmp_path / "w" / "deliverables" / "local"
    cloud = read_cloud(tmp_path / "w" / "cloud.ply")
    heights, at = read(folder / "surface_model.tif")
    found = np.array([heights[at(x, y)] for x, y in cloud.points[::50, :2]])
    there = found != NO_HEIGHT
    assert there.mean() > 0.95 and np.median(np.abs(found - cloud.points[::50, 2])[there]) < 0.1
    assert "there is no mesh" in (folder / "deliverables.txt").read_text()
    alone = curecon("export", tmp_path / "w", "--format", "sections")
    assert alone.code == 13 and "Build Mesh first" in alone.said


def test_an_unknown_scale_is_no_place_on_earth(tmp_path: Path) -> None:
    frame = replace(FRAME, scale="unknown")
    with pytest.raises(DeliverError, match="scale is unknown"):
        Placement(kind="utm", frame=frame, matrix=np.eye(4))
    site = little_site(tmp_path, placement=Placement(kind="local", frame=frame, matrix=np.eye(4) * 1e-3))
    for name in ("laz", "dsm", "contours"):
        write(site, name, Reporter())
    with rasterio.open(tmp_path / "out" / "surface_model.tif") as file:
        assert "do not measure" in file.tags()["TIFFTAG_IMAGEDESCRIPTION"] and 10 < file.width < 2000
    las = laspy.read(tmp_path / "out" / "cloud.laz")
    assert np.ptp(las.x) == pytest.approx(8e-3, rel=0.01)


def test_a_mesh_of_two_faces_and_names_full_of_traps(tmp_path: Path) -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 1), (0, 1, 1)], np.float32)
    site = little_site(tmp_path, choices=Choices(credit=CREDIT, licence="CC-BY <4.0> 'x' \"y\" --> ]]>"))
    write_mesh(tmp_path / "w" / "mesh.ply", Mesh(
        vertices=vertices, faces=np.array([(0, 1, 2), (0, 2, 3)], np.int32), colours=np.full((4, 3), 90, np.uint8),
        distance=np.zeros(4, np.float32), views=np.ones(4, np.uint8), filled=np.zeros(2, bool)))
    for name in FORMATS:
        assert write(site, name, Reporter())
    for path in (tmp_path / "out").glob("*.dxf"):
        drawn(path)
    for path in (tmp_path / "out").glob("*.svg"):
        assert "福建" in ET.parse(path).getroot()[0].text  # type: ignore[operator]
    assert {path.parent for path in tmp_path.rglob("*.svg")} == {tmp_path / "out"}


def test_a_missing_page_costs_the_pictures_alone(textured: tuple[Path, Run], tmp_path: Path) -> None:
    shutil.copytree(textured[0], tmp_path / "w")
    for page in (tmp_path / "w" / "textured").glob("texture_*"):
        page.unlink()
    run = curecon("export", tmp_path / "w", "--format", "orthomosaic", "laz")
    assert run.code == 0 and "Run Texture again" in run.said
    assert sorted(path.name for path in (tmp_path / "w" / "deliverables" / "local").iterdir()) == [
        "cloud.laz", "deliverables.txt"]


def test_nobody_elses_files_are_touched_and_frames_are_not_mixed(textured: tuple[Path, Run], tmp_path: Path) -> None:
    shutil.copytree(textured[0], tmp_path / "w")
    folder = tmp_path / "somebody's \"work\""
    folder.mkdir()
    (folder / "cloud.laz").write_text("precious")
    run = curecon("export", tmp_path / "w", "--format", "laz", "--to", folder)
    assert run.code == 5 and "not empty" in run.said and (folder / "cloud.laz").read_text() == "precious"
    run = curecon("export", tmp_path / "w", "--format", "laz", "--to", folder / "cloud.laz")
    assert run.code == 5 and "a file is in the way" in run.said
    other = tmp_path / "a \"quoted\" / place"
    for frame, code in (("utm", 0), ("utm", 0), ("local", 5)):
        run = curecon("export", tmp_path / "w", "--format", "laz", "--to", other, "--frame", frame)
        assert run.code == code, run.said
    assert "another frame (utm)" in run.said


def test_a_disk_that_fills_half_way_leaves_no_half_of_a_file(tmp_path: Path) -> None:
    disk = tmp_path / "out"
    site = little_site(tmp_path, choices=Choices(pixel=0.002))
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", str(disk)], check=False,
                      capture_output=True).returncode:
        pytest.skip("mounting a small disk needs root")
    try:
        for name in ("laz", "copc", "e57", "orthomosaic"):
            with pytest.raises(WorkspaceError, match="disk"):
                write(site, name, Reporter())
            assert not [*disk.iterdir()], name
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_pixels_without_end_are_refused_with_a_size_that_is_not(tmp_path: Path) -> None:
    with pytest.raises(DeliverError, match="100000 a side are the most") as refused:
        write(little_site(tmp_path, choices=Choices(pixel=1e-6)), "dsm", Reporter())
    assert "0.0001 or more" in refused.value.remedy
