# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the Tulou's parts stand: its measures and angles, and places in its rings.

Site frame: metres, x east, y north, z up, origin at the courtyard's centre. Angles are radians anticlockwise
from east. Parts go into a `Site`, one MeshBuilder per material name.
"""

from __future__ import annotations

import numpy as np
from site_mesh import MeshBuilder

Site = dict[str, MeshBuilder]

GATE = np.radians(-68.0)
SIDE_GATES = (np.radians(28.0), np.radians(171.0))
OUTER_RADIUS = 22.0
BATTER = 0.055
WALL_HEIGHT = 10.0
BASE_HEIGHT = 1.3
COLLAPSED = (np.radians(128.0), np.radians(164.0))
WOOD = np.array([0.5, 0.0, 0.0, 1.0])


def polar(theta: np.ndarray, radius: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Cylindrical to site coordinates (..., 3)."""
    theta, radius, z = np.broadcast_arrays(theta, radius, z)
    return np.stack([radius * np.cos(theta), radius * np.sin(theta), z], -1).astype(float)


def arc(start: float, end: float, radius: float, z: float, step: float) -> np.ndarray:
    """Points (N, 3) along an arc about every `step` metres."""
    count = max(3, int(abs(end - start) * radius / step))
    return polar(np.linspace(start, end, count), radius, z)


def turned(angle: float) -> float:
    """An angle relative to the seam of the outer wall (opposite the gate), in [0, 2 pi)."""
    return float((angle - GATE - np.pi) % (2 * np.pi))
