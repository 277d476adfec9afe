# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of control points: every form is read, and whatever is wrong is told with its line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.adjust.control import (
    CHECK,
    CONTROL,
    ControlPoint,
    ControlSet,
    Mark,
    frame_positions,
    read_control,
    write_control,
)
from curecon_blender.core.adjust.control_files import import_files, write_odm
from curecon_blender.core.base.errors import ControlError
from curecon_blender.core.base.geodesy import geodetic_to_utm
from curecon_blender.core.base.records import GeoPosition, Photo

SITE = GeoPosition(latitude=24.6612, longitude=117.0523, altitude=423.0)
PHOTOS = tuple(
    Photo(name=f"DJI_{n:04}.JPG", path=Path(f"/photos/DJI_{n:04}.JPG"), width=4000, height=3000, camera="DJI",
          focal_px=2900.0, gps=replace(SITE, latitude=SITE.latitude + 1e-4 * n, altitude=480.0))
    for n in range(1, 6)
)
EAST, NORTH = geodetic_to_utm(np.array([[SITE.latitude, SITE.longitude]]), 50, south=False)[0]
UTM_LINES = "\n".join(f"gcp{n},{EAST + 10 * n:.3f},{NORTH - 5 * n:.3f},{423 + n}" for n in range(1, 5))
DEGREES = [(f"gcp{n}", SITE.latitude + 1e-5 * n, SITE.longitude - 2e-5 * n, 423.0 + n) for n in range(1, 5)]
WGS_LINES = "\n".join(f"{name},{lat:.8f},{lon:.8f},{z}" for name, lat, lon, z in DEGREES)


def load(folder: Path, text: str | bytes, name: str = "points.csv", *, photos: tuple[Photo, ...] = PHOTOS,
         kept: ControlSet | None = None, system: str = "") -> tuple[ControlSet, list[str]]:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return import_files([path], kept or ControlSet(), photos, system)


def refused(folder: Path, text: str | bytes, *words: str, **how: object) -> ControlError:
    """What is said of a file that cannot be used; the words must be in it, and a remedy."""
    with pytest.raises(ControlError) as caught:
        load(folder, text, **how)  # type: ignore[arg-type]
    said = f"{caught.value.message} {caught.value.remedy}"
    assert all(word in said for word in words), said
    assert caught.value.remedy
    return caught.value


def test_odm_gcp_list(tmp_path: Path) -> None:
    text = ("WGS84 UTM 50N\n# a comment\n"
            f"{EAST:.3f} {NORTH:.3f} 424.5 1200.5 800 DJI_0001.JPG gcp1\n"
            f"{EAST:.3f} {NORTH:.3f} 424.5 900 700.25 DJI_0002.JPG gcp1 extra 5\n"
            f"{EAST + 20:.3f} {NORTH:.3f} NaN 300 200 DJI_0002.JPG gcp2\n"
            f"{EAST + 20:.3f} {NORTH:.3f} NaN 310 205 DJI_0003.JPG gcp2\n")
    control, said = load(tmp_path, text, "gcp_list.txt")
    first, second = control.points
    assert (first.name, first.system) == ("gcp1", "UTM 50N")
    assert first.place == pytest.approx((SITE.latitude, SITE.longitude, 424.5), abs=1e-8)
    assert frame_positions([first], SITE)[0] == pytest.approx([0, 0, 1.5], abs=1e-3)
    assert second.place[2] is None
    assert second.sigmas[2] > 1000 > second.sigmas[0]
    assert [(mark.photo, mark.x, mark.y) for mark in control.marks_of("gcp1")] == [
        ("DJI_0001.JPG", 1200.5, 800.0), ("DJI_0002.JPG", 900.0, 700.25)]
    assert said == ["gcp2 has no height: it holds the plan only."]


