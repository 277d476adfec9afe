# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What every operator that picks places on the cloud or the surface has in common."""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import FloatVectorProperty

from ..core.base.errors import CuReconError
from ..scene import overlay, picking, viewport
from ..scene.frame import parts_of
from . import running

NAVIGATION = {"MIDDLEMOUSE", "WHEELUPMOUSE", "WHEELDOWNMOUSE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE",
              "MOUSESMARTZOOM", "NDOF_MOTION", "NUMPAD_PERIOD", *(f"NUMPAD_{digit}" for digit in range(10))}


def place_property(which: str) -> object:
    """A picked place as an operator's property, for scripts and for adjusting afterwards."""
    return FloatVectorProperty(
        name=which, description="A place on the cloud or the surface, in the scene's axes and units",
        subtype="TRANSLATION", options={"SKIP_SAVE"},
    )


def over_view(area: bpy.types.Area, view: bpy.types.Region, event: bpy.types.Event) -> bool:
    """Whether the mouse is over the view itself, not over a sidebar or a header that lies upon it."""
    def holds(region: bpy.types.Region) -> bool:
        return (region.x <= event.mouse_x < region.x + region.width
                and region.y <= event.mouse_y < region.y + region.height)

    return holds(view) and not any(
        holds(region) for region in area.regions if region.type != "WINDOW" and region.width > 1
    )


class PickingOperator:
    """Mixin: lets the user pick the places that are named in `places`, in order, then runs `execute`.

    Called with those properties set, as scripts do, it picks nothing. With `asks`, a dialog for its other properties
    comes after the picks. A subclass gives `apply`, which does what was asked with the picked places (3,) in the world
    and returns a report; it may raise CuReconError.
    """

    apply: Callable[[bpy.types.Context, list[np.ndarray]], str]
    report: Callable[..., None]  # Blender's own
    places: tuple[str, ...] = ()
    prompts: tuple[str, ...] = ()  # what to pick, one a place
    asks = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not running.idle(cls):
            return False
        if not parts_of(context.scene):
            cls.poll_message_set("There is no cloud in the scene: reconstruct photos "  # type: ignore[attr-defined]
                                 "or import a workspace first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self._has_places():
            return context.window_manager.invoke_props_dialog(self) if self.asks else self.execute(context)
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Places are picked in a 3D viewport: start it from there.")
            return {"CANCELLED"}
        self._area = context.area
        self._region = next(region for region in context.area.regions if region.type == "WINDOW")
        overlay.picked.clear()
        picking.prepare(context)
        context.window.cursor_modal_set("CROSSHAIR")
        context.window_manager.modal_handler_add(self)
        self._say(context)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RIGHTMOUSE"} and event.value == "PRESS":
            self._stop(context)
            return {"CANCELLED"}
        if event.type == "BACK_SPACE" and event.value == "PRESS":
            if overlay.picked:
                overlay.picked.pop()
            self._say(context)
            return {"RUNNING_MODAL"}
        if event.type in NAVIGATION or not over_view(self._area, self._region, event):
            return {"PASS_THROUGH"}
        if event.type == "MOUSEMOVE":
            overlay.hover = self._under(context, event)
            self._area.tag_redraw()
        elif event.type == "LEFTMOUSE" and event.value == "PRESS":
            if (place := self._under(context, event)) is None:
                self.report({"WARNING"}, "Nothing there: pick a place on the cloud or the surface.")
                return {"RUNNING_MODAL"}
            overlay.picked.append(place)
            if len(overlay.picked) == len(self.places):
                return self._finish(context)
            self._say(context)
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits."""
        self._stop(context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self._has_places():
            self.report({"ERROR"}, rpt_("It needs the places {}.").format(", ".join(self.places)))
            return {"CANCELLED"}
        try:
            self.report({"INFO"}, self.apply(context, [np.array(getattr(self, name)) for name in self.places]))
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        viewport.redraw()
        return {"FINISHED"}

    def _finish(self, context: bpy.types.Context) -> set[str]:
        picked = dict(zip(self.places, overlay.picked[:], strict=True))
        self._stop(context)
        if self.asks:  # anew, since a modal operator cannot turn into a dialog
            operator = getattr(bpy.ops.curecon, type(self).bl_idname.removeprefix("curecon."))  # type: ignore[attr-defined]
            operator("INVOKE_DEFAULT", **{name: place.tolist() for name, place in picked.items()})
            return {"CANCELLED"}
        for name, place in picked.items():
            setattr(self, name, place)
        return self.execute(context)

    def _has_places(self) -> bool:
        return all(self.properties.is_property_set(name) for name in self.places)  # type: ignore[attr-defined]

    def _under(self, context: bpy.types.Context, event: bpy.types.Event) -> np.ndarray | None:
        mouse = event.mouse_x - self._region.x, event.mouse_y - self._region.y
        return picking.under(context, self._region, self._area.spaces.active.region_3d, mouse)

    def _say(self, context: bpy.types.Context) -> None:
        count = len(overlay.picked)
        prompt = pgettext_iface(self.prompts[min(count, len(self.prompts) - 1)])
        keys = pgettext_iface("Backspace: take one back    Esc: cancel")
        self._area.header_text_set(f"{prompt} ({count + 1}/{len(self.places)})    {keys}")
        self._area.tag_redraw()

    def _stop(self, context: bpy.types.Context) -> None:
        overlay.picked.clear()
        overlay.hover = None
        picking.forget()
        self._area.header_text_set(None)
        if context.window is not None:
            context.window.cursor_modal_restore()
        self._area.tag_redraw()
