# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Deliverables say the same as the site, to readers that did not write them; and no more than was chosen."""

from __future__ import annotations

import json
import shutil
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import copclib
import laspy
import numpy as np
import pye57
import pytest
import rasterio
import tifffile
from conftest import MakeOnce, Run, curecon
from little_site import CREDIT, FRAME, SLOPE, drawn, little_site, read
from rasterio.warp import transform
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_utm
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import FORMATS
from curecon_blender.core.base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, Frame
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.deliver.geotiff import NO_HEIGHT, Raster, write_cog
from curecon_blender.core.deliver.placement import Placement
from curecon_blender.core.deliver.systems import geokeys
from curecon_blender.core.deliver.write import Choices, write
from curecon_blender.core.views import record as views_record


def test_the_button_in_blender(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    (tmp_path / "work").mkdir()
    run_script(blender, "check_deliver.py", tmp_path / "work", Path(sys.executable), resources=tmp_path / "user")


@pytest.fixture(scope="session")
def delivered(textured: tuple[Path, Run], made_once: MakeOnce[Run]) -> Callable[[str], tuple[Path, Run]]:
    """Everything that there is of a part of the sample site, in a frame: (folder, run). Read only."""
    def of(frame: str) -> tuple[Path, Run]:
        def make(folder: Path) -> tuple[Path, Run]:
            shutil.copytree(textured[0], folder / "w")
            return folder, curecon("export", folder / "w", "--format", *FORMATS, "--frame", frame,
                                   "--to", folder / "out", "--credit", CREDIT)
        folder, run = made_once(f"delivered_{frame}", make)
        assert run.code == 0 and not run.summary["left_out"], run.said
        return folder / "out", run
    return of


def expected(workspace: Path) -> np.ndarray:
    """The cloud's points (N,3) in UTM, by PROJ."""
    frame = views_record.read(workspace)[0].frame
    assert frame.origin is not None
    places = enu_to_geodetic(read_cloud(workspace / "cloud.ply").points.astype(np.float64), frame.origin)
    east, north = transform("EPSG:4326", "EPSG:32650", places[:, 1], places[:, 0])
    return np.column_stack([east, north, places[:, 2]])


def test_other_readers_find_the_cloud_in_laz_copc_and_e57(
    textured: tuple[Path, Run], delivered: Callable[[str], tuple[Path, Run]]
) -> None:
    folder, _ = delivered("utm")
    cloud, places = read_cloud(textured[0] / "cloud.ply"), expected(textured[0])
    reader = copclib.LazReader(str(folder / "cloud.laz"))  # not the library that wrote it
    points = reader.GetPoints()
    assert np.abs(np.column_stack([points.x, points.y, points.z]) - places).max() < 0.0006
    assert np.array_equal(np.array(points.red) // 257, cloud.colours[:, 0])
    config = reader.laz_config
    assert 'AUTHORITY["EPSG","32650"]' in config.wkt and 'AUTHORITY["EPSG","5714"]' in config.wkt  # above sea level
    assert config.las_header.point_format_id == 7

    las = laspy.read(folder / "cloud.laz")
    assert np.abs(np.array(las["confidence"]) / 100 - cloud.confidence).max() < 0.0051
    assert np.array_equal(las["views"], cloud.views)
    assert np.abs(np.array(las["sigma_z"]) / 1000 - cloud.sigmas[:, 2]).max() < 0.00051 and cloud.sigmas.any()

    copc = copclib.FileReader(str(folder / "cloud.copc.laz"))
    assert copc.ValidateSpatialBounds() and copc.copc_config.las_header.point_count == len(cloud)
    with laspy.CopcReader.open(str(folder / "cloud.copc.laz")) as tree:
        found = tree.query()
        coarse = tree.query(level=0)
    assert 0 < len(coarse) <= len(found) == len(cloud)
    assert np.array_equal(np.sort(np.asarray(found.X)), np.sort(np.asarray(las.X)))

    scan = pye57.E57(str(folder / "cloud.e57")).read_scan(0, ignore_missing_fields=True, colors=True, intensity=True)
    there = np.column_stack([scan[f"cartesian{axis}"] for axis in "XYZ"])
    assert np.abs(there - places).max() < 0.001 and np.array_equal(scan["colorGreen"], cloud.colours[:, 1])


def test_rasters_lie_where_the_cloud_does(
    textured: tuple[Path, Run], delivered: Callable[[str], tuple[Path, Run]]
) -> None:
    folder, _ = delivered("utm")
    places = expected(textured[0])
    colours = read_cloud(textured[0] / "cloud.ply").colours.astype(int)
    with rasterio.open(folder / "surface_model.tif") as heights, rasterio.open(folder / "orthomosaic.tif") as picture:
        assert heights.crs.to_string().startswith("COMPD_CS") and picture.crs.to_epsg() == 32650
        assert heights.nodata == NO_HEIGHT and picture.count == 4
        found = np.array([value[0] for value in heights.sample(places[:, :2])])
        seen = np.array([*picture.sample(places[:, :2])]).astype(int)
    there = found != NO_HEIGHT
    assert there.mean() > 0.6
    # The mesh is coarse and the points scatter; but few may lie above what is topmost.
    assert np.median(np.abs(found - places[:, 2])[there]) < 0.3
    assert (places[there, 2] > found[there] + 1.0).mean() < 0.03
    top = there & (np.abs(found - places[:, 2]) < 0.2) & (seen[:, 3] == 255)
    assert np.median(np.abs(seen[top, :3] - colours[top]).mean(axis=1)) < 20


@pytest.mark.parametrize("colour", [True, False])
def test_a_cog_has_its_directories_first_and_its_overviews_before_the_full_picture(
    tmp_path: Path, colour: bool
) -> None:
    width, height = 1300, 1111
    values = np.random.default_rng(0).integers(1, 200, (height, width, 4)).astype(np.uint8)
    values[..., 3] = 255
    if not colour:
        values = values[..., 0].astype(np.float32) * 1.7
    values[:600, :700] = 0 if colour else NO_HEIGHT
    path = tmp_path / "a.tif"
    keys = geokeys(Placement(kind="local", frame=FRAME, matrix=np.eye(4)), heights=not colour)
    write_cog(path, Raster(width=width, height=height, colour=colour, left=10.5, top=20.0, pixel=0.25, keys=keys,
                           description="words"), (values[y : y + 512] for y in range(0, height, 512)))
    with rasterio.open(path) as file:
        read = file.read()
        assert np.array_equal(np.moveaxis(read, 0, 2) if colour else read[0], values)
        assert file.overviews(1) == [2, 4] and file.transform.to_gdal() == (10.5, 0.25, 0, 20.0, 0, -0.25)
        half = file.read(1, out_shape=(-(-height // 2), width // 2))
    quad = values[700:702, 800:802, 0] if colour else values[700:702, 800:802]
    assert half[350, 400] == pytest.approx(quad.astype(float).mean(), abs=0.51 if colour else 1e-3)
    assert half[100, 100] == (0 if colour else NO_HEIGHT)  # the mean of nothing is nothing
    with tifffile.TiffFile(path) as file:
        directories = [page.offset for page in file.pages]
        data = [min(page.dataoffsets) for page in file.pages]
    assert directories == sorted(directories) and data == sorted(data, reverse=True)
    assert max(directories) < min(data)
    assert [*tmp_path.iterdir()] == [path]


def test_heights_and_colours_of_a_site_that_is_known(tmp_path: Path) -> None:
    site = little_site(tmp_path, choices=Choices(pixel=0.1))
    write(site, "dsm", Reporter())
    heights, at = read(tmp_path / "out" / "surface_model.tif")
    for x, y in ((-3.95, 2.95), (0.05, -1.55), (2.05, 0.05)):
        assert heights[at(x, y)] == pytest.approx(SLOPE * x, abs=1e-5)
    assert heights[at(3.0, 2.0)] == NO_HEIGHT  # filled: nobody measured it
    write(site, "orthomosaic", Reporter())
    colours, at = read(tmp_path / "out" / "orthomosaic.tif")
    assert [*colours[at(-3.05, 2.05)]] == [200, 0, 0, 255]  # north west: neither mirrored nor turned
    assert [*colours[at(3.05, -2.55)]] == [0, 0, 200, 255] and colours[at(3.0, 2.0)][3] == 0


def test_a_facade_is_seen_square_and_its_world_file_says_where(tmp_path: Path) -> None:
    site = little_site(tmp_path, choices=Choices(pixel=0.05))
    files = {path.name: path for path, _ in write(site, "facades", Reporter())}
    assert set(files) == {f"facade_{side}.tif" for side in ("north", "east", "south", "west")}
    colours, at = read(files["facade_south.tif"])
    assert [*colours[at(1.02, 2.03)]] == [0, 200, 0, 255]  # x to the right is east, seen from the south
    assert colours[at(2.52, 2.03)][3] == 0 and colours[at(-3.0, 2.9)][3] == 0
    behind, at = read(files["facade_north.tif"])
    assert behind[at(-1.02, 2.03)][3] == 0  # the wall's back was not measured
    step, _, _, down, left, top = map(float, files["facade_south.tif"].with_suffix(".tfw").read_text().split())
    with rasterio.open(files["facade_south.tif"]) as file:
        assert (step, down) == (0.05, -0.05) and file.xy(0, 0) == pytest.approx((left, top))


def test_contours_and_cuts_are_where_the_surface_is(tmp_path: Path) -> None:
    choices = Choices(interval=0.1, plans=(0.25,), sections=((-3.0, -1.0, 3.0, -1.0), (0.5, -2.9, 0.5, 2.9)))
    site = little_site(tmp_path, choices=choices)
    for name in ("contours", "sections"):
        write(site, name, Reporter())
    lines = drawn(tmp_path / "out" / "contours.dxf")
    assert {layer for layer, _ in lines} == {"CONTOUR", "CONTOUR_INDEX", "CONTOUR_FILLED"}
    for layer, points in lines:
        ground = points[np.abs(points[:, 1] + 2) > 1e-6]  # the wall stands at y = -2
        assert np.allclose(ground[:, 0] * SLOPE, ground[:, 2], atol=1e-4)
        if layer == "CONTOUR_FILLED":
            assert (points[:, 0] >= 2 - 1e-4).all() and (points[:, 1] >= 1 - 1e-4).all()
    level = [points for _, points in drawn(tmp_path / "out" / "plan_0_25.dxf")]
    wall = next(points for points in level if np.allclose(points[:, 1], -2))
    assert sorted(wall[:, 0])[:: len(wall) - 1] == pytest.approx([-2, 2])
    along = np.concatenate([points for _, points in drawn(tmp_path / "out" / "section_1.dxf")])
    assert np.allclose(along[:, 1], SLOPE * (along[:, 0] - 3), atol=1e-4)
    assert along[:, 0].min() == pytest.approx(0, abs=1e-4) and along[:, 0].max() == pytest.approx(6, abs=1e-4)
    across = np.concatenate([points for _, points in drawn(tmp_path / "out" / "section_2.dxf")])
    assert across[:, 1].max() == pytest.approx(3)  # the wall
    svg = ET.parse(tmp_path / "out" / "section_2.svg").getroot()
    assert "1:20\n" in next(svg.iter("{http://www.w3.org/2000/svg}desc")).text  # type: ignore[operator]


def test_the_adjusted_frame_is_what_is_written(tmp_path: Path) -> None:
    matrix = np.diag([2.0, 2.0, 2.0, 1.0])
    matrix[2, 3] = 5.0
    site = little_site(tmp_path, placement=Placement(kind="local", frame=FRAME, matrix=matrix),
                       choices=Choices(pixel=0.2))
    write(site, "dsm", Reporter())
    write(site, "laz", Reporter())
    heights, at = read(tmp_path / "out" / "surface_model.tif")
    assert heights[at(-6.0, 3.9)] == pytest.approx(5 - 0.6, abs=0.02)
    las = laspy.read(tmp_path / "out" / "cloud.laz")
    assert np.ptp(las.x) == pytest.approx(16, abs=0.1) and np.median(las.z) == pytest.approx(5, abs=0.1)


@pytest.mark.parametrize(("datum", "said", "system"), [
    (SEA_LEVEL, "above sea level", "MSL"), (ELLIPSOID, "not above sea level", "ellipsoid"),
    (UNKNOWN, "unknown datum", None),
])
def test_what_altitudes_count_from_is_said_plainly(tmp_path: Path, datum: str, said: str, system: str | None) -> None:
    assert FRAME.origin is not None
    frame = replace(FRAME, origin=replace(FRAME.origin, altitude_datum=datum))
    site = little_site(tmp_path, placement=Placement(kind="utm", frame=frame, matrix=np.eye(4)))
    write(site, "dsm", Reporter())
    write(site, "laz", Reporter())
    with rasterio.open(tmp_path / "out" / "surface_model.tif") as file:
        assert said in file.tags()["TIFFTAG_IMAGEDESCRIPTION"]
        assert (system or "PROJCS") in file.crs.to_wkt()
        assert file.read(1).max() == pytest.approx(520.4, abs=0.2)
    wkt = laspy.read(tmp_path / "out" / "cloud.laz").header.vlrs.get("WktCoordinateSystemVlr")[0].string
    assert (system in wkt) if system else ("VERT_CS" not in wkt)


def test_the_site_frame_comes_to_the_same_place_on_earth_as_utm(tmp_path: Path) -> None:
    middles = []
    for frame in ("site", "utm"):
        (tmp_path / frame).mkdir()
        write(little_site(tmp_path / frame, frame=frame), "orthomosaic", Reporter())
        with rasterio.open(tmp_path / frame / "out" / "orthomosaic.tif") as file:
            x, y = (file.bounds.left + file.bounds.right) / 2, (file.bounds.bottom + file.bounds.top) / 2
            middles.append(transform(file.crs, "EPSG:4326", [x], [y]))
    assert np.allclose(*middles, atol=3e-7)  # degrees: 3 cm


# ---- what is not told

def tellings(folder: Path, frame: Frame, photos: list[str]) -> list[str]:
    """What the bytes of all files tell of a site's position, height, time or photos: as text or as a number."""
    assert frame.origin is not None and frame.origin.altitude is not None
    latitude, longitude, altitude = frame.origin.latitude, frame.origin.longitude, frame.origin.altitude
    east, north = geodetic_to_utm(np.array([[latitude, longitude]]), 50, south=False)[0]
    # The latitude to a metre, cut and not rounded: a place on the site may have the same four decimals.
    texts = [f"{latitude:.6f}"[:-1], f"{longitude:.3f}", f"{altitude:.1f}", f"{east:.0f}", f"{north:.0f}",
             "UTM zone", "Transverse", "32650", *(Path(photo).stem for photo in photos)]
    found = []
    for file in sorted(folder.rglob("*")):
        content = file.read_bytes()
        found += [f"{file.name}: {text}" for text in texts if text.encode() in content]
        if file.suffix in (".dxf", ".svg", ".txt") and b"UTM" in content:  # what is packed has any three letters
            found.append(f"{file.name}: UTM")
        for start in range(8):
            numbers = np.frombuffer(content[start : start + (len(content) - start) // 8 * 8], "<f8")
            for name, value, near in (("latitude", latitude, 1e-5), ("longitude", longitude, 1e-5),
                                      ("easting", east, 1.0), ("northing", north, 1.0)):
                with np.errstate(invalid="ignore"):
                    if (np.abs(numbers - value) < near).any():
                        found.append(f"{file.name}: {name}")
    return found


def test_no_byte_of_the_local_frame_tells_where_the_site_is(
    textured: tuple[Path, Run], delivered: Callable[[str], tuple[Path, Run]]
) -> None:
    component = views_record.read(textured[0])[0]
    photos = [view.name for view in component.views]
    folder, run = delivered("local")
    assert not tellings(folder, component.frame, photos) and not run.summary["position"]
    las = laspy.read(folder / "cloud.laz")
    assert np.abs(las.header.offsets).max() < 1000 and not np.asarray(las.gps_time).any()
    told = tellings(delivered("utm")[0], component.frame, [])  # the search finds what is there to be found
    assert {"cloud.laz: UTM zone", "surface_model.tif: UTM zone", "contours.dxf: UTM"} <= set(told)


def test_the_folder_says_what_is_in_it(delivered: Callable[[str], tuple[Path, Run]]) -> None:
    folder, run = delivered("utm")
    told = (folder / "deliverables.txt").read_text(encoding="utf-8")
    assert "above sea level" in told and "EPSG:32650" in told and "Surveyor" in told
    assert all(Path(one["file"]).name in told and one["bytes"] > 0 for one in run.summary["deliverables"])
    assert json.dumps(run.summary)
