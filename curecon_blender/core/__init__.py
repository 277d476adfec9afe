# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos to coloured point cloud, without Blender. See run/pipeline.py for the flow; it runs in the worker process."""
