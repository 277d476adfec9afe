# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Placing models in the site frame: metres, Z up and north from GPS; gravity, openly, without it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from curecon_blender.core.adjust.adjust import _warn_of_gps
from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.files import write_json
from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_enu, gps_enu
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Frame, GeoPosition, Gimbal, Photo
from curecon_blender.core.base.rotations import from_gimbal
from curecon_blender.core.sparse import record
from curecon_blender.core.sparse.placement import Placement, place

# The Tulou of Fujian.
SITE = GeoPosition(latitude=24.6612, longitude=117.0523, altitude=423.0, altitude_datum="sea level")
UNKNOWN = pycolmap.Sim3d(0.07, pycolmap.Rotation3d(np.array([0.3, -0.5, 0.2, 0.8])), np.array([3.0, -2.0, 5.0]))
GROUND = 150  # sparse points of the ground, the first of the model


def looking_at(centre: np.ndarray, target: np.ndarray) -> np.ndarray:
    """cam_from_world rotation (3,3) of a level camera at `centre`."""
    forward = (target - centre) / np.linalg.norm(target - centre)
    side = np.cross(forward, [0, 0, 1] if abs(forward[2]) < 0.99 else [0, 1, 0])
    right = side / np.linalg.norm(side)
    return np.stack([right, np.cross(forward, right), forward])


def orbit(count: int = 12, radius: float = 40.0, height: float = 30.0) -> tuple[np.ndarray, list[np.ndarray]]:
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    centres = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, height)], axis=1)
    return centres, [looking_at(centre, np.zeros(3)) for centre in centres]


def make_model(centres: np.ndarray, rotations: list[np.ndarray]) -> pycolmap.Reconstruction:
    """The cameras over level ground at z = 0 with a house of two floors on it, around the origin, and some strays, in a
    frame of unknown scale and tilt, as SfM's."""
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 900, 1200, 900)
    model.add_camera_with_trivial_rig(camera)
    for i, (centre, rotation) in enumerate(zip(centres, rotations, strict=True), start=1):
        image = pycolmap.Image(name=f"{i:02d}.jpg", keypoints=np.zeros((400, 2)), camera_id=1, image_id=i)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        model.add_image_with_trivial_frame(image, pose)
    rng = np.random.default_rng(0)
    ground, strays = rng.uniform((-20, -20, -0.1), (20, 20, 0.1), (GROUND, 3)), rng.uniform(-20, -5, (2, 3))
    walls, roof = rng.uniform((-6, -5, 0), (6, -5, 7), (60, 3)), rng.uniform((-6, -5, 7), (6, 5, 8), (80, 3))
    for i, xyz in enumerate(np.concatenate([ground, strays, walls, roof])):
        track = pycolmap.Track()
        for image_id in (1, 2):
            track.add_element(image_id, i)
        model.add_point3D(xyz, track)
    model.transform(UNKNOWN)
    return model


def make_photos(
    centres: np.ndarray, *, gps: bool = True, noise: float = 0.5, site: GeoPosition = SITE
) -> dict[str, Photo]:
    jitter = np.random.default_rng(1).normal(0, noise, centres.shape)
    positions = enu_to_geodetic(centres + jitter, site)
    names = [f"{i:02d}.jpg" for i in range(1, len(centres) + 1)]
    return {
        name: Photo(
            name=name, path=Path(name), width=1200, height=900, camera="c", focal_px=900,
            gps=replace(SITE, latitude=p[0], longitude=p[1], altitude=p[2]) if gps else None,
        )
        for name, p in zip(names, positions.tolist(), strict=True)
    }


def placed_centres(model: pycolmap.Reconstruction, placement: Placement) -> np.ndarray:
    model.transform(placement.site_from_model)
    return np.array([model.image(i).projection_center() for i in sorted(model.reg_image_ids())])


