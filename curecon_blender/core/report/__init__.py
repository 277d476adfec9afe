# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The accuracy report: clearness, accuracy, integrity and authenticity of a finished site."""
