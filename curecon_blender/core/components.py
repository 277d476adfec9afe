# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`views.json` of a workspace: its components with their frames and undistorted cameras, for MVS and for Blender."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .errors import WorkspaceError
from .files import write_json
from .types import Component, Frame, GeoPosition, View

FILE_NAME = "views.json"
FORMAT = 1


def write(workspace: Path, components: list[Component]) -> None:
    """Write `views.json` (atomically) into the workspace folder."""
    write_json(workspace / FILE_NAME, {"format": FORMAT, "components": [_component_to_json(c) for c in components]})


def read(workspace: Path) -> list[Component]:
    """The components in the workspace folder, largest first.

    Raises WorkspaceError when there is no `views.json` yet, or it is damaged or of a newer version.
    """
    path = workspace / FILE_NAME
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["format"] > FORMAT:
            raise WorkspaceError(
                f"{path} was written by a newer version of CU-Recon.", remedy="Update CU-Recon, then try again.",
                path=path,
            )
        return [_component_from_json(c) for c in content["components"]]
    except FileNotFoundError as error:
        raise WorkspaceError(
            f"{workspace} holds no finished cameras ({FILE_NAME} is missing).",
            remedy="Choose the workspace folder of a reconstruction, or run Reconstruct.", path=path,
        ) from error
    except (json.JSONDecodeError, KeyError, TypeError, UnicodeDecodeError) as error:
        raise WorkspaceError(
            f"{path} is damaged.", remedy="Delete that file and run Reconstruct again.", path=path
        ) from error


def _component_to_json(component: Component) -> dict[str, Any]:
    fields = asdict(component)
    for view in fields["views"]:
        view["K"] = view["K"].tolist()
        view["cam_from_world"] = view["cam_from_world"].tolist()
    return fields


def _component_from_json(fields: dict[str, Any]) -> Component:
    frame = dict(fields["frame"])
    if frame["origin"] is not None:
        frame["origin"] = GeoPosition(**frame["origin"])
    views = tuple(
        View(**{
            **view,
            "K": np.array(view["K"], dtype=np.float64),
            "cam_from_world": np.array(view["cam_from_world"], dtype=np.float64),
            "sources": tuple((name, float(score)) for name, score in view["sources"]),
            "overlaps": tuple(view["overlaps"]),
        })
        for view in fields["views"]
    )
    return Component(**{**fields, "frame": Frame(**frame), "views": views})
