# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sidebar tab CU-Recon of the 3D viewport, one file a step, and the add-on's page in the preferences."""

from __future__ import annotations

from . import cloud, control, frame, gaps, masks, photos, plan, preferences, present, reconstruct, result, surface

CLASSES = (
    *preferences.CLASSES, *plan.CLASSES, *photos.CLASSES, *reconstruct.CLASSES, *result.CLASSES, *gaps.CLASSES,
    *masks.CLASSES, *cloud.CLASSES, *frame.CLASSES, *control.CLASSES, *surface.CLASSES, *present.CLASSES,
)
