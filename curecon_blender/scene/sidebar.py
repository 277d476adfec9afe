# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The tab of the sidebar, opened for a user who has not found it yet; a workspace of its own; the outliner, folded to
what matters."""

from __future__ import annotations

import bpy

TAB = "CU-Recon"  # of the sidebar
TAB_SECONDS, TAB_TRIES = 0.1, 50  # between two tries to turn to it


def show_tab(context: bpy.types.Context) -> None:
    """Open the sidebar of the 3D viewport that the user is in, or else of the largest one, on our tab."""
    found = [area for area in context.window.screen.areas if area.type == "VIEW_3D"] if context.window else []
    area = context.area if context.area in found else max(
        found, key=lambda area: area.width * area.height, default=None)
    if area is None:
        return
    area.spaces.active.show_region_ui = True
    sidebar = next(region for region in area.regions if region.type == "UI")
    tries = 0

    def turn() -> float | None:
        """A sidebar knows its tabs only once it has been drawn."""
        nonlocal tries
        tries += 1
        try:
            sidebar.active_panel_category = TAB
        except (AttributeError, TypeError, ReferenceError):
            return TAB_SECONDS if tries < TAB_TRIES else None
        area.tag_redraw()
        return None

    bpy.app.timers.register(turn, first_interval=0.0)


def open_workspace(window: bpy.types.Window) -> None:
    """Turn the window to the workspace of our name. The first time it is made of the one that stands there: its largest
    area becomes a 3D viewport, its tab is open. Blender's own list of workspaces takes no entries of extensions."""
    workspace = bpy.data.workspaces.get(TAB)
    if workspace is None:
        before = set(bpy.data.workspaces)
        with bpy.context.temp_override(window=window):
            bpy.ops.workspace.duplicate()
        (workspace,) = set(bpy.data.workspaces) - before
        workspace.name = TAB
        area = max(workspace.screens[0].areas, key=lambda area: area.width * area.height)
        area.type = "VIEW_3D"
    window.workspace = workspace

    def turned() -> float | None:
        """Blender turns to it once it has drawn again."""
        if window.workspace != workspace:
            return TAB_SECONDS
        with bpy.context.temp_override(window=window):
            show_tab(bpy.context)
        return None

    bpy.app.timers.register(turned, first_interval=TAB_SECONDS)


def fold_outliner_once_drawn() -> None:
    """An outliner knows what has come into the scene once it has been drawn, which a busy computer may put off."""

    def drawn() -> None:
        bpy.types.SpaceOutliner.draw_handler_remove(handler, "WINDOW")
        bpy.app.timers.register(lambda: fold_outliner(bpy.context), first_interval=0.0)

    handler = bpy.types.SpaceOutliner.draw_handler_add(drawn, (), "WINDOW", "POST_PIXEL")


def fold_outliner(context: bpy.types.Context) -> None:
    """Close the lowest open level of the window's outliners: hundreds of cameras hide the site that they were put
    into the scene for."""
    if context.window is None:
        return
    for area in context.window.screen.areas:
        if area.type == "OUTLINER" and area.spaces.active.display_mode == "VIEW_LAYER":
            region = next(region for region in area.regions if region.type == "WINDOW")
            with context.temp_override(area=area, region=region):
                bpy.ops.outliner.show_one_level(open=False)
