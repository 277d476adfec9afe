# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Marking control points in the photos, from photo to photo."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_
from bpy.props import FloatVectorProperty, IntProperty, StringProperty

from ..core.base.errors import CuReconError
from ..scene import cameras, control, control_overlay, loupe, picking, viewport
from . import running
from .picking import NAVIGATION, over_view

STEPS = {"N": 1, "RIGHT_ARROW": 1, "PAGE_DOWN": 1, "P": -1, "LEFT_ARROW": -1, "PAGE_UP": -1}
OPACITY = 1.0  # of the photo while one marks: what lies beneath it would only blur it


def _can_mark(operator: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    if not running.idle(operator):
        return False
    if not control.active(context.scene):
        operator.poll_message_set("There are no control points: import them first")
        return False
    if not control.can_mark(context.scene):
        operator.poll_message_set("There are no photos to mark in: reconstruct them, or run Reconstruct once more if "
                                  "the workspace is an older one")
        return False
    return True


class CURECON_OT_set_mark(bpy.types.Operator):
    """Mark a control point at a pixel of a photo, or take its mark there away"""

    bl_idname = "curecon.set_mark"
    bl_label = "Mark Control Point"
    bl_options = {"REGISTER", "UNDO", "INTERNAL"}

    point: StringProperty(name="Point", description="The control point's name", options={"SKIP_SAVE"})
    photo: StringProperty(name="Photo", description="The photo's name in the job", options={"SKIP_SAVE"})
    pixel: FloatVectorProperty(
        name="Pixel", description="From the photo's upper left corner, as it is displayed; none takes the mark away",
        size=2, precision=2, options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return running.idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        if control.of(scene).point(self.point) is None:
            self.report({"ERROR"}, rpt_("There is no control point {}.").format(self.point))
            return {"CANCELLED"}
        try:
            if self.properties.is_property_set("pixel"):
                control.add_mark(scene, self.point, self.photo, tuple(self.pixel))
            else:
                control.remove_mark(scene, self.point, self.photo)
        except CuReconError as error:
            self.report({"ERROR"}, running.explain(error))
            return {"CANCELLED"}
        viewport.redraw()
        return {"FINISHED"}


class CURECON_OT_show_point(bpy.types.Operator):
    """Look through the next photo in which the chosen point can be marked, best first"""

    bl_idname = "curecon.show_point"
    bl_label = "Next Photo"
    bl_options = {"REGISTER", "UNDO"}

    step: IntProperty(name="Step", description="1 for the next photo, -1 for the one before", default=1, min=-1, max=1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _can_mark(cls, context)

    def execute(self, context: bpy.types.Context) -> set[str]:
        said = show_next(context, self.step)
        self.report({"INFO"} if said else {"WARNING"}, said or rpt_("The point is in none of the photos."))
        return {"FINISHED"} if said else {"CANCELLED"}


def show_next(context: bpy.types.Context, step: int) -> str:
    """Look through the photo that comes next in the chosen point's walk (step 0: the first); "" where there is none."""
    scene, name = context.scene, control.active(context.scene)
    found = control.walk(scene, name)
    if not found:
        return ""
    here = next((number for number, camera in enumerate(found) if camera.item == scene.camera), None)
    number = 0 if here is None or not step else (here + step) % len(found)
    camera = found[number]
    cameras.look_through(context, camera.item)
    cameras.overlay(camera.item, OPACITY)
    return rpt_("{}: photo {} of {}, {}.").format(name, number + 1, len(found), camera.name)


class CURECON_OT_mark_points(bpy.types.Operator):
    """Mark the chosen point in the photos: click where it is, go on with N, and end with Esc"""

    bl_idname = "curecon.mark_points"
    bl_label = "Mark in Photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return _can_mark(cls, context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if context.area is None or context.area.type != "VIEW_3D":
            self.report({"ERROR"}, "Points are marked in a 3D viewport: start it from there.")
            return {"CANCELLED"}
        self._area = context.area
        self._region = next(region for region in context.area.regions if region.type == "WINDOW")
        if self._camera(context) is None and not show_next(context, 0):
            self.report({"WARNING"}, "The point is in none of the photos.")
            return {"CANCELLED"}
        self._taken_up(context)
        picking.prepare(context)
        context.window.cursor_modal_set("CROSSHAIR")
        context.window_manager.modal_handler_add(self)
        control_overlay.marking = context.area.as_pointer()
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type in {"ESC", "RET", "RIGHTMOUSE"} and event.value == "PRESS":
            self._stop(context)
            return {"FINISHED"}
        if not over_view(self._area, self._region, event) or not control.active(context.scene):
            return {"PASS_THROUGH"}
        if event.type == "MOUSEMOVE":
            control_overlay.mouse = self._mouse(event)
            if (camera := self._camera(context)) is not None and not loupe.has(camera.file):  # after an undo
                self._taken_up(context)
            self._area.tag_redraw()
            return {"PASS_THROUGH"}
        if event.value != "PRESS" or event.ctrl or event.oskey:
            return {"PASS_THROUGH"}
        if event.type == "LEFTMOUSE":
            self._mark(context, event)
        elif event.type in STEPS:
            self._show(context, STEPS[event.type])
        elif event.type in {"X", "DEL"}:
            self._unmark(context)
        elif event.type in {"EQUAL", "NUMPAD_PLUS", "MINUS", "NUMPAD_MINUS"}:
            step = 1 if event.type in {"EQUAL", "NUMPAD_PLUS"} else -1
            loupe.zoom = min(max(loupe.zoom + step, 0), len(loupe.ZOOMS) - 1)
        elif event.type == "TAB":
            properties = context.scene.curecon.control
            properties.index = (properties.index + (-1 if event.shift else 1)) % len(properties.points)
            self._show(context, 0)
        elif event.type not in NAVIGATION:
            return {"RUNNING_MODAL"}
        else:
            return {"PASS_THROUGH"}
        self._area.tag_redraw()
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator itself when another file is loaded or it quits."""
        self._stop(context)

    def _camera(self, context: bpy.types.Context) -> control.PhotoCamera | None:
        """The photo that the viewport looks at, with its picture over the scene."""
        space = self._area.spaces.active
        if space.region_3d.view_perspective != "CAMERA" or not cameras.is_overlaid(space.camera):
            return None
        return control.photo_camera(space.camera)

    def _mark(self, context: bpy.types.Context, event: bpy.types.Event) -> None:
        camera, mouse = self._camera(context), self._mouse(event)
        view = self._area.spaces.active.region_3d
        pixel = None if camera is None else control.pixel_under(self._region, view, camera, mouse)
        if camera is None or pixel is None:
            self.report({"WARNING"}, "Nothing there: mark within the photo, or go to the next one with N.")
            return
        name = control.active(context.scene)
        if (place := picking.under(context, self._region, view, mouse)) is not None:
            control.met[name] = np.asarray(place)
        # An undo step of its own: the marks can be taken back one after the other.
        bpy.ops.curecon.set_mark("EXEC_DEFAULT", True, point=name, photo=camera.name, pixel=pixel.tolist())
        self._say(context)

    def _unmark(self, context: bpy.types.Context) -> None:
        if (camera := self._camera(context)) is not None:
            bpy.ops.curecon.set_mark("EXEC_DEFAULT", True, point=control.active(context.scene), photo=camera.name)
            self._say(context)

    def _show(self, context: bpy.types.Context, step: int) -> None:
        with context.temp_override(area=self._area, region=self._region):
            if not show_next(context, step):
                self.report({"WARNING"}, "The point is in none of the photos.")
        self._taken_up(context)

    def _taken_up(self, context: bpy.types.Context) -> None:
        camera = self._camera(context)
        if camera is not None and not loupe.take(camera.file, Path(context.scene.curecon.control.folder)):
            said = rpt_("{} is not where it was: the loupe shows nothing, and marks are less exact.")
            self.report({"WARNING"}, said.format(camera.file))
        self._say(context)

    def _say(self, context: bpy.types.Context) -> None:
        scene, camera = context.scene, self._camera(context)
        name, marks = control.active(scene), len(control.of(scene).marks_of(control.active(scene)))
        where = iface_("{}, {} marks: {}").format(name, marks, camera.name if camera is not None else "")
        keys = iface_("Click: mark    N, P: next, previous photo    X: remove mark    Tab: next point    + -: loupe"
                      "    Esc: end")
        self._area.header_text_set(f"{where}    {keys}")

    def _mouse(self, event: bpy.types.Event) -> tuple[float, float]:
        return event.mouse_x - self._region.x, event.mouse_y - self._region.y

    def _stop(self, context: bpy.types.Context) -> None:
        control_overlay.mouse, control_overlay.marking = None, 0
        loupe.forget()
        picking.forget()
        self._area.header_text_set(None)
        if context.window is not None:
            context.window.cursor_modal_restore()
        self._area.tag_redraw()


CLASSES = (CURECON_OT_set_mark, CURECON_OT_show_point, CURECON_OT_mark_points)
