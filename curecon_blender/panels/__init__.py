# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab CU-Recon of the 3D viewport, one file a step."""

from __future__ import annotations

from . import cloud, frame, photos, present, reconstruct, result, surface

CLASSES = (
    *photos.CLASSES, *reconstruct.CLASSES, *result.CLASSES, *cloud.CLASSES, *frame.CLASSES, *surface.CLASSES,
    *present.CLASSES,
)
