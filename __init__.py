# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
from .curecon_blender import register, unregister  # noqa: F401 - what Blender calls on the extension
