# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A flight for a building: where each photo is taken, checked against the building, and files for the drone."""
