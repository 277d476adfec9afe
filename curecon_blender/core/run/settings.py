# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`settings.json` of a workspace: the options of the last run that began with photos, for its report."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from ..base.errors import WorkspaceError
from ..base.files import write_json
from ..base.language import Text
from ..base.options import Options
from ..base.reading import build, read_json

FILE_NAME = "settings.json"
_PLACES = ("photos", "workspace", "speeds", "scheduler")  # of this computer, nobody else's business


def keep_settings(options: Options) -> None:
    """Write the options into their workspace (atomically), without the places of this computer, where they are others
    than those that stand there. Raises WorkspaceError."""
    values = ((option.name, getattr(options, option.name)) for option in fields(Options) if option.name not in _PLACES)
    told = {name: "" if value is None else str(value) for name, value in values}
    try:
        standing = read_settings(options.workspace)
    except WorkspaceError:  # damaged: these take its place
        standing = {}
    if standing != told:
        write_json(options.workspace / FILE_NAME, told)


def read_settings(workspace: Path) -> dict[str, str]:
    """What `keep_settings` wrote; nothing where there is none. Raises WorkspaceError when damaged."""
    path = workspace / FILE_NAME
    try:
        return {str(name): build(str, value, name) for name, value in build(dict, read_json(path, 1 << 16)).items()}
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("{} is damaged ({}).", path, Text(str(error))), path=path,
                             remedy="Delete it; the next Reconstruct writes it again.") from error