def test_odm_gcp_list_without_names_takes_equal_coordinates_for_one_point(tmp_path: Path) -> None:
    rows = [(DEGREES[n // 2], n) for n in range(4)]
    text = "EPSG:4326\n" + "\n".join(f"{p[2]:.8f}\t{p[1]:.8f}\t{p[3]}\t{100 + n}\t{50 + n}\tDJI_000{n + 1}.JPG"
                                     for p, n in rows)
    control, _ = load(tmp_path, text, "gcp_list.txt")
    assert [len(control.marks_of(point.name)) for point in control.points] == [2, 2]
    assert control.points[0].place == pytest.approx(DEGREES[0][1:], abs=1e-8)


def test_odm_geo_gives_photos_positions(tmp_path: Path) -> None:
    text = ("EPSG:4326\n"
            f"DJI_0001.JPG {SITE.longitude} {SITE.latitude} 480.2\n"
            f"DJI_0002.JPG {SITE.longitude} {SITE.latitude} 481.0 12.0 -90 0 0.02 0.03\n")
    control, _ = load(tmp_path, text, "geo.txt")
    assert not control.points
    first, second = control.positions
    assert first.place == pytest.approx((SITE.latitude, SITE.longitude, 480.2))
    assert (first.sigma_plan, second.sigma_plan, second.sigma_height) == (None, 0.02, 0.03)


def test_pix4d_points_and_marks(tmp_path: Path) -> None:
    points, marks = tmp_path / "gcp.csv", tmp_path / "marks.csv"
    points.write_text(WGS_LINES.replace("424.0", "424.0,0.01,0.015"))
    marks.write_text("DJI_0001.JPG,gcp1,100.5,200.25,1.0\nDJI_0002.JPG,gcp1,110,210,0.5\n")
    control, _ = import_files([points, marks], ControlSet(), PHOTOS)
    assert control.points[0].place == pytest.approx(DEGREES[0][1:], abs=1e-8)
    assert (control.points[0].sigma_plan, control.points[0].sigma_height) == (0.01, 0.015)
    assert (control.points[1].sigma_plan, control.points[1].sigma_height) == (0.02, 0.03)
    assert [(mark.photo, mark.x) for mark in control.marks] == [("DJI_0001.JPG", 100.5), ("DJI_0002.JPG", 110.0)]
    # The marks alone, later.
    again, _ = import_files([marks], control, PHOTOS)
    assert again == control


def test_metashape(tmp_path: Path) -> None:
    text = ('# CoordinateSystem: PROJCS["WGS 84 / UTM zone 50N",AUTHORITY["EPSG","32650"]]\n'
            "#Label,X/East,Y/North,Z/Altitude,Accuracy_(m),Error_(m),X_error,Y_error,Z_error,X_est,Y_est,Z_est\n"
            f"point 1,{EAST:.3f},{NORTH:.3f},424.000,0.005,0.01,0,0,0,1,2,3\n"
            f"point 2,{EAST + 9:.3f},{NORTH:.3f},425.000,,0.01,0,0,0,1,2,3\n"
            "# Total error,,,,,0.01,0,0,0\n")
    control, _ = load(tmp_path, text)
    assert [point.name for point in control.points] == ["point 1", "point 2"]
    assert control.points[0].place == pytest.approx((SITE.latitude, SITE.longitude, 424), abs=1e-8)
    assert (control.points[0].sigma_plan, control.points[1].sigma_plan) == (0.005, 0.02)


def test_metashape_in_degrees_has_longitude_first(tmp_path: Path) -> None:
    rows = "\n".join(f"{name},{lon:.8f},{lat:.8f},{z},0.01" for name, lat, lon, z in DEGREES)
    control, _ = load(tmp_path, "#Label,X/Longitude,Y/Latitude,Z/Altitude,Accuracy_(m)\n" + rows)
    assert control.points[2].place == pytest.approx(DEGREES[2][1:], abs=1e-8)


@pytest.mark.parametrize("photos", [PHOTOS, ()], ids=["with photos", "without"])
def test_plain_degrees_utm_and_local_metres_are_told_apart(tmp_path: Path, photos: tuple[Photo, ...]) -> None:
    assert load(tmp_path, WGS_LINES, photos=photos)[0].points[3].place == pytest.approx(DEGREES[3][1:], abs=1e-8)
    local = load(tmp_path, "a,0,0,0\nb,24.3,117.1,1.25\nc,-3.5,40,0", photos=photos)[0]
    assert local.is_local and local.points[1].place == (24.3, 117.1, 1.25)
    if photos:
        assert load(tmp_path, UTM_LINES)[0].points[0].system == "UTM 50N"
    else:
        refused(tmp_path, UTM_LINES, "points.csv, line 1", "UTM 50N", photos=())
        assert load(tmp_path, UTM_LINES, photos=(), system="UTM 50N")[0].points[0].system == "UTM 50N"


@pytest.mark.parametrize("header", [
    "name,lat,lon,height", "Point ID;Latitude [deg];Longitude [deg];Ellipsoid Height (m)",
    "label\tlongitude\tlatitude\tz",
])
def test_a_header_says_which_column_is_what(tmp_path: Path, header: str) -> None:
    by = ";" if ";" in header else "\t" if "\t" in header else ","
    rows = [[name, f"{lon:.8f}", f"{lat:.8f}", str(z)] if header.startswith("label") else
            [name, f"{lat:.8f}", f"{lon:.8f}", str(z)] for name, lat, lon, z in DEGREES]
    control, _ = load(tmp_path, "\n".join([header, *(by.join(row) for row in rows)]))
    assert control.points[0].place == pytest.approx(DEGREES[0][1:], abs=1e-8)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_letters_of_every_kind(tmp_path: Path, encoding: str) -> None:
    control, _ = load(tmp_path, WGS_LINES.replace("gcp1", "Tür 1").encode(encoding))
    assert control.points[0].name == "Tür 1"
    assert control.points[0].place == pytest.approx(DEGREES[0][1:], abs=1e-8)


@pytest.mark.parametrize("by", [";", "\t", " "])
def test_decimal_commas(tmp_path: Path, by: str) -> None:
    rows = [by.join([name, f"{lat:.8f}".replace(".", ","), f"{lon:.8f}".replace(".", ","), "424,5"])
            for name, lat, lon, _ in DEGREES]
    control, _ = load(tmp_path, "\n".join(rows))
    assert control.points[1].place == pytest.approx((*DEGREES[1][1:3], 424.5), abs=1e-8)


def test_decimal_commas_between_commas_cannot_be_read(tmp_path: Path) -> None:
    refused(tmp_path, "a,500123,45,2720456,78,12,34\nb,500143,45,2720456,70,12,30", "commas", "semicolons")


def test_points_in_another_place_name_the_line_and_what_was_expected(tmp_path: Path) -> None:
    far = WGS_LINES.replace("24.66123000", "25.66123000")
    refused(tmp_path, far, "points.csv, line 3", "gcp3", "km", "24.66", "117.05")


def test_the_wrong_zone_is_recognised(tmp_path: Path) -> None:
    refused(tmp_path, f"WGS84 UTM 49N\n{UTM_LINES}", "line 2", "UTM 50N")


def test_utm_read_as_degrees_and_degrees_read_as_utm(tmp_path: Path) -> None:
    refused(tmp_path, f"EPSG:4326\n{UTM_LINES}", "line 2", "not in degrees")
    refused(tmp_path, f"UTM 50N\n{WGS_LINES}", "line 2", "latitude 24.66")


def test_exchanged_axes(tmp_path: Path) -> None:
    swapped = "\n".join(f"{n},{lon:.8f},{lat:.8f},{z}" for n, lat, lon, z in DEGREES)
    refused(tmp_path, swapped, "line 1", "exchange")
    refused(tmp_path, "name,lat,lon,z\n" + swapped, "line 2", "exchange", "no place on Earth")
    # 24.66 degrees east of a site at 24.66 degrees north would be a place on Earth.
    near = tuple(replace(photo, gps=replace(SITE, latitude=47.0, longitude=8.0)) for photo in PHOTOS)
    refused(tmp_path, "name,lat,lon,z\na,8.0,47.0,400\nb,8.0001,47.0001,400", "line 2", "km", "exchanged", photos=near)
    utm = "\n".join(f"gcp{n},{NORTH:.3f},{EAST + n:.3f},400" for n in range(3))
    refused(tmp_path, utm, "line 1", "exchanged")
    refused(tmp_path, f"UTM 50N\n{utm}", "line 2", "exchanged")


def test_a_mark_outside_of_its_photo(tmp_path: Path) -> None:
    text = f"UTM 50N\n{EAST} {NORTH} 424 4100 800 DJI_0001.JPG gcp1\n"
    refused(tmp_path, text, "points.csv, line 2", "4100", "4000 x 3000")


def test_two_points_of_one_name(tmp_path: Path) -> None:
    refused(tmp_path, WGS_LINES.replace("gcp3", "gcp2"), "points.csv, line 3", "gcp2", "points.csv, line 2")


def test_a_photo_that_is_not_in_the_job_is_told_and_left_out(tmp_path: Path) -> None:
    text = "UTM 50N\n" + "".join(f"{EAST} {NORTH} 424 100 800 {photo} gcp1\n"
                                 for photo in ("DJI_0001.JPG", "dji_0002.jpg", "DJI_0099.JPG"))
    control, said = load(tmp_path, text)
    assert [mark.photo for mark in control.marks] == ["DJI_0001.JPG", "DJI_0002.JPG"]
    assert said == ["points.csv, line 4: there is no photo DJI_0099.JPG in this job; it is left out."]
    refused(tmp_path, text.replace("DJI_000", "IMG_000").replace("dji_000", "IMG_100"), "None of the marked photos")


def test_a_point_that_is_marked_once(tmp_path: Path) -> None:
    said = load(tmp_path, f"UTM 50N\n{EAST} {NORTH} 424 100 800 DJI_0001.JPG gcp1\n")[1]
    assert said == ["gcp1 is marked in one photo only and takes no part: mark it in a second."]


def test_missing_heights(tmp_path: Path) -> None:
    control, _ = load(tmp_path, "\n".join(line.rpartition(",")[0] for line in WGS_LINES.splitlines()))
    assert control.points[0].place[2] is None
    refused(tmp_path, "name,x,y,z\na,1,,3\nb,2,2,2", "line 2", "north")


@pytest.mark.parametrize("sigma", ["0", "-0.01", "0.0"])
def test_an_accuracy_of_nothing(tmp_path: Path, sigma: str) -> None:
    refused(tmp_path, WGS_LINES.replace("426.0", f"426.0,{sigma},0.01"), "points.csv, line 3", "0.02")


def test_heights_in_feet_are_doubted(tmp_path: Path) -> None:
    _, said = load(tmp_path, WGS_LINES.replace(",424.0", ",4240.0"))
    assert said == ["The height of gcp1 is more than 1000 m from the photos'. Heights are in metres: check them."]


def test_marks_of_a_point_without_coordinates(tmp_path: Path) -> None:
    refused(tmp_path, "DJI_0001.JPG,gcp1,100,200\n", "points.csv, line 1", "gcp1", "coordinates")


def test_a_mark_twice_in_one_photo(tmp_path: Path) -> None:
    text = f"UTM 50N\n{EAST} {NORTH} 4 10 80 DJI_0001.JPG a\n{EAST} {NORTH} 4 90 80 DJI_0001.JPG a\n"
    refused(tmp_path, text, "points.csv, line 3", "second time", "line 2")


@pytest.mark.parametrize(("text", "words"), [
    ("", ("no points",)), ("# nothing\n", ("no points",)), (b"PK\x03\x04\0\0\0\xff\xfe" * 20, ("no text",)),
    ("hello\nworld\n", ("line 1", "no point")), ("a,1,2,3\nb,1,x,3\n", ("line 2", "'x'")),
    ("EPSG:abc\na,1,2,3\n", ("line 1", "system")), ("a,1,2,3\nb,99999,2,3\n", ("line 2", "too large")),
], ids=lambda value: repr(value)[:20])
def test_what_is_no_such_file(tmp_path: Path, text: str | bytes, words: tuple[str, ...]) -> None:
    refused(tmp_path, text, *words, photos=(), system="local" if b"99999" in str(text).encode() else "")


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ControlError, match="cannot be read"):
        import_files([tmp_path / "none.csv"], ControlSet(), PHOTOS)


def test_local_points_do_not_mix_with_others(tmp_path: Path) -> None:
    kept, _ = load(tmp_path, WGS_LINES)
    refused(tmp_path, "a,0,0,0\nb,10,5,1\n", "a is in local metres", kept=kept, system="local")


def test_a_national_grid_needs_pyproj_and_says_so(tmp_path: Path) -> None:
    try:
        import pyproj  # type: ignore[import-not-found, unused-ignore]  # noqa: F401
    except ImportError:
        refused(tmp_path, f"EPSG:2180\n{UTM_LINES}", "pyproj", "EPSG:2180", "UTM")
        return
    control, _ = load(tmp_path, "EPSG:2056\na,2600000,1200000,500\nb,2600010,1200000,500", photos=())
    assert control.points[0].place == pytest.approx((46.951083, 7.438632, 500), abs=1e-5)  # Bern, the grid's origin


def test_what_is_written_for_odm_comes_back(tmp_path: Path) -> None:
    control, _ = load(tmp_path, UTM_LINES)
    control = control.with_points([replace(control.points[1], role=CHECK, sigma_plan=0.005)])
    control = control.with_marks(Mark(point=name, photo=photo.name, x=10.125, y=20.5, sigma=0.3)
                                 for name in ("gcp1", "gcp2", "gcp3") for photo in PHOTOS[:2])
    said = write_odm(tmp_path / "gcp_list.txt", control)
    assert said and "gcp4" in said[0]
    text = (tmp_path / "gcp_list.txt").read_text()
    assert text.startswith("WGS84 UTM 50N\n")
    assert text.splitlines()[1].split("\t")[3:7] == ["10.125", "20.500", "DJI_0001.JPG", "gcp1"]
    back, _ = import_files([tmp_path / "gcp_list.txt"], ControlSet(), PHOTOS)
    assert back.marks == control.marks
    assert back.points == control.points[:3]


def test_the_workspace_keeps_points_and_marks(tmp_path: Path) -> None:
    assert read_control(tmp_path) == ControlSet()
    control, _ = load(tmp_path, WGS_LINES)
    control = control.with_marks([Mark(point="gcp1", photo="DJI_0001.JPG", x=1, y=2)])
    write_control(tmp_path, control)
    assert read_control(tmp_path) == control
    write_control(tmp_path, ControlSet())
    assert not (tmp_path / "control.json").exists()


def test_a_second_import_keeps_roles_that_the_file_does_not_tell(tmp_path: Path) -> None:
    control, _ = load(tmp_path, WGS_LINES)
    control = control.with_points([replace(control.points[0], role=CHECK)])
    again, _ = load(tmp_path, WGS_LINES.replace("424.0", "424.5"), kept=control)
    assert (again.points[0].role, again.points[0].place[2]) == (CHECK, 424.5)
    assert again.points[1].role == CONTROL


def test_points_and_marks_can_be_removed() -> None:
    point = ControlPoint(name="a", system="local", given=(0, 0, 0), place=(0, 0, 0))
    control = ControlSet().with_points([point]).with_marks([Mark(point="a", photo=p, x=1, y=1) for p in "12"])
    assert [mark.photo for mark in control.without_mark("a", "1").marks] == ["2"]
    assert control.without_point("a") == ControlSet()
