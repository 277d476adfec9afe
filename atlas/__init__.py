# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas: a server for many people's published sites. See docs/design/atlas.md."""
