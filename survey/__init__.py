# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Asking people about reconstructions: a questionnaire as one web page, and the statistics of its answers."""
