# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Geodesy and rotations, against independent implementations and their inverses."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from curecon_blender.core.base.geodesy import (
    enu_to_geodetic,
    geodetic_to_enu,
    geodetic_to_utm,
    utm_to_geodetic,
    utm_zone,
)
from curecon_blender.core.base.records import GeoPosition, Gimbal
from curecon_blender.core.base.rotations import between, from_gimbal, from_quaternion, to_quaternions

SITE = GeoPosition(latitude=24.6612, longitude=117.0523, altitude=423.0)


def test_geodesy_agrees_with_an_independent_implementation_and_inverts() -> None:
    places = np.array([[24.67, 117.06, 500.0], [24.6612, 117.0523, 423.0], [-33.9, 18.4, 20.0], [89.999, 10.0, 5.0]])
    enu = geodetic_to_enu(places, SITE)
    theirs = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84).ellipsoid_to_enu(
        places, SITE.latitude, SITE.longitude, SITE.altitude
    )
    assert enu[1] == pytest.approx(np.zeros(3), abs=1e-6)
    assert enu[:2] == pytest.approx(theirs[:2], abs=1e-4)
    back = enu_to_geodetic(enu, SITE)
    assert back[:, :2] == pytest.approx(places[:, :2], abs=1e-9)
    assert back[:, 2] == pytest.approx(places[:, 2], abs=1e-4)


@pytest.mark.parametrize("latitude", [-79.0, -33.9, -0.01, 0.01, 24.6, 51.5, 83.5])
def test_utm_agrees_with_an_independent_implementation_and_inverts(latitude: float) -> None:
    places = np.array([[latitude, longitude, 10.0] for longitude in (114.1, 116.9, 117.0, 119.9)])
    assert {utm_zone(longitude) for longitude in places[:, 1]} == {50}
    theirs, zone = pycolmap.GPSTransform(pycolmap.GPSTransformEllipsoid.WGS84).ellipsoid_to_utm(places)
    assert zone == 50
    theirs = np.array(theirs)
    if latitude < 0 and theirs[0, 1] < 0:
        theirs[:, 1] += 10_000_000
    found = geodetic_to_utm(places[:, :2], 50, south=latitude < 0)
    np.testing.assert_allclose(found, theirs[:, :2], atol=1e-4)
    np.testing.assert_allclose(utm_to_geodetic(found, 50, south=latitude < 0), places[:, :2], atol=1e-11)


def test_quaternions_become_rotations_and_come_back() -> None:
    rng = np.random.default_rng(1)
    expected = rng.normal(size=(200, 4))
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    expected[0] = [0, 1, 0, 0]
    theirs = [pycolmap.Rotation3d(np.array([x, y, z, w])).matrix() for w, x, y, z in expected]
    found = np.array([from_quaternion(3 * quaternion) for quaternion in expected])  # of any length
    np.testing.assert_allclose(found, theirs, atol=1e-12)
    back = to_quaternions(found)
    np.testing.assert_allclose(np.abs(np.sum(back * expected, axis=1)), 1, atol=1e-9)


@pytest.mark.parametrize("target", [(0, 0, 1), (0, 0, -1), (0.6, 0, 0.8), (0, 0.6, -0.8)])
def test_the_smallest_rotation_between_two_vectors(target: tuple[float, float, float]) -> None:
    source, wanted = np.array([0.0, 0.0, 1.0]), np.array(target)
    rotation = between(source, wanted)
    np.testing.assert_allclose(rotation @ source, wanted, atol=1e-12)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    angle = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    assert angle == pytest.approx(np.degrees(np.arccos(source @ wanted)), abs=1e-5)


def test_a_gimbal_points_its_camera() -> None:
    east = from_gimbal(Gimbal(yaw=90, pitch=0, roll=0))
    np.testing.assert_allclose(east @ [0, 0, 1], [1, 0, 0], atol=1e-12)  # forward
    np.testing.assert_allclose(east @ [0, 1, 0], [0, 0, -1], atol=1e-12)  # down
    nadir = from_gimbal(Gimbal(yaw=0, pitch=-90, roll=0))
    np.testing.assert_allclose(nadir @ [0, 0, 1], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(nadir @ [1, 0, 0], [1, 0, 0], atol=1e-12)  # north is the picture's upper edge
