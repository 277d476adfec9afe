# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`frame.json` beside a component's COLMAP model: what is known of its frame."""

from __future__ import annotations

from pathlib import Path

from ..base.errors import WorkspaceError
from ..base.reading import build, read_json
from ..base.records import Frame

FRAME_FILE = "frame.json"


def read_frame(folder: Path) -> Frame:
    """The record in a component's folder. Raises WorkspaceError when missing or damaged."""
    path = folder / FRAME_FILE
    try:
        frame: Frame = build(Frame, read_json(path))
        return frame
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            f"{path} is missing or damaged ({error}).", remedy="Run Reconstruct again in this workspace.", path=path
        ) from error
