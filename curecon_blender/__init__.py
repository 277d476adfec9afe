# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CU-Recon: from drone photos to a coloured point cloud in Blender.

Nothing here imports bpy until Blender calls `register`, so that `curecon_blender.core` works in any Python.
"""

# The add-on's name in Blender is that of the extension (bl_ext.<repository>.curecon_blender), one package up from this
# one; in a source checkout this package stands alone.
ADDON = __package__.rpartition(".")[0] or __package__


def register() -> None:
    import bpy

    from . import operators, panels, preferences, properties
    from .scene import history, overlay, viewport

    for cls in (*preferences.CLASSES, *properties.CLASSES, *operators.CLASSES, *panels.CLASSES):
        bpy.utils.register_class(cls)
    properties.attach()
    operators.add_menus()
    viewport.start()
    overlay.start()
    history.start()


def unregister() -> None:
    import bpy

    from . import operators, panels, preferences, properties, thumbnails
    from .operators import running
    from .scene import history, overlay, viewport

    running.close()
    thumbnails.clear()
    history.stop()
    overlay.stop()
    viewport.stop()
    operators.remove_menus()
    properties.detach()
    for cls in reversed((*preferences.CLASSES, *properties.CLASSES, *operators.CLASSES, *panels.CLASSES)):
        bpy.utils.unregister_class(cls)
