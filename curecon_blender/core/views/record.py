# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`views.json` of a workspace: its components with their frames and undistorted cameras, for MVS and for Blender."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import WorkspaceError
from ..base.files import write_json
from ..base.language import Text
from ..base.reading import FARTHEST, build, read_json
from ..base.records import Component, View
from ..base.shares import is_safe

FILE_NAME = "views.json"
FORMAT = 1


def write(workspace: Path, components: list[Component]) -> None:
    """Write `views.json` (atomically) into the workspace folder."""
    write_json(workspace / FILE_NAME, {"format": FORMAT, "components": [_component_to_json(c) for c in components]})


def read(workspace: Path) -> list[Component]:
    """The components in the workspace folder, largest first.

    A view's `original` on a share other than the workspace's own is left out: a stranger may have written it.
    Raises WorkspaceError when there is no `views.json` yet, or it is damaged or of a newer version.
    """
    path = workspace / FILE_NAME
    try:
        content = read_json(path)
        if not isinstance(content, dict):
            raise ValueError("no record")
        if build(int, content.get("format"), "format") > FORMAT:
            raise WorkspaceError(
                Text("{} was written by a newer version of CU-Recon.", path), remedy="Update CU-Recon, then try again.",
                path=path,
            )
        components: list[Component] = list(build(tuple[Component, ...], content.get("components"), "components"))
        _check(components)
        return [_without_foreign_shares(component, workspace) for component in components]
    except FileNotFoundError as error:
        raise WorkspaceError(
            Text("{} holds no finished cameras ({} is missing).", workspace, FILE_NAME),
            remedy="Choose the workspace folder of a reconstruction, or run Reconstruct.", path=path,
        ) from error
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))),
            remedy="Delete that file and run Reconstruct again.", path=path
        ) from error


def with_clouds(workspace: Path, components: Iterable[Component]) -> list[Component]:
    """Those of the components whose cloud is there. Raises WorkspaceError where there is none."""
    found = [component for component in components if (workspace / component.cloud).exists()]
    if not found:
        raise WorkspaceError(Text("{} has no point cloud yet.", workspace), remedy="Run Reconstruct to the end first.",
                             path=workspace)
    return found


def _without_foreign_shares(component: Component, workspace: Path) -> Component:
    return replace(component, views=tuple(
        view if is_safe(view.original, [workspace.absolute()]) else replace(view, original="")
        for view in component.views
    ))


def _component_to_json(component: Component) -> dict[str, Any]:
    fields = asdict(component)
    for view in fields["views"]:
        view["K"] = view["K"].tolist()
        view["cam_from_world"] = view["cam_from_world"].tolist()
    return fields


def _check(components: list[Component]) -> None:
    """Raises ValueError for what no field tells on its own: cameras that are none, names that nobody has."""
    if [component.index for component in components] != list(range(len(components))):
        raise ValueError("the components are not in order")
    for component in components:
        names = {view.name for view in component.views}
        if len(names) != len(component.views):
            raise ValueError("two views have one name")
        for view in component.views:
            if not {name for name, _ in view.sources} | set(view.overlaps) <= names - {view.name}:
                raise ValueError(f"{view.name} names a view that is not there")
            if not _is_camera(view):
                raise ValueError(f"the camera of {view.name} is none")


def _is_camera(view: View) -> bool:
    K, rotation = view.K, view.cam_from_world[:, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) and np.linalg.det(rotation) > 0
    in_reach = np.abs(view.cam_from_world[:, 3]).max() < FARTHEST and np.abs(K).max() < FARTHEST
    return bool(rigid and in_reach and min(K[0, 0], K[1, 1]) > 1e-3 and (K[2] == [0, 0, 1]).all()
                and (K[[0, 1], [1, 0]] == 0).all() and view.near < view.far)
