# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points place a site, hold it in the adjustment, and check points tell how true it is without taking part."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from test_adjust import HEIGHT, LENS, ORIGIN, WIDTH, flight

from curecon_blender.core.adjust.adjust import adjust_cameras, place_and_adjust
from curecon_blender.core.adjust.bundle import Bundle, adjust
from curecon_blender.core.adjust.control import CHECK, CONTROL, ControlPoint, ControlSet, Mark, write_control
from curecon_blender.core.adjust.control_bundle import gps_in_frame, left_out, with_control
from curecon_blender.core.adjust.control_frame import (
    compared,
    control_placement,
    doubtful,
    marked_points,
    residuals,
    tell_checks,
)
from curecon_blender.core.adjust.marking import seen, to_pixels
from curecon_blender.core.adjust.record import read_accuracy, rms
from curecon_blender.core.base.errors import ControlError
from curecon_blender.core.base.geodesy import enu_to_geodetic
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.records import Frame, Photo, PhotoSet
from curecon_blender.core.sparse.models import MAPPED, write_components
from curecon_blender.core.sparse.placement import place, transformed

PLACES = np.array([[-25.0, -20, 0.1], [25, -20, 0.2], [25, 20, 0.0], [-25, 20, 0.3],
                   [0, 0, 0.15], [-12, 8, 0.25], [14, -9, 0.05], [3, 17, 0.2]])
MOVED = pycolmap.Sim3d(0.2, pycolmap.Rotation3d(np.array([0.5, -0.3, 1.1])), np.array([7.0, -3.0, 2.0]))


def measured(model: pycolmap.Reconstruction, *, local: bool = False, checks: int = 0, noise: float = 0.2) -> ControlSet:
    """Eight points on the ground of the flight, marked in every photo that shows them; the last `checks` of them are
    check points. `model` is the true one."""
    rng = np.random.default_rng(2)
    places = enu_to_geodetic(PLACES, ORIGIN)
    points, marks = [], []
    for number, (place_, given) in enumerate(zip(PLACES, PLACES if local else places, strict=True)):
        point = ControlPoint(name=f"p{number}", system="local" if local else "WGS84", given=tuple(given.tolist()),
                             place=tuple(given.tolist()), role=CHECK if number >= 8 - checks else CONTROL)
        points.append(point)
        for image in model.images.values():
            ray = seen(image.cam_from_world().matrix()[None], place_)[0]
            x, y = to_pixels(LENS, ray)[0]
            if 0 < x < WIDTH and 0 < y < HEIGHT:
                x, y = (np.array([x, y]) + rng.normal(0, noise, 2)).tolist()
                marks.append(Mark(point=point.name, photo=image.name, x=x, y=y, sigma=max(noise, 0.01)))
    return ControlSet(points=tuple(points)).with_marks(marks)


def moved(by: pycolmap.Sim3d = MOVED) -> tuple[pycolmap.Reconstruction, ControlSet, np.ndarray]:
    """The true model of the flight in a frame that is none, its control, and the true centres."""
    model, _, centres = flight(bent=False)
    control = measured(model)
    model.transform(by)
    return model, control, centres


def centres_of(model: pycolmap.Reconstruction) -> np.ndarray:
    return np.array([image.projection_center() for image in sorted(model.images.values(), key=lambda i: i.name)])


@pytest.mark.parametrize("local", [False, True], ids=["on Earth", "local"])
def test_three_points_and_more_place_the_site(local: bool) -> None:
    model, _, centres = moved()
    truth, _, _ = flight(bent=False)
    control = measured(truth, local=local)
    found = control_placement(model, control)
    assert found is not None
    model.transform(found.site_from_model)
    frame = found.frame
    assert (frame.scale, frame.up, frame.north) == ("metres", "control", not local)
    assert "8 control points" in frame.note
    if local:
        assert frame.origin is None
        np.testing.assert_allclose(centres_of(model), centres, atol=0.1)
    else:
        assert frame.origin is not None
        apart = frame.origin.altitude - ORIGIN.altitude
        assert abs(apart - 0.15) < 0.2  # on the ground, which lies between 0 and 0.3
        np.testing.assert_allclose((centres_of(model) - centres)[:, 2], -apart, atol=0.1)
    assert frame.scale_sigma is not None and 0 < frame.scale_sigma < 0.01
    off = np.array([one.off for one in residuals(model, control, frame.origin, CONTROL)])
    assert len(off) == 8 and np.abs(off).max() < 0.08