def tilt(model: pycolmap.Reconstruction, rotations: list[np.ndarray]) -> float:
    """Degrees between the placed model's Z and the true one, as the first camera sees both."""
    seen = model.image(1).cam_from_world().rotation.matrix()[:, 2]
    return float(np.degrees(np.arccos(np.clip(seen @ rotations[0][:, 2], -1, 1))))


def height_of_the_ground(model: pycolmap.Reconstruction) -> float:
    return float(np.median([model.point3D(i).xyz[2] for i in sorted(model.point3D_ids())[:GROUND]]))


def test_gps_gives_metres_up_and_north_in_spite_of_an_outlier() -> None:
    centres, rotations = orbit()
    photos = make_photos(centres, noise=0.5)
    stray = photos["03.jpg"].gps
    assert stray is not None
    photos["03.jpg"] = replace(photos["03.jpg"], gps=replace(stray, latitude=stray.latitude + 0.002))
    model = make_model(centres, rotations)
    placement = place(model, photos)
    frame = placement.frame
    assert (frame.scale, frame.up, frame.north) == ("metres", "gps", True)
    assert frame.origin is not None and frame.origin.altitude_datum == "sea level"
    assert frame.gps_residual is not None and frame.gps_residual < 1.5
    assert placement.gps_residuals["03.jpg"] == pytest.approx(222, abs=5)
    assert frame.origin is not None
    origin = geodetic_to_enu(
        np.array([[frame.origin.latitude, frame.origin.longitude, frame.origin.altitude]]), SITE
    )
    assert placed_centres(model, placement) + origin == pytest.approx(centres, abs=1.0)
    assert np.linalg.norm(np.median([p.xyz for p in model.points3D.values()], axis=0)[:2]) < 2.0  # amid the site
    assert height_of_the_ground(model) == pytest.approx(0, abs=0.2)
    assert frame.origin.altitude == pytest.approx(SITE.altitude, abs=2.0)  # what is at 0 now was there
    assert tilt(model, rotations) < 1.0


def test_altitudes_of_two_data_give_one_of_unknown_datum() -> None:
    photos = list(make_photos(orbit()[0]).values())
    gps = photos[0].gps
    assert gps is not None and gps_enu(photos)[1].altitude_datum == "sea level"
    photos[0] = replace(photos[0], gps=replace(gps, altitude_datum="ellipsoid"))
    assert gps_enu(photos)[1].altitude_datum == "unknown"


def test_a_straight_flight_takes_its_tilt_from_the_gimbal() -> None:
    centres = np.stack([np.linspace(-60, 60, 9), np.full(9, -30.0), np.full(9, 25.0)], axis=1)
    gimbal = Gimbal(yaw=0.0, pitch=-40.0, roll=0.0)
    rotations = [from_gimbal(gimbal).T] * 9
    photos = {name: replace(photo, gimbal=gimbal) for name, photo in make_photos(centres, noise=0.3).items()}
    model = make_model(centres, rotations)
    placement = place(model, photos)
    assert (placement.frame.scale, placement.frame.up) == ("metres", "gravity")
    assert "straight line" in placement.frame.note and "gimbal" in placement.frame.note
    assert np.linalg.norm(np.diff(placed_centres(model, placement)[[0, -1]], axis=0)) == pytest.approx(120, abs=2)
    assert tilt(model, rotations) < 1.5


@pytest.mark.parametrize(("with_gps", "spacing", "reason"), [
    (0, 1.0, "No GPS"), (2, 1.0, "Only 2"), (12, 0.02, "too close together"),
])
def test_without_usable_gps_the_scale_is_said_to_be_unknown_and_z_is_up(
    with_gps: int, spacing: float, reason: str
) -> None:
    centres, rotations = orbit()
    photos = make_photos(centres * spacing, noise=0.01)
    for name in list(photos)[with_gps:]:
        photos[name] = replace(photos[name], gps=None)
    model = make_model(centres, rotations)
    placement = place(model, photos)
    assert (placement.frame.scale, placement.frame.up, placement.frame.north) == ("unknown", "gravity", False)
    assert reason in placement.frame.note and "unknown" in placement.frame.note
    model.transform(placement.site_from_model)
    assert tilt(model, rotations) < 2.0
    assert height_of_the_ground(model) == pytest.approx(0, abs=0.2)


