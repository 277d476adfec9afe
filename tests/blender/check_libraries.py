# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Get Libraries fetches what the worker lacks, only where Blender may go online, and Remove Libraries takes it away.
Arguments: a folder of locks, a Python with pip, the address of a package index."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

import curecon_blender
from curecon_blender import preferences
from curecon_blender.operators import libraries
from curecon_blender.preferences import settings

defaults = preferences.Settings.__init__.__kwdefaults__
defaults["worker_python"], defaults["indexes"] = Path(sys.argv[2]), (sys.argv[3].replace(":/", "://", 1),)
preferences.LOCKS = libraries.LOCKS = Path(sys.argv[1])
curecon_blender.register()
try:
    chosen = settings(bpy.context)
    assert not chosen.has_libraries and chosen.libraries not in chosen.import_paths
    bpy.context.preferences.system.use_online_access = False
    assert not bpy.ops.curecon.get_libraries.poll(), "nothing goes online where the user does not allow it"
    assert not bpy.ops.curecon.remove_libraries.poll()

    bpy.context.preferences.system.use_online_access = True
    assert bpy.ops.curecon.get_libraries() == {"FINISHED"}
    assert chosen.has_libraries and not chosen.lacks_libraries
    assert chosen.libraries in chosen.import_paths
    assert (chosen.libraries / "curecon_first" / "__init__.py").is_file()

    assert bpy.ops.curecon.remove_libraries() == {"FINISHED"}
    assert not chosen.libraries.exists() and chosen.libraries not in chosen.import_paths

    preferences.LOCKS = libraries.LOCKS = Path(sys.argv[1]) / "none"
    assert not bpy.ops.curecon.get_libraries.poll(), "a zip that brings its libraries fetches none"
finally:
    curecon_blender.unregister()
print("CHECKED")
