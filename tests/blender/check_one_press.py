# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos become a textured mesh and a picture of it with one press. Arguments: photos, a copy of their workspace with a
finished cloud, a Python for the worker."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from pictures import pixels_of

import curecon_blender
from curecon_blender import preferences
from curecon_blender.scene import cameras, flight, site
from curecon_blender.scene.surface import surfaces_of

PHOTOS, WORKSPACE, PYTHON = map(Path, sys.argv[1:4])
preferences.Settings.__init__.__kwdefaults__["worker_python"] = PYTHON
curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    assert not bpy.ops.curecon.make_model.poll(), "there are no photos yet"
    properties = scene.curecon
    properties.photos, properties.workspace = str(PHOTOS), str(WORKSPACE)
    properties.max_image_size, properties.max_faces, properties.texture_size = 320, 3000, "1024"
    properties.goal = "fusion"  # what the button makes does not depend on it
    assert bpy.ops.curecon.make_model() == {"FINISHED"}

    (surface,) = surfaces_of(scene)
    assert properties.result.textured and any(material.node_tree for material in surface.data.materials)
    # The building is whole in the picture: what lies about it, and in the corners of its box, may go on beyond.
    box = site.box(scene, strays=flight.FRINGE)
    core = (np.indices((2, 2, 2)).reshape(3, -1).T * 2 - 1) * box.half * [flight.CORE, flight.CORE, 1]
    for corner in box.centre + core @ np.array([box.axis(index) for index in range(3)]):
        place = world_to_camera_view(scene, scene.camera, Vector(corner.tolist()))
        assert 0 <= place.x <= 1 and 0 <= place.y <= 1 and place.z > 0, f"{corner} is out of the picture"
    picture = pixels_of(WORKSPACE / "presentation" / "still.png")
    assert picture.shape == (540, 960, 3)
    assert (np.ptp(picture[100:440, 200:760], axis=2) > 0.1).mean() > 0.02, "the site's colours do not show"
    assert len(bpy.data.scenes) == 1, "the scene for rendering stays behind"

    # Photos of a façade: it is looked at from where they were taken.
    for item in scene.objects:
        if cameras.is_photo_camera(item):
            item.location = box.centre + np.array([40.0, -3.0, 5.0])
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.render_still() == {"FINISHED"}
    away = np.array(scene.camera.location) - box.centre
    assert away[0] > 5 * abs(away[1]), away
finally:
    curecon_blender.unregister()
print("CHECKED")
