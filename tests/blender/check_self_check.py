# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The self-check of the preferences, where it passes and where it fails. Arguments: a Python that has the worker's
libraries, and one that has none."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy

import curecon_blender
from curecon_blender import preferences
from curecon_blender.operators import running, self_check

WORKING, BARE = map(Path, sys.argv[1:3])
defaults = preferences.Settings.__init__.__kwdefaults__
curecon_blender.register()
try:
    assert "not been checked" in self_check.diagnostics(bpy.context)

    defaults["worker_python"] = BARE
    try:
        bpy.ops.curecon.self_check()
        raise AssertionError("a Python without libraries cannot do the work")
    except RuntimeError as error:
        assert "lacks a library" in str(error) and "Get Libraries" in str(error), error
    told = self_check.diagnostics(bpy.context)
    assert "Check failed (setup)" in told and "numpy" in told and bpy.app.version_string in told, told

    defaults["worker_python"], defaults["device"] = WORKING, "cpu"
    assert bpy.ops.curecon.self_check() == {"FINISHED"}
    assert running.status.result.summary["synthetic_points"] > 10_000
    told = self_check.diagnostics(bpy.context)
    assert "Check passed" in told and "torch" in told and "GiB" in told and str(WORKING) in told, told
finally:
    curecon_blender.unregister()
print("CHECKED")
