# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' results beside ours: read, laid on ours, measured, and drawn on one sheet."""
