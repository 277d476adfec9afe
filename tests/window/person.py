# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand and an eye in Blender's window: moves the pointer, clicks, presses keys, finds buttons, takes pictures.

Runs inside a Blender started with --enable-event-simulate: events go in where the system's own would. Methods that take
time are generators of the seconds to wait before going on, since Blender only acts between two calls of a timer.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy

Wait = Iterator[float]
STEP = 14  # pixels between two places where a button or header is looked for; both are 20 high
SCROLLS, WHEEL = 3, 8  # how often the sidebar is scrolled, and by how many notches
FOLDING = 0.4  # seconds in which a panel folds, and heeds nothing


class Person:
    def __init__(self, pictures: Path) -> None:
        self.pictures = pictures
        self.window = bpy.context.window_manager.windows[0]
        self.area = next(area for area in self.window.screen.areas if area.type == "VIEW_3D")
        self.taken: list[str] = []
        self._drawn: set[str] = set()
        self._sidebars_drawn = 0
        bpy.types.SpaceView3D.draw_handler_add(self._count_sidebar, (), "UI", "POST_PIXEL")

    def _count_sidebar(self) -> None:
        self._sidebars_drawn += 1

    def region(self, kind: str) -> bpy.types.Region:
        return next(region for region in self.area.regions if region.type == kind)

    def override(self, kind: str = "WINDOW") -> object:
        return bpy.context.temp_override(window=self.window, area=self.area, region=self.region(kind))

    def middle(self) -> tuple[int, int]:
        """A place over the scene, clear of the bars."""
        region = self.region("WINDOW")
        return region.x + region.width // 3, region.y + region.height // 2

    def alone(self) -> Wait:
        """Close every other window."""
        for window in list(bpy.context.window_manager.windows):
            if window != self.window:
                with bpy.context.temp_override(window=window):
                    bpy.ops.wm.window_close()
        yield 1.0

    # The hand

    def move(self, x: int, y: int) -> Wait:
        self.window.event_simulate("MOUSEMOVE", "NOTHING", x=x, y=y)
        yield 0.02

    def press(self, key: str, x: int, y: int, *, ctrl: bool = False, shift: bool = False) -> Wait:
        yield from self.move(x, y)
        for value in ("PRESS", "RELEASE"):
            self.window.event_simulate(key, value, x=x, y=y, ctrl=ctrl, shift=shift)
            yield 0.02

    def write(self, text: str) -> Wait:
        """Type letters, where the pointer is; those that no key has come as from an input method."""
        x, y = self.middle()
        for letter in text:
            key = letter.upper() if letter.isascii() else "A"
            self.window.event_simulate(key, "PRESS", x=x, y=y, unicode=letter)
            yield 0.02
            self.window.event_simulate(key, "RELEASE", x=x, y=y)
            yield 0.02

    def click(self, x: int, y: int, *, ctrl: bool = False) -> Wait:
        yield from self.press("LEFTMOUSE", x, y, ctrl=ctrl)

    # The eye

    def picture(self, name: str) -> Wait:
        """The whole window, once it has been drawn."""
        yield 0.8
        file = self.pictures / f"{name}.png"
        subprocess.run(["import", "-window", "root", str(file)], check=True)
        self.taken.append(name)

    def rectangle(self, part: bpy.types.Region | bpy.types.Window) -> list[int]:
        """Where on the screen it lies: left, top, width, height in pixels from the top left corner."""
        return [part.x, self.window.height - part.y - part.height, part.width, part.height]

    def until(self, done: Callable[[], bool], *, seconds: float, what: str) -> Wait:
        began = time.monotonic()
        while not done():
            if time.monotonic() - began > seconds:
                raise TimeoutError(f"{what} has not come to pass within {seconds:.0f} s")
            yield 0.02

    # The sidebar

    def watch_panels(self) -> None:
        """Note which of the extension's panels are drawn, that is, stand open."""
        for name in dir(bpy.types):
            if name.startswith("CURECON_PT_"):
                kind = getattr(bpy.types, name)
                kind.draw = self._noting(name, kind.draw)

    def _noting(self, name: str, draw: Callable[..., None]) -> Callable[..., None]:
        def noted(panel: object, context: bpy.types.Context) -> None:
            self._drawn.add(name)
            draw(panel, context)

        return noted

    def open_panels(self) -> Iterator[float]:
        """Returns (of the generator) the panels that stand open."""
        before = self._sidebars_drawn
        self._drawn.clear()
        self.region("UI").tag_redraw()
        yield from self.until(lambda: self._sidebars_drawn > before, seconds=30, what="drawing the sidebar")
        return set(self._drawn)

    def sidebar(self, category: str) -> Wait:
        """Open the sidebar with N and its tab with a click."""
        region = self.region("UI")
        if region.width < 10:
            yield from self.press("N", *self.middle())
            yield 1.0
        for y in range(region.y + region.height - 15, region.y, -STEP):
            if region.active_panel_category == category:
                return
            yield from self.click(region.x + region.width - 8, y)
        raise LookupError(f"the sidebar has no tab {category}")

    def _rows(self) -> range:
        region = self.region("UI")
        return range(region.y + region.height - 6, region.y, -STEP)

    def header(self, panel: str) -> Iterator[float]:
        """Returns the place of the panel's header: where a click folds and unfolds it. Turns the wheel where it lies
        below what is seen."""
        for _ in range(SCROLLS):
            if place := (yield from self._header_in_sight(panel)):
                return place
            yield from self._turn_wheel("WHEELDOWNMOUSE")
        raise LookupError(f"the sidebar shows no header of {panel}")

    def _turn_wheel(self, way: str) -> Wait:
        region = self.region("UI")
        for _ in range(WHEEL):
            yield from self.press(way, region.x + 60, region.y + region.height // 2)
        yield FOLDING

    def _header_in_sight(self, panel: str) -> Iterator[float]:
        """Returns its place, or None."""
        x = self.region("UI").x + 60
        before = yield from self.open_panels()
        for y in self._rows():
            yield from self.move(x, y)
            if self._under():
                continue  # a button is no header
            yield from self.click(x, y)
            yield FOLDING
            after = yield from self.open_panels()
            if after != before:
                toggled = before ^ after
                for _ in range(5):  # a slow computer may miss a click
                    yield from self.click(x, y)
                    yield FOLDING
                    if (yield from self.open_panels()) == before:
                        break
                if panel in toggled and toggled <= {panel, *_children(panel)}:
                    return x, y
        return None

    def open_only(self, panel: str) -> Wait:
        """Ctrl-click the header, which folds all others away."""
        yield from self._turn_wheel("WHEELUPMOUSE")
        x, y = yield from self.header(panel)
        for _ in range(2):
            yield from self.click(x, y, ctrl=True)
            yield FOLDING
            if panel in (yield from self.open_panels()):
                break
        else:
            raise LookupError(f"{panel} does not open")
        yield from self.move(*self.middle())

    def open(self, panel: str) -> Wait:
        if panel not in (yield from self.open_panels()):
            yield from self.click(*(yield from self.header(panel)))
            yield FOLDING

    def fold(self, panel: str) -> Wait:
        if panel in (yield from self.open_panels()):
            yield from self.click(*(yield from self.header(panel)))
            yield FOLDING

    def button(self, what: str) -> Iterator[float]:
        """Returns the place of the button of an operator (its idname) or of a property (the end of its path)."""
        region = self.region("UI")
        for y in self._rows():
            for share in (0.2, 0.42, 0.6, 0.8):
                x = region.x + int(region.width * share)
                yield from self.move(x, y)
                if what in self._under():
                    return x, y
        raise LookupError(f"the sidebar shows no button {what}")

    def _under(self) -> str:
        """What the button under the pointer does, as Blender copies it for scripts."""
        found = ""
        with self.override("UI"):
            for copy in (bpy.ops.ui.copy_python_command_button, bpy.ops.ui.copy_data_path_button):
                if copy.poll():
                    bpy.context.window_manager.clipboard = ""
                    if copy() == {"FINISHED"}:
                        found += bpy.context.window_manager.clipboard + "\n"
        return found

    def push(self, what: str) -> Wait:
        """Find a button and click it."""
        yield from self.click(*(yield from self.button(what)))
        yield from self.move(*self.middle())

    def choose(self, what: str, key: str, picture: str) -> Wait:
        """Open the menu of a property, take a picture, and press the key of an entry."""
        place = yield from self.button(what)
        yield from self.click(*place)
        yield from self.picture(picture)
        yield from self.press(key, *place)
        yield 0.3
        yield from self.move(*self.middle())


def _children(panel: str) -> set[str]:
    return {name for name in dir(bpy.types)
            if name.startswith("CURECON_PT_") and getattr(getattr(bpy.types, name), "bl_parent_id", "") == panel}