def test_check_points_do_not_place_the_site() -> None:
    model, control, _ = moved()
    wrong = control.with_points([replace(point, role=CHECK, place=(0.0, 0.0, 0.0)) for point in control.points[4:]])
    right = control.with_points([replace(point, role=CHECK) for point in control.points[4:]])
    first, second = control_placement(model, wrong), control_placement(model, right)
    assert first is not None and second is not None
    np.testing.assert_array_equal(first.site_from_model.matrix(), second.site_from_model.matrix())


def test_too_few_points_or_points_in_a_line_place_nothing() -> None:
    model, control, _ = moved()
    two = control
    for point in control.points[2:]:
        two = two.without_point(point.name)
    assert control_placement(model, two) is None
    truth, _, _ = flight(bent=False)
    row = [replace(point, place=(24.6, 117.0 + 1e-4 * n, 500.0)) for n, point in enumerate(control.points[:3])]
    marks = []
    for n, point in enumerate(row):
        for image in truth.images.values():
            ray = seen(image.cam_from_world().matrix()[None], np.array([10.0 * n - 10, 0, 0]))[0]
            x, y = to_pixels(LENS, ray)[0].tolist()
            marks.append(Mark(point=point.name, photo=image.name, x=x, y=y))
    assert control_placement(model, ControlSet(points=tuple(row)).with_marks(marks)) is None


def test_one_wrong_point_does_not_pull_and_is_named() -> None:
    model, control, _ = moved()
    point = control.points[2]
    latitude, longitude, height = point.place
    control = control.with_points([replace(point, place=(latitude, longitude + 3e-5, height))])  # 3 m east
    found = control_placement(model, control)
    assert found is not None
    model.transform(found.site_from_model)
    off = residuals(model, control, found.frame.origin, CONTROL)
    by_name = {one.name: float(np.linalg.norm(one.off)) for one in off}
    assert by_name.pop("p2") == pytest.approx(3.04, abs=0.1)
    assert max(by_name.values()) < 0.1
    (said,) = doubtful(off, control)
    assert said.startswith("p2 is 3.0")


def test_axes_that_are_exchanged_and_points_that_are_mixed_up_are_told() -> None:
    model, _, _ = moved()
    truth, _, _ = flight(bent=False)
    control = measured(truth, local=True)
    swapped = [replace(point, place=(point.place[1], point.place[0], point.place[2])) for point in control.points]
    _, photos, _ = flight(bent=False)
    with pytest.raises(ControlError, match="turn the site over") as told:  # which fits points on flat ground
        compared(_placed(model, control.with_points(swapped)), place(model, photos))
    assert "exchanged" in told.value.remedy
    assert compared(_placed(model, control), place(model, photos)) == ""
    names = [point.name for point in control.points]
    mixed = [replace(control.points[(3 * n) % 8], name=name) for n, name in enumerate(names)]
    with pytest.raises(ControlError, match="do not fit") as told:
        control_placement(model, control.with_points(mixed))
    assert "on its own point" in told.value.remedy


def test_feet_are_told_by_gps() -> None:
    model, photos, _ = flight(bent=False)
    by_gps = place(model, photos)
    control = measured(model, local=True)
    assert compared(_placed(model, control), by_gps) == ""
    feet = [replace(point, place=tuple(axis / 0.3048 for axis in point.place)) for point in control.points]
    assert "feet" in compared(_placed(model, control.with_points(feet)), by_gps)


