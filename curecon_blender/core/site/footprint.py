# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way a building stands. Angles are of its plan's axes: radians, anticlockwise from +X, in [-pi/4, pi/4)."""

from __future__ import annotations

import numpy as np

WALL = 0.3  # |z| of a wall's unit normal is below it
ROUND = 0.1  # how far a building's walls agree, of 1 where all do, below which it is round: a Tulou comes to 0.04
STEPS = 180  # of the search for a rectangle, half a degree each


def wall_direction(normals: np.ndarray, areas: np.ndarray) -> tuple[float, bool] | None:
    """The direction that most wall faces along or across, from faces' unit normals (N,3) and areas (N,), and whether
    the walls are round: they have none then, and it is 0. None without walls."""
    walls = np.abs(normals[:, 2]) < WALL
    if not areas[walls].sum() > 0:
        return None
    angles = np.arctan2(normals[walls, 1], normals[walls, 0])
    mean = np.average(np.exp(4j * angles), weights=areas[walls])  # of four times the angle: a box's walls are all alike
    is_round = bool(abs(mean) < ROUND)
    return (0.0 if is_round else float(np.angle(mean) / 4)), is_round


def rectangle_direction(points: np.ndarray) -> float:
    """The direction of the smallest rectangle about points (N,2), apart from the outermost two per cent a side."""
    angles = np.arange(STEPS) * (np.pi / 2 / STEPS) - np.pi / 4
    return float(min(angles, key=lambda angle: np.prod(np.subtract(*np.percentile(turned(points, angle), [98, 2], 0)))))


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    """Points (N,2) in axes that are turned by `angle`, anticlockwise."""
    cos, sin = np.cos(angle), np.sin(angle)
    result: np.ndarray = points @ np.array([[cos, -sin], [sin, cos]])
    return result
