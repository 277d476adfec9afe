# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Control points: Blender's numbers have seven digits and coordinates have more, so the scene keeps them as text, and
what the panel edits reads and writes that text."""

# mypy: disable-error-code="valid-type"
# Blender reads its properties from annotations that are calls.

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
from bpy.props import BoolProperty, CollectionProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from ..core.adjust.control import CHECK, CONTROL, OFF, ControlPoint
from ..scene import control, viewport

ROLES = (
    (CONTROL, "Control", "The cameras are adjusted to it", "PINNED", 0),
    (CHECK, "Check", "Takes no part: it shows how far the adjusted site is off", "CHECKMARK", 1),
    (OFF, "Off", "Neither: it is only kept", "UNPINNED", 2),
)
_NUMBERS = [role[0] for role in ROLES]


def _redraw(properties: CURECON_PG_control, context: bpy.types.Context) -> None:
    viewport.redraw()


def _point(item: CURECON_PG_control_point) -> ControlPoint | None:
    return control.of(item.id_data).point(item.name)


def _change(item: CURECON_PG_control_point, **values: Any) -> None:
    if (point := _point(item)) is not None:
        control.put(item.id_data, control.of(item.id_data).with_points([replace(point, **values)]))


def _sigma(which: str, name: str, description: str) -> object:
    def get(item: CURECON_PG_control_point) -> float:
        point = _point(item)
        return getattr(point, which) if point is not None else 0.0

    return FloatProperty(name=name, description=description, min=0.0001, max=1000.0, soft_max=1.0, precision=3, step=1,
                         get=get, set=lambda item, value: _change(item, **{which: round(value, 6)}))


def _get_role(item: CURECON_PG_control_point) -> int:
    point = _point(item)
    return _NUMBERS.index(point.role) if point is not None else _NUMBERS.index(OFF)


def _set_role(item: CURECON_PG_control_point, value: int) -> None:
    _change(item, role=_NUMBERS[value])


class CURECON_PG_control_point(bpy.types.PropertyGroup):
    """A point on the list; what is known of it stands in the text."""

    name: StringProperty(name="Point", description="Its name, as it was imported")
    role: EnumProperty(name="Use", description="What the point is used for", items=ROLES, get=_get_role,
                       set=_set_role)
    sigma_plan: _sigma("sigma_plan", "Accuracy (m)", "How far it may be off in plan, in metres (one standard "
                       "deviation of east and of north)")
    sigma_height: _sigma("sigma_height", "Height (m)", "How far its height may be off, in metres (one standard "
                         "deviation)")


class CURECON_PG_control(bpy.types.PropertyGroup):
    text: StringProperty(description="The points and their marks as JSON", options={"HIDDEN"})
    folder: StringProperty(description="The workspace that keeps them", options={"HIDDEN"})
    changed: BoolProperty(description="They were changed since the cameras were adjusted", options={"HIDDEN"})
    points: CollectionProperty(
        type=CURECON_PG_control_point, name="Control Points", description="Points whose coordinates were measured",
    )
    index: IntProperty(name="Point", description="The chosen point on the list", default=0, min=0, update=_redraw)
    show: BoolProperty(
        name="Show Points", description="Draw the points over the viewports, and their marks over the photos",
        default=True, update=_redraw,
    )


CLASSES = (CURECON_PG_control_point, CURECON_PG_control)
