# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The plane homographies that carry a reference's pixels into its source views.

Shapes: B samples, V views, view 0 the reference, N = V - 1 sources; `K` (B,V,3,3) in pixels, pixel centres at .5,
`cam_from_world` (B,V,3,4).
"""

from __future__ import annotations

import torch
from torch import Tensor


def level_intrinsics(K: Tensor, level: int) -> Tensor:
    """Intrinsics (...,3,3) of a level: pixel centres at .5 make it a plain scaling of the first two rows."""
    scale = torch.tensor([0.5**level, 0.5**level, 1.0], dtype=K.dtype, device=K.device)
    return K * scale.view(3, 1)


def pixel_grid(x: Tensor, y: Tensor) -> Tensor:
    """(1,3,h*w) homogeneous pixels of the columns x (w,) and rows y (h,)."""
    rows, columns = torch.meshgrid(y, x, indexing="ij")
    return torch.stack([columns, rows, torch.ones_like(rows)]).reshape(1, 3, -1)


def relative_pose(cam_from_world: Tensor, ref_from_world: Tensor) -> Tensor:
    """cam_from_ref (B,3,4) of two poses (B,3,4)."""
    rotation = cam_from_world[:, :, :3] @ ref_from_world[:, :, :3].transpose(1, 2)
    translation = cam_from_world[:, :, 3:] - rotation @ ref_from_world[:, :, 3:]
    return torch.cat([rotation, translation], 2)


def homography_terms(K: Tensor, cam_from_world: Tensor, source: int, pixels: Tensor) -> tuple[Tensor, Tensor]:
    """Terms of the plane homographies from view 0 to view `source`.

    A pixel of `pixels` (1,3,P), homogeneous, at inverse depth w maps to rotated + w * shifted: (B,3,P) and (B,3,1).
    """
    # Autocast would multiply these matrices in bf16, whose eight bits put a source several pixels off its place.
    with torch.autocast(K.device.type, enabled=False):
        src_from_ref = relative_pose(cam_from_world[:, source], cam_from_world[:, 0])
        rotated = K[:, source] @ src_from_ref[:, :, :3] @ torch.linalg.inv(K[:, 0]) @ pixels
        shifted = K[:, source] @ src_from_ref[:, :, 3:]
    return rotated, shifted


def mean_disparity(
    K: Tensor, cam_from_world: Tensor, near: Tensor, far: Tensor, size: tuple[int, int]
) -> Tensor:
    """(B,) pixels of a source that the sweep from near to far passes over, in the mean of the sources.

    Measured by the speed at the middle of the sweep, at nine pixels of a reference of `size` (W, H), since the ends
    of a sweep often lie outside or behind a source. `near` and `far` (B,) are z-depths in world units.
    """
    pixels = pixel_grid(*(torch.tensor([0.2, 0.5, 0.8], device=K.device) * length for length in size))
    middle, span = (1 / near + 1 / far) / 2, 1 / near - 1 / far
    speeds = []
    for i in range(1, K.shape[1]):
        rotated, shifted = homography_terms(K, cam_from_world, i, pixels)
        homogeneous = rotated + middle.view(-1, 1, 1) * shifted
        z = homogeneous[:, 2:]
        velocity = (shifted[:, :2] - homogeneous[:, :2] / z * shifted[:, 2:]) / z
        speed = torch.where(z[:, 0] > 1e-3, velocity.norm(dim=1), 0.0)  # 0 behind the source
        speeds.append(speed.median(1).values * span)
    return torch.stack(speeds).mean(0)