def _placed(model: pycolmap.Reconstruction, control: ControlSet):  # type: ignore[no-untyped-def]
    found = control_placement(model, control)
    assert found is not None
    return found


def bent_bundle(model: pycolmap.Reconstruction) -> Bundle:
    """The flight's true photos and points from a lens that is 2 % too long, whose distortion nobody knows."""
    images = sorted(model.images.values(), key=lambda image: image.name)
    number = {image.image_id: n for n, image in enumerate(images)}
    ids = sorted(model.points3D)
    photo, point, pixels = [], [], []
    for p, point_id in enumerate(ids):
        for element in model.points3D[point_id].track.elements:
            photo.append(number[element.image_id])
            point.append(p)
            pixels.append(model.images[element.image_id].points2D[element.point2D_idx].xy)
    lens = np.array([[1.02 * LENS.f, 1.0, LENS.cx, LENS.cy, 0, 0, 0, 0, 0]])
    count = len(images)
    return Bundle(
        rotations=np.array([image.cam_from_world().rotation.matrix() for image in images]),
        centres=np.array([image.projection_center() for image in images]), lens_of=np.zeros(count, int), lenses=lens,
        points=np.array([model.points3D[i].xyz for i in ids]), photo=np.array(photo), point=np.array(point),
        pixels=np.array(pixels), positions=np.zeros((count, 3)), position_sigmas=np.full((count, 3), np.inf),
        attitudes=np.tile(np.eye(3), (count, 1, 1)), attitude_sigmas=np.full(count, np.inf), known_lenses=lens,
        lens_sigmas=np.array([[100.0, 0.001, 1.0, 1.0, 0.3, 0.3, 0.003, 0.003, 0.3]]),
    )


def test_control_in_the_adjustment_and_each_point_left_out() -> None:
    """Without GPS and without a known lens the ground stays level and true by its control points; left out one by one
    they tell of errors as they are."""
    model, _, _ = flight(bent=False)
    control = measured(model, checks=2)
    names = sorted(image.name for image in model.images.values())
    held = marked_points(model, control, CONTROL)
    adjusted = adjust(with_control(bent_bundle(model), names, held, ORIGIN))
    known = np.array([point.xyz for _, point in sorted(model.points3D.items())])
    off = (adjusted.points[: len(known)] - known)[np.abs(known[:, :2]).max(axis=1) < 22]
    assert np.abs(np.median(off, axis=0)).max() < 0.03
    assert np.sqrt((off[:, 2] ** 2).mean()) < 0.12
    out = left_out(adjusted, held)
    assert [one.name for one in out] == [f"p{n}" for n in range(6)]
    within = np.array([np.linalg.norm(adjusted.control_off, axis=1), [np.linalg.norm(one.off) for one in out]])
    assert (within[1] > within[0]).all()  # a point that holds the cameras says nothing of its own error
    assert np.median(within[1]) < 0.25
    assert all(one.marks >= 2 and one.pixels < 1.0 for one in out)


def test_gps_in_another_datum_and_other_axes_comes_into_the_control_s_frame() -> None:
    model, _, centres = flight(bent=False)
    angle = 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    sigmas = np.full(centres.shape, 0.5)
    sigmas[3] = np.inf
    sigmas[5, 2] = np.inf
    bundle = replace(bent_bundle(model), positions=(centres - [3.0, -2.0, 35.0]) @ turn, position_sigmas=sigmas)
    there = gps_in_frame(bundle, local=True)
    known = np.isfinite(sigmas)
    np.testing.assert_allclose(there.positions[known], centres[known], atol=0.05)
    shifted = gps_in_frame(replace(bundle, positions=centres - [3.0, -2.0, 35.0]), local=False)
    np.testing.assert_allclose(shifted.positions[known], centres[known], atol=0.05)
    assert np.isfinite(transformed(MOVED, shifted.positions[known[:, 2]])).all()


