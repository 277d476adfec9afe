# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`frame.json` beside a component's COLMAP model: what is known of its frame."""

from __future__ import annotations

from pathlib import Path

from ..base.files import read_record
from ..base.records import Frame

FRAME_FILE = "frame.json"


def read_frame(folder: Path) -> Frame:
    """The record in a component's folder. Raises WorkspaceError when missing or damaged."""
    return read_record(Frame, folder / FRAME_FILE)
