# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Undistorted photos with their cameras and source views, ready for multi-view stereo."""
