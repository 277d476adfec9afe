# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The mapper's cameras adjusted with all that is known of them, in the site frame, and how true they are."""