def test_gps_of_another_place_is_not_used() -> None:
    centres, rotations = orbit()
    shuffled = np.random.default_rng(5).permutation(centres)
    placement = place(make_model(centres, rotations), make_photos(shuffled))
    assert placement.frame.scale == "unknown"
    assert "does not agree" in placement.frame.note


def test_a_walk_with_rough_gps_takes_its_tilt_from_the_level_cameras() -> None:
    centres = np.stack([np.random.default_rng(1).normal(0, 0.3, 20), np.linspace(0, 60, 20), np.full(20, 1.7)], axis=1)
    rotations = [looking_at(centre, centre + [0, 10.0, 0]) for centre in centres]
    model = make_model(centres, rotations)
    placement = place(model, make_photos(centres, noise=5.0))
    assert (placement.frame.scale, placement.frame.up) == ("metres", "gravity")
    assert "straight line" in placement.frame.note and "level cameras" in placement.frame.note
    model.transform(placement.site_from_model)
    assert tilt(model, rotations) < 8.0


@pytest.mark.parametrize("kind", ["façade", "nadir grid"])
def test_up_without_gps_where_all_cameras_look_one_way(kind: str) -> None:
    along = np.linspace(-10, 10, 5)
    if kind == "façade":
        centres = np.array([[x, -20.0, 1.7] for x in along])
        rotations = [looking_at(np.array([0, -20.0, 1.7]), np.array([0, 0, 2.0]))] * 5
    else:
        centres = np.array([[x, y, 30.0] for x in along for y in along])
        rotations = [np.array([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])] * 25
    model = make_model(centres, rotations)
    placement = place(model, make_photos(centres, gps=False))
    model.transform(placement.site_from_model)
    assert tilt(model, rotations) < 3.0


def test_frame_record_survives_and_a_damaged_one_is_told(tmp_path: Path) -> None:
    frame = Frame(scale="metres", up="gps", north=True, origin=SITE, gps_residual=0.5, note="土楼")
    write_json(tmp_path / record.FRAME_FILE, asdict(frame))
    assert record.read_frame(tmp_path) == frame
    (tmp_path / record.FRAME_FILE).write_text("{", encoding="utf-8")
    with pytest.raises(WorkspaceError, match=r"frame\.json") as caught:
        record.read_frame(tmp_path)
    assert caught.value.remedy


def without_altitude(photos: dict[str, Photo], names: list[str]) -> dict[str, Photo]:
    return {name: replace(photo, gps=replace(photo.gps, altitude=None)) if name in names and photo.gps else photo
            for name, photo in photos.items()}


def two_orbits() -> tuple[np.ndarray, list[np.ndarray]]:
    """Orbits at 20 and 50 metres, and what a drone's gimbal says of each photo."""
    low, high = orbit(12, radius=40.0, height=20.0), orbit(12, radius=25.0, height=50.0)
    return np.concatenate([low[0], high[0]]), [*low[1], *high[1]]


@pytest.mark.parametrize("kind", ["missing", "constant", "all but two missing"])
def test_gps_in_plan_and_gravity_give_metres_where_altitudes_tell_nothing(kind: str) -> None:
    centres, rotations = two_orbits()
    photos = make_photos(centres, noise=0.2)
    if kind == "constant":
        photos = {name: replace(photo, gps=replace(photo.gps, altitude=500.0))
                  for name, photo in photos.items() if photo.gps}
    else:
        photos = without_altitude(photos, list(photos)[0 if kind == "missing" else 2 :])
    model = make_model(centres, rotations)
    placement = place(model, photos)
    frame = placement.frame
    assert (frame.scale, frame.up, frame.north) == ("metres", "gravity", True)
    assert frame.origin is not None and frame.origin.altitude is None
    assert "no altitudes" in frame.note and "heights above the sea are unknown" in frame.note
    assert max(placement.gps_residuals.values()) < 1.5
    found = placed_centres(model, placement)
    assert np.ptp(found, axis=0) == pytest.approx(np.ptp(centres, axis=0), rel=0.01)
    assert tilt(model, rotations) < 0.5
    assert height_of_the_ground(model) == pytest.approx(0, abs=0.2)


