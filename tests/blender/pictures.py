# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that Blender has written, as arrays."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np


def pixels_of(path: Path) -> np.ndarray:
    """A picture as (H,W,3) in [0, 1], bottom row first."""
    image = bpy.data.images.load(str(path))
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(image.size[1], image.size[0], 4)[..., :3]
    bpy.data.images.remove(image)
    return values
