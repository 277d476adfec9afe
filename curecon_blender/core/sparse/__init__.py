# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the cameras stood: features, matches, bundle adjustment, the site frame."""
