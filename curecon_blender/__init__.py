# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CU-Recon: from drone photos to a coloured point cloud in Blender.

Nothing here imports bpy until Blender calls `register`, so that `curecon_blender.core` works in any Python.
"""


def register() -> None:
    import bpy

    from . import languages, operators, panels, properties
    from .scene import control_overlay, history, overlay, stations_overlay, viewport

    languages.start()
    for cls in (*properties.CLASSES, *operators.CLASSES, *panels.CLASSES):
        bpy.utils.register_class(cls)
    properties.attach()
    operators.add_menus()
    viewport.start()
    overlay.drawing.start()
    control_overlay.drawing.start()
    stations_overlay.drawing.start()
    history.start()


def unregister() -> None:
    import bpy

    from . import languages, operators, panels, properties, thumbnails
    from .operators import publish, running
    from .scene import control_overlay, history, loupe, overlay, stations_overlay, viewport

    running.close()
    publish.close()
    thumbnails.clear()
    history.stop()
    loupe.forget()
    stations_overlay.drawing.stop()
    control_overlay.drawing.stop()
    overlay.drawing.stop()
    viewport.stop()
    operators.remove_menus()
    properties.detach()
    for cls in reversed((*properties.CLASSES, *operators.CLASSES, *panels.CLASSES)):
        bpy.utils.unregister_class(cls)
    languages.stop()
