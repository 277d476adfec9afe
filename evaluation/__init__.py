# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures for depth maps and clouds, each a function and a command over files; see README.md beside this file."""
