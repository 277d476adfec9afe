# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fuzzing of every reader of a file that a stranger may have made: `python -m tests.fuzz --minutes N [--target X]`.

A reader may return or raise CuReconError. Anything else, a hang, a crash or memory beyond the limit is a finding.
"""
