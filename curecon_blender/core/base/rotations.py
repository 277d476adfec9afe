# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Rotations: of gimbals, quaternions (w, x, y, z), and between vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .records import Gimbal


def from_gimbal(gimbal: Gimbal) -> np.ndarray:
    """enu_from_cam (3,3) of a camera (x right, y down, z forward) held as the gimbal says."""
    yaw, pitch, roll = np.radians([gimbal.yaw, gimbal.pitch, gimbal.roll])
    forward = np.array([np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), np.sin(pitch)])
    right = np.array([np.cos(yaw), -np.sin(yaw), 0.0])
    down = np.cross(forward, right)
    return np.stack([
        np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward
    ], axis=1)


def from_quaternion(quaternion: Sequence[float] | np.ndarray) -> np.ndarray:
    """The rotation (3,3) of a quaternion (w, x, y, z) of any length above zero."""
    w, x, y, z = np.asarray(quaternion, np.float64) / np.linalg.norm(quaternion)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])


def to_quaternions(rotations: np.ndarray) -> np.ndarray:
    """(F,3,3) rotations to (F,4) unit quaternions (w, x, y, z), either sign."""
    m = rotations
    trace = np.trace(m, axis1=1, axis2=2)[:, None]
    diagonal = np.diagonal(m, axis1=1, axis2=2)
    # Each row is the quaternion times one of its own components; the largest of them is the safest to divide by.
    squares = np.concatenate([1 + trace, 1 + 2 * diagonal - trace], axis=1)
    products = np.stack([
        np.stack([squares[:, 0], m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]], axis=1),
        np.stack([m[:, 2, 1] - m[:, 1, 2], squares[:, 1], m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0]], axis=1),
        np.stack([m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] + m[:, 0, 1], squares[:, 2], m[:, 2, 1] + m[:, 1, 2]], axis=1),
        np.stack([m[:, 1, 0] - m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2], squares[:, 3]], axis=1),
    ], axis=1)
    chosen = products[np.arange(len(m)), squares.argmax(axis=1)]
    result: np.ndarray = chosen / np.linalg.norm(chosen, axis=1, keepdims=True)
    return result


def between(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The smallest rotation (3,3) that takes the unit vector `source` (3,) to the unit vector `target` (3,)."""
    x, y, z = np.cross(source, target)
    cosine = float(source @ target)
    if cosine < -1 + 1e-9:  # half a turn, about any axis across
        axis = np.eye(3)[np.argmin(np.abs(source))]
        axis = axis - (axis @ source) * source
        axis /= np.linalg.norm(axis)
        return np.asarray(2 * np.outer(axis, axis) - np.eye(3))
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1 + cosine))