def mapped(*, rtk: bool) -> tuple[pycolmap.Reconstruction, dict[str, Photo], pycolmap.Reconstruction]:
    """The flight as it comes out of the mapper, its photos without a calibration, and the true model."""
    model, photos, _ = flight(rtk=rtk)
    return model, {name: replace(photo, lens=None) for name, photo in photos.items()}, flight(bent=False)[0]


def check_errors(model: pycolmap.Reconstruction, control: ControlSet, frame: Frame) -> tuple[float, float]:
    return rms(residuals(model, control, frame.origin, CHECK))


def test_control_makes_a_bent_site_true_and_check_points_have_no_part_in_it() -> None:
    """Within 1.5 pixels on the ground across and 3 in height, where GPS alone is metres off."""
    model, photos, truth = mapped(rtk=False)
    control = measured(truth, checks=4)
    placement, adjusted = place_and_adjust(model, photos, Reporter(), control)
    frame = placement.frame
    assert adjusted is not None and frame.up == "control" and not adjusted.left_out
    pixel = 40.0 / LENS.f
    plan, height = check_errors(model, control, frame)
    assert plan < 1.5 * pixel and height < 3 * pixel
    wrong = [replace(point, place=(24.5, 117.1, 900.0)) for point in control.of_role(CHECK)]
    other, photos, _ = mapped(rtk=False)
    place_and_adjust(other, photos, Reporter(), control.with_points(wrong))
    np.testing.assert_array_equal(centres_of(other), centres_of(model))


def test_six_points_and_none_to_check_are_left_out_one_by_one() -> None:
    model, photos, truth = mapped(rtk=False)
    control = measured(truth).without_point("p7").without_point("p6")
    placement, adjusted = place_and_adjust(model, photos, Reporter(), control)
    assert adjusted is not None
    frame, out = placement.frame, adjusted.left_out
    assert [one.name for one in out] == [f"p{n}" for n in range(6)]
    held = rms(residuals(model, control, frame.origin, CONTROL))
    assert rms(out)[1] > held[1] and rms(out)[0] < 0.1


@pytest.mark.parametrize("geoid", [0.0, 31.0])
def test_rtk_helps_control_unless_its_heights_are_of_another_datum(geoid: float) -> None:
    model, photos, truth = mapped(rtk=True)
    for name, photo in photos.items():
        assert photo.gps is not None and photo.gps.altitude is not None
        photos[name] = replace(photo, gps=replace(photo.gps, altitude=photo.gps.altitude + geoid))
    control = measured(truth, checks=4)
    frame = place_and_adjust(model, photos, Reporter(), control)[0].frame
    plan, height = check_errors(model, control, frame)
    assert plan < 0.04 and height < 0.08
    if not geoid:  # the cameras' own height, which control on level ground does not tell
        assert model.camera(1).focal_length_x == pytest.approx(LENS.f, rel=0.005)


def test_the_stage_reads_control_and_tells_checks_without_a_new_adjustment(tmp_path: Path) -> None:
    model, photos, truth = mapped(rtk=True)
    write_components(tmp_path, MAPPED, [(model, {})])
    control = measured(truth, checks=4)
    write_control(tmp_path, control)
    photo_set = PhotoSet(photos=tuple(photos.values()))
    (frame,) = adjust_cameras(photo_set, tmp_path, Reporter())
    tell_checks(tmp_path, control)
    folder = tmp_path / "sparse" / "0"
    told = read_accuracy(folder)
    assert len(told.control) == len(told.check) == 4 and not told.left_out
    assert not {one.name for one in told.control} & {one.name for one in told.check}
    before = (folder / "images.bin").stat().st_mtime_ns
    fewer = control.without_mark("p7", next(mark.photo for mark in control.marks_of("p7")))
    assert fewer.adjusted_to == control.adjusted_to  # what the stage's key is made of
    tell_checks(tmp_path, fewer)
    again = read_accuracy(folder)
    assert again.check != told.check and again.control == told.control
    assert (folder / "images.bin").stat().st_mtime_ns == before
    assert frame.up == "control"
