# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene and the preferences ask of a job, as the one record of options."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..core.base.errors import SurfaceError
from ..core.base.options import PRESETS, SURFACE_STAGES, Options
from ..preferences import settings
from ..scene import region
from ..scene.surface import surfaces_of
from ..scene.workspace import clouds_of, in_workspace
from . import paths


def job_options(context: bpy.types.Context, *, until: str) -> Options:
    """From the scene's photos to the stage `until`. Raises PhotoError without photos, SurfaceError as below."""
    properties, chosen = context.scene.curecon, settings(context)
    workspace = paths.workspace_folder(context, context.scene)
    return Options(
        photos=paths.photos_folder(context.scene), workspace=workspace, until=until, quality=properties.quality,
        surplus=properties.surplus, model=paths.absolute(properties.model) if properties.model else None,
        max_image_size=properties.max_image_size or None, views=properties.views or None,
        speeds=paths.speeds_file(), memory_gib=chosen.memory_gib, device=chosen.device, scheduler=chosen.scheduler,
        **_of_surface(context.scene, workspace) if until in SURFACE_STAGES else {},
    )


def surface_options(
    scene: bpy.types.Scene, workspace: Path, *, until: str, detail: tuple[str, ...] = ()
) -> Options:
    """From the finished cloud of a workspace to the stage `until`, and at these levels of detail. Raises SurfaceError
    when a region is asked for and there is none."""
    return Options(photos=None, workspace=workspace, until=until, detail=detail, **_of_surface(scene, workspace))


def _of_surface(scene: bpy.types.Scene, workspace: Path) -> dict[str, Any]:
    """The fields of Options that mesh and texture depend on."""
    properties = scene.curecon
    chosen: dict[str, Any] = {
        "fill_holes": properties.fill_holes, "extent": properties.extent,
        "max_faces": properties.max_faces or PRESETS[properties.quality].mesh_faces,
        "texture_size": int(properties.texture_size), "texture_format": properties.texture_format,
    }
    if not properties.use_region:
        return chosen
    if properties.region is None:
        raise SurfaceError(
            "Region is ticked, but no region box is chosen.",
            remedy="Choose or add a region box under Surface > Advanced, or untick Region.",
        )
    bounds, turn = region.placed(properties.region, reference(scene, workspace))
    return chosen | {"region": bounds, "region_turn": tuple(turn) if turn.angle > 1e-6 else None}


def reference(scene: bpy.types.Scene, workspace: Path) -> bpy.types.Object | None:
    """What tells where the workspace's frame stands in the scene: a cloud or surface of it that is shown, as a hidden
    one does not follow when the user moves things."""
    return next((item for item in in_workspace(scene, workspace, [*surfaces_of(scene), *clouds_of(scene)])
                 if not item.hide_viewport), None)
