# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The only writers of bpy.data: cameras, points, the surface, and how the viewport draws them."""
