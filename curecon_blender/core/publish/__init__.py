# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The site as a folder of web pages: tiles, cloud, pictures, catalogue, and no more of its place than was chosen."""
