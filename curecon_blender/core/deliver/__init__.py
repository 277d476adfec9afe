# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Deliverables in surveyors' formats: point clouds, orthophotos, surface models, contours and sections."""
