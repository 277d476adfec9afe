# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Deliverables say the same as the site, to readers that did not write them; and no more than was chosen."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import copclib
import ezdxf
import laspy
import numpy as np
import pye57
import pytest
import rasterio
import tifffile
from conftest import MakeOnce, Run, curecon
from PIL import Image
from rasterio.warp import transform
from test_extension import blender, run_script  # noqa: F401

from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_utm
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import FORMATS
from curecon_blender.core.base.records import ELLIPSOID, SEA_LEVEL, UNKNOWN, Frame, GeoPosition
from curecon_blender.core.cloud.ply import Cloud, CloudWriter, read_cloud
from curecon_blender.core.deliver.geotiff import NO_HEIGHT, Raster, write_cog
from curecon_blender.core.deliver.placement import DeliverError, Placement
from curecon_blender.core.deliver.systems import geokeys
from curecon_blender.core.deliver.write import Choices, Site, write
from curecon_blender.core.surface.mesh import Mesh, write_mesh
from curecon_blender.core.views import record as views_record

FRAME = Frame(scale="metres", up="gps", north=True, origin=GeoPosition(
    latitude=24.65, longitude=117.05, altitude=520.0, altitude_datum=SEA_LEVEL))
SLOPE = 0.1  # of the little site's ground, upwards to the east
CREDIT = 'A "Surveyor" <a@b> & Søns / 福建\\..\n'


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


# ---- a little site whose measures are known

def little_site(folder: Path, *, frame: str = "local", choices: Choices | None = None, **changes: object) -> Site:
    """Ground of 8 x 6 m that rises to the east, red in the north west and blue elsewhere, with a hole that was filled,
    and a green wall 3 m high that faces south at y = -2."""
    x, y = np.meshgrid(np.linspace(-4, 4, 9), np.linspace(-3, 3, 7))
    ground = np.column_stack([x.ravel(), y.ravel(), SLOPE * x.ravel()])
    cell = np.arange(9 * 7).reshape(7, 9)
    a, b, c, d = (part.ravel() for part in (cell[:-1, :-1], cell[:-1, 1:], cell[1:, 1:], cell[1:, :-1]))
    faces = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    wall = np.array([(-2, -2, 0), (2, -2, 0), (2, -2, 3), (-2, -2, 3)], float)
    vertices = np.concatenate([ground, wall]).astype(np.float32)
    faces = np.concatenate([faces, np.array([(0, 1, 2), (0, 2, 3)]) + len(ground)]).astype(np.int32)
    middle = vertices[faces].mean(axis=1)
    corner = np.array([[0.125, 0.875], [0.13, 0.875], [0.125, 0.87]])  # three places within one colour of the page
    shift = np.zeros((len(faces), 1, 2))
    shift[(middle[:, 0] > 0) | (middle[:, 1] < 0), 0] = [0.5, 0]
    shift[-2:, 0] = [0, -0.5]
    mesh = Mesh(
        vertices=vertices, faces=faces, colours=np.full((len(vertices), 3), 90, np.uint8),
        distance=np.zeros(len(vertices), np.float32), views=np.full(len(vertices), 5, np.uint8),
        filled=(np.abs(middle[:, :2] - [3, 2]).max(axis=1) < 1) & (middle[:, 2] < 1),
    ).with_texture((corner + shift).astype(np.float32), np.zeros(len(faces), np.int32), ("texture_0.png",))
    page = np.zeros((64, 64, 3), np.uint8)
    page[:32, :32], page[:32, 32:], page[32:, :32] = (200, 0, 0), (0, 0, 200), (0, 200, 0)
    (folder / "w").mkdir()
    (folder / "out").mkdir()
    Image.fromarray(page).save(folder / "w" / "texture_0.png")
    write_mesh(folder / "w" / "mesh.ply", mesh)
    points = np.random.default_rng(0).uniform([-4, -3, 0], [4, 3, 0], (4000, 3)).astype(np.float32)
    points[:, 2] = SLOPE * points[:, 0]
    with CloudWriter(folder / "w" / "cloud.ply") as out:
        out.write(Cloud(points, np.full((4000, 3), 90, np.uint8), np.tile(np.float32([0, 0, 1]), (4000, 1)),
                        np.ones(4000, np.float32), np.full(4000, 3, np.uint8)))
    site = Site(cloud=folder / "w" / "cloud.ply", mesh=folder / "w" / "mesh.ply", folder=folder / "out",
                placement=Placement(kind=frame, frame=FRAME, matrix=np.eye(4)), turn_of=lambda mesh, places: 0.0,
                choices=choices or Choices())
    return replace(site, **changes)  # type: ignore[arg-type]


def read(path: Path) -> tuple[np.ndarray, Callable[[float, float], tuple[int, int]]]:
    """A raster's bands (H,W) or (H,W,4), and its pixel at a place."""
    with rasterio.open(path) as file:
        bands = file.read()
        return (bands[0] if len(bands) == 1 else np.moveaxis(bands, 0, 2)), file.index


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


def drawn(path: Path) -> list[tuple[str, np.ndarray]]:
    """A DXF's polylines by their layers, as ezdxf reads them."""
    file = ezdxf.readfile(path)
    audit = file.audit()
    assert not audit.errors, audit.errors
    return [(line.dxf.layer, np.array([vertex.dxf.location for vertex in line.vertices]))
            for line in file.modelspace().query("POLYLINE")]


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
    texts = [f"{latitude:.3f}", f"{longitude:.3f}", f"{altitude:.1f}", f"{east:.0f}", f"{north:.0f}", "UTM", "32650",
             *(Path(photo).stem for photo in photos)]
    found = []
    for file in sorted(folder.rglob("*")):
        content = file.read_bytes()
        found += [f"{file.name}: {text}" for text in texts if text.encode() in content]
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
    assert {"cloud.laz: UTM", "surface_model.tif: UTM", "contours.dxf: UTM"} <= set(told)


# ---- what cannot be made, and bad input

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
            with pytest.raises(Exception, match="disk"):
                write(site, name, Reporter())
            assert not [*disk.iterdir()], name
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_pixels_without_end_are_refused_with_a_size_that_is_not(tmp_path: Path) -> None:
    with pytest.raises(DeliverError, match="100000 a side are the most") as refused:
        write(little_site(tmp_path, choices=Choices(pixel=1e-6)), "dsm", Reporter())
    assert "0.0001 or more" in refused.value.remedy


def test_the_folder_says_what_is_in_it(delivered: Callable[[str], tuple[Path, Run]]) -> None:
    folder, run = delivered("utm")
    told = (folder / "deliverables.txt").read_text(encoding="utf-8")
    assert "above sea level" in told and "EPSG:32650" in told and "Surveyor" in told
    assert all(Path(one["file"]).name in told and one["bytes"] > 0 for one in run.summary["deliverables"])
    assert json.dumps(run.summary)
