# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is drawn in every 3D viewport, from the add-on's start to its end."""

from __future__ import annotations

from collections.abc import Callable

import bpy


class Drawing:
    """Calls `draw` for every 3D viewport; `when` is "POST_VIEW" for places, "POST_PIXEL" for pixels of the region."""

    def __init__(self, draw: Callable[[], None], when: str) -> None:
        self._draw, self._when = draw, when
        self._handler: object | None = None

    def start(self) -> None:
        self._handler = bpy.types.SpaceView3D.draw_handler_add(self._draw, (), "WINDOW", self._when)

    def stop(self) -> None:
        if self._handler is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handler, "WINDOW")
            self._handler = None
