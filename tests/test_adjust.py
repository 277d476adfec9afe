# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A flight straight down over flat ground: the maker's calibration and the GPS say what its photos cannot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from curecon_blender.core.adjust.adjust import adjust_cameras, adjust_model
from curecon_blender.core.adjust.bundle import adjust
from curecon_blender.core.adjust.bundle_cpu import residuals
from curecon_blender.core.adjust.conversion import started, to_bundle
from curecon_blender.core.adjust.priors import MAKER, lens_priors
from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_enu
from curecon_blender.core.base.messages import Reporter, Warning
from curecon_blender.core.base.records import GeoPosition, Gimbal, Lens, Photo, PhotoSet
from curecon_blender.core.sparse.models import ADJUSTED, MAPPED, read_model, write_components
from curecon_blender.core.sparse.record import read_frame

WIDTH, HEIGHT, ABOVE = 1600, 1200, 40.0
LENS = Lens(f=1500.0, aspect=1.0, cx=795.0, cy=608.0, k1=-0.12, k2=0.05, p1=0.001, p2=-0.0005, k3=0.0)
ORIGIN = GeoPosition(latitude=24.6, longitude=117.0, altitude=500.0)
RTK = 0.02, 0.03


def flight(
    *, rtk: bool = True, bent: bool = True, oblique: bool = False
) -> tuple[pycolmap.Reconstruction, dict[str, Photo], np.ndarray]:
    """A model of 20 photos, straight down or askew by turns, whose focal length, and so whose height, is a seventh too
    small, as a flight at one height over flat ground may come out of the mapper, or all of it true; the photos with
    their metadata; and their true centres (20,3)."""
    rng = np.random.default_rng(5)
    across = np.stack(np.meshgrid(np.arange(5) * 9.0 - 18, np.arange(4) * 9.0 - 13.5), axis=-1).reshape(-1, 2)
    centres = np.column_stack([across, np.full(len(across), ABOVE)])
    askew = np.array([[0.4 * (n % 3 - 1), 0.4 * (n // 3 % 3 - 1), np.pi / 2 * n] for n in range(20)]) * oblique
    turns = np.array([pycolmap.Rotation3d(rng.normal(0, 0.02, 3) + turn).matrix() @ np.diag([1.0, -1.0, -1.0])
                      for turn in askew])
    points = np.column_stack([rng.uniform(-38, 38, (1500, 2)), rng.uniform(0, 0.3, 1500)])
    lens = np.array([[getattr(LENS, name) for name in ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3")]])
    photo, point = np.repeat(np.arange(len(centres)), len(points)), np.tile(np.arange(len(points)), len(centres))
    nowhere = np.zeros((len(photo), 2))
    pixels = residuals(turns, centres, lens, np.zeros(len(centres), int), points, photo, point, nowhere)
    seen = ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
    pixels = pixels + rng.normal(0, 0.4, pixels.shape)
    sigmas = RTK if rtk else (1.5, 3.0)
    places = enu_to_geodetic(centres + rng.normal(0, 1, centres.shape) * [sigmas[0], sigmas[0], sigmas[1]], ORIGIN)

    model = pycolmap.Reconstruction()
    low = 6 / 7 if bent else 1.0
    params = [low * LENS.f, WIDTH / 2, HEIGHT / 2, low**2 * LENS.k1] if bent else \
        [LENS.f, LENS.f, LENS.cx, LENS.cy, LENS.k1, LENS.k2, LENS.p1, LENS.p2]
    model.add_camera_with_trivial_rig(pycolmap.Camera(
        camera_id=1, model="SIMPLE_RADIAL" if bent else "OPENCV", width=WIDTH, height=HEIGHT, params=params))
    photos, keypoints = {}, {}
    for n, (centre, turn) in enumerate(zip(centres, turns, strict=True)):
        mine = np.flatnonzero(seen & (photo == n))
        keypoints |= {i: (n + 1, row) for row, i in enumerate(mine.tolist())}
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(turn), -turn @ (centre * [1, 1, low]))
        name = f"{n:02}.jpg"
        model.add_image_with_trivial_frame(pycolmap.Image(name, pixels[mine], 1, n + 1), pose)
        photos[name] = Photo(
            name=name, path=Path(name), width=WIDTH, height=HEIGHT, camera="c", focal_px=LENS.f, focal_sigma=0.02,
            lens=LENS,
            gps=GeoPosition(**dict(zip(("latitude", "longitude", "altitude"), places[n].tolist(), strict=True))),
            gps_sigmas=RTK if rtk else None,
        )
    for p, place in enumerate(points):
        track = pycolmap.Track()
        for i in np.flatnonzero(seen & (point == p)).tolist():
            track.add_element(*keypoints[i])
        if track.length() >= 2:
            model.add_point3D(place, track)
    model.update_point_3d_errors()
    return model, photos, centres


def height_above_ground(model: pycolmap.Reconstruction) -> tuple[float, float]:
    """Metres from the ground to the cameras, and by how much the ground sags from the middle to 20 m from it."""
    ground = np.array([point.xyz for point in model.points3D.values()])
    centres = np.array([model.image(i).projection_center() for i in model.reg_image_ids()])
    squared = (ground[:, :2] ** 2).sum(axis=1)
    design = np.column_stack([np.ones(len(ground)), ground[:, :2], squared])
    level, *_, bend = np.linalg.lstsq(design, ground[:, 2], rcond=None)[0]
    return float(centres[:, 2].mean() - level), float(bend * 20**2)


def centres_of(model: pycolmap.Reconstruction) -> np.ndarray:
    return np.array([model.image(i).projection_center() for i in sorted(model.reg_image_ids())])


@pytest.mark.parametrize("rtk", [True, False])
def test_heights_are_true_and_level_ground_is_level(rtk: bool) -> None:
    model, photos, centres = flight(rtk=rtk)
    assert adjust_model(model, photos, ORIGIN, Reporter())
    height, sag = height_above_ground(model)
    assert height == pytest.approx(ABOVE, rel=0.01 if rtk else 0.03)  # of GPS the scale is known to some 2 %
    assert abs(sag) < 0.1
    assert model.camera(1).focal_length_x == pytest.approx(LENS.f, rel=0.005)
    found = centres_of(model)
    assert np.abs(found - centres).mean() < (0.05 if rtk else 1.5)


def test_one_wrong_position_does_not_pull() -> None:
    model, photos, centres = flight()
    gps = photos["07.jpg"].gps
    assert gps is not None
    photos["07.jpg"] = replace(photos["07.jpg"], gps=replace(gps, altitude=gps.altitude + 60))
    adjust_model(model, photos, ORIGIN, Reporter())
    found = centres_of(model)
    assert np.abs(found - centres).max() < 0.15


def test_photos_without_gps_among_others_do_not_count_as_far_off() -> None:
    model, photos, centres = flight()
    for name in list(photos)[::2] + list(photos)[1:4:2]:  # more than half
        photos[name] = replace(photos[name], gps=None, gps_sigmas=None)
    assert adjust_model(model, photos, ORIGIN, Reporter())
    found = centres_of(model)
    assert np.abs(found - centres).max() < 0.15


def test_positions_without_a_fix_do_not_spoil_those_with_one() -> None:
    model, photos, centres = flight()
    rng = np.random.default_rng(3)
    for name in list(photos)[::3]:
        gps = photos[name].gps
        assert gps is not None and gps.altitude is not None
        off = gps.altitude + rng.normal(0, 3)
        photos[name] = replace(photos[name], gps=replace(gps, altitude=off), gps_sigmas=None)
    assert adjust_model(model, photos, ORIGIN, Reporter())
    assert np.abs(centres_of(model) - centres).max() < 0.15


def test_rtk_that_is_lost_within_a_flight_is_told_and_what_it_fixed_holds(tmp_path: Path) -> None:
    """Without a fix, heights count from another level, as a receiver falls back to them."""
    model, photos, centres = flight()
    lost = list(photos)[12:]
    for name in lost:
        gps = photos[name].gps
        assert gps is not None and gps.altitude is not None
        photos[name] = replace(photos[name], gps=replace(gps, altitude=gps.altitude - 20), gps_sigmas=None)
    write_components(tmp_path, MAPPED, [(model, {})])
    reporter = Reporter()
    adjust_cameras(PhotoSet(photos=tuple(photos.values())), tmp_path, reporter)
    (said,) = reporter.warnings  # and nothing of a dome
    assert said.startswith("Only 12 of 20 photos have an RTK fix")
    adjusted = read_model(tmp_path / ADJUSTED / "0")
    frame = read_frame(tmp_path / ADJUSTED / "0")
    assert frame.origin is not None and frame.scale == "metres"
    found = geodetic_to_enu(enu_to_geodetic(centres_of(adjusted), frame.origin), ORIGIN)
    assert np.abs(found - centres).max() < 0.15


def test_a_compass_that_is_off_does_not_turn_the_site() -> None:
    model, photos, centres = flight()
    photos = {name: replace(photo, gimbal=Gimbal(yaw=25.0, pitch=-90.0, roll=0.0)) for name, photo in photos.items()}
    assert adjust_model(model, photos, ORIGIN, Reporter())
    assert np.abs(centres_of(model) - centres).max() < 0.15


def told_by(model: pycolmap.Reconstruction, photos: dict[str, Photo]) -> list[str]:
    told: list[str] = []
    reporter = Reporter(lambda message: told.append(message.text) if isinstance(message, Warning) else None)
    assert adjust_model(model, photos, ORIGIN, reporter)
    return told


@pytest.mark.parametrize("other", [{"k1": 2.0, "k2": -3.0, "k3": 3.0}, {"p1": 0.3}, {"k1": LENS.k1 + 0.15}])
def test_another_cameras_calibration_is_told_and_the_focal_length_used(other: dict[str, float]) -> None:
    model, photos, _ = flight()
    photos = {name: replace(photo, lens=replace(LENS, **other)) for name, photo in photos.items()}
    assert "does not fit the photos" in told_by(model, photos)[0]
    height, sag = height_above_ground(model)
    assert height == pytest.approx(ABOVE, rel=0.01) and abs(sag) < 0.1


def test_a_focal_length_alone_gives_true_heights_and_a_wrong_one_is_not_believed_where_photos_know_better() -> None:
    model, photos, _ = flight(rtk=False)
    photos = {name: replace(photo, lens=None) for name, photo in photos.items()}
    assert told_by(model, photos) == []
    height, _ = height_above_ground(model)
    assert height == pytest.approx(ABOVE, rel=0.03)

    model, photos, _ = flight(oblique=True)
    photos = {name: replace(photo, lens=None, focal_px=1.3 * LENS.f) for name, photo in photos.items()}
    assert told_by(model, photos) == []
    assert model.camera(1).focal_length_x == pytest.approx(LENS.f, rel=0.003)


def test_without_gps_and_calibration_the_photos_alone_tell_the_lens_where_they_look_from_all_sides() -> None:
    model, photos, _ = flight(oblique=True)
    photos = {name: replace(photo, lens=None, focal_px=None, gps=None) for name, photo in photos.items()}
    assert adjust_model(model, photos, None, Reporter())
    assert model.camera(1).focal_length_x == pytest.approx(LENS.f, rel=0.003)
    assert model.camera(1).params[4:6] == pytest.approx([LENS.k1, LENS.k2], abs=0.01)


def test_control_points_pull_a_bent_model_to_the_truth() -> None:
    """No position and no lens is known; eight points are, to 2 mm, by their marks, and a ninth tells how well."""
    model, photos, _ = flight()
    bundle = started(to_bundle(model, photos, lens_priors(model, photos), ORIGIN), [MAKER])
    truth, seen = bundle.points, np.bincount(bundle.point)
    chosen = [int(np.argmin(np.linalg.norm(truth[:, :2] - place, axis=1) + 1000 * (seen < 4)))
              for place in [(x, y) for x in (-18, 0, 18) for y in (-14, 0, 14)]]
    control, check = np.array(chosen[:4] + chosen[5:]), chosen[4]
    marks = np.full(len(bundle.point), np.nan)
    marks[np.isin(bundle.point, control)] = 0.5
    nothing = np.full((20, 3), np.inf)
    bent = replace(
        bundle, position_sigmas=nothing, lens_sigmas=np.array([[np.inf, 1e-9, 1e-9, 1e-9, *[np.inf] * 2, *[1e-9] * 3]]),
        lenses=bundle.lenses * [6 / 7, 1, 1, 1, 0, 0, 1, 1, 1], centres=bundle.centres * [1, 1, 6 / 7],
    )
    known = {"control": control, "control_positions": truth[control] + [3.0, -2.0, 5.0],
             "control_sigmas": np.full((8, 3), 0.002), "observation_sigmas": marks}
    adjusted = adjust(replace(bent, **known))
    off = adjusted.points - [3.0, -2.0, 5.0] - truth
    assert np.abs(off[control]).max() < 0.01
    assert np.abs(off[check]).max() < 0.03
    assert adjusted.lenses[0, 0] == pytest.approx(LENS.f, rel=0.03)  # over flat ground little tells it