def test_a_photo_without_an_altitude_still_counts_in_plan() -> None:
    centres, rotations = two_orbits()
    photos = without_altitude(make_photos(centres, noise=0.2), ["02.jpg", "05.jpg"])
    stray = photos["05.jpg"].gps
    assert stray is not None
    photos["05.jpg"] = replace(photos["05.jpg"], gps=replace(stray, latitude=stray.latitude + 0.002))
    placement = place(make_model(centres, rotations), photos)
    assert (placement.frame.scale, placement.frame.up) == ("metres", "gps")
    assert placement.frame.origin is not None and placement.frame.origin.altitude is not None
    assert placement.gps_residuals["02.jpg"] < 1.5
    assert placement.gps_residuals["05.jpg"] == pytest.approx(222, abs=5)


def test_lengths_are_not_called_metres_where_gps_contradicts() -> None:
    centres, rotations = two_orbits()
    bent = centres + np.stack([0 * centres[:, 0], 0 * centres[:, 1], 0.02 * centres[:, 0] ** 2], axis=1)
    placement = place(make_model(bent, rotations), make_photos(centres, noise=0.2))
    frame = placement.frame
    assert frame.gps_residual is not None and frame.gps_residual > 5
    assert (frame.scale, frame.north) == ("unknown", True)
    assert "contradicts" in frame.note and "not to be taken for metres" in frame.note


@pytest.mark.parametrize("site", [
    replace(SITE, longitude=179.9999), replace(SITE, longitude=-179.9999), replace(SITE, longitude=180.0),
])
def test_longitudes_on_both_sides_of_180_degrees(site: GeoPosition) -> None:
    centres, rotations = orbit()
    photos = make_photos(centres, site=site)
    longitudes = [photo.gps.longitude for photo in photos.values() if photo.gps]
    assert min(longitudes) < -179.99 and max(longitudes) > 179.99
    model = make_model(centres, rotations)
    placement = place(model, photos)
    assert placement.frame.scale == "metres"
    assert placement.frame.origin is not None
    assert abs(placement.frame.origin.longitude) == pytest.approx(180, abs=0.001)
    assert np.ptp(placed_centres(model, placement), axis=0) == pytest.approx(np.ptp(centres, axis=0), abs=2.0)


@pytest.mark.parametrize(("nearer", "words"), [(20.0, "too near to the site"), (-20.0, "too far from the site")])
def test_photos_off_along_their_line_of_sight_have_a_wrong_camera(nearer: float, words: str) -> None:
    centres, rotations = two_orbits()
    zoomed = [1, 3, 5]
    found = centres.copy()
    for i in zoomed:
        found[i] += nearer * rotations[i][2]
    photos = make_photos(centres, noise=0.2)
    stray = photos["20.jpg"].gps  # and one whose GPS is wrong
    assert stray is not None
    photos["20.jpg"] = replace(photos["20.jpg"], gps=replace(stray, latitude=stray.latitude + 0.002))
    reporter = Reporter()
    _warn_of_gps(place(make_model(found, rotations), photos), len(photos), set(), 0, reporter)
    camera, gps = reporter.warnings
    assert words in camera and "by 20 m" in camera and "focal length" in camera
    assert all(f"{i + 1:02d}.jpg" in camera and f"{i + 1:02d}.jpg" not in gps for i in zoomed)
    assert "20.jpg (22" in gps and "Their GPS is wrong" in gps
