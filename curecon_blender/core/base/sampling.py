# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture's values at any places of it."""

from __future__ import annotations

import cv2
import numpy as np

ROW = 1024  # cv2.remap takes no array longer than 32767 a side: lists of points are folded into rows of this length


def sample(image: np.ndarray, u: np.ndarray, v: np.ndarray, interpolation: int = cv2.INTER_LINEAR) -> np.ndarray:
    """Values (n,) or (n,C) of `image` (H,W) or (H,W,C) at finite pixel positions u, v (n,), pixel centres at .5."""
    rows = -(-len(u) // ROW)
    if rows == 0:
        return np.empty((0, *image.shape[2:]), image.dtype)
    maps = np.zeros((2, rows * ROW), np.float32)
    maps[0, : len(u)], maps[1, : len(u)] = u - 0.5, v - 0.5
    map_u, map_v = maps.reshape(2, rows, ROW)
    values = np.asarray(cv2.remap(image, map_u, map_v, interpolation, borderMode=cv2.BORDER_REPLICATE))
    return values.reshape(-1, *image.shape[2:])[: len(u)]
