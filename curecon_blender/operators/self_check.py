# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the installation works, tried on synthetic views; and what to send with a report when it does not."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..preferences import settings
from . import running
from .running import WorkerOperator

PANEL = "preferences"


class CURECON_OT_self_check(WorkerOperator, bpy.types.Operator):
    """Load the worker's libraries and reconstruct a few synthetic views: says within a minute whether this computer can
do the work, and what to do if not"""

    bl_idname = "curecon.self_check"
    bl_label = "Check Installation"

    task = "Checking the installation"
    panel = PANEL

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return ["self-check", "--device", settings(context).device]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        return rpt_("The installation works: {:,} points in {:.0f} s.").format(
            summary["synthetic_points"], summary["seconds"])


class CURECON_OT_copy_diagnostics(bpy.types.Operator):
    """Copy versions, device, memory and what the last check said, for a report. No file names of photos are in it"""

    bl_idname = "curecon.copy_diagnostics"
    bl_label = "Copy Diagnostics"

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = diagnostics(context)
        self.report({"INFO"}, "The diagnostics are on the clipboard.")
        return {"FINISHED"}


def diagnostics(context: bpy.types.Context) -> str:
    """The text for a report: what is known without the worker, and what the worker said when it was last checked."""
    manifest = Path(__file__).resolve().parents[2] / "blender_manifest.toml"
    version = tomllib.loads(manifest.read_text(encoding="utf-8"))["version"]
    chosen = settings(context)
    lines = [
        f"CU-Recon {version} in Blender {bpy.app.version_string} on {platform.platform()}",
        f"Worker Python: {chosen.worker_python}", f"Device: {chosen.device}",
        f"Memory budget: {'automatic' if chosen.memory_gib is None else f'{chosen.memory_gib} GiB'}",
    ]
    status = running.status
    if running.panel != PANEL or status.running:
        lines.append("The installation has not been checked: press Check Installation first.")
    elif status.failure is not None:
        lines += [f"Check failed ({status.failure.kind}): {status.failure.message}", status.failure.remedy]
    elif status.result is not None:
        lines += ["Check passed:", *described(status.result.summary)]
    return "\n".join([*lines, *status.warnings])


def described(summary: dict[str, Any]) -> list[str]:
    """What a passed check found, a line each."""
    return [
        f"{summary['synthetic_points']:,} points in {summary['seconds']:.0f} s",
        f"{summary['device']} ({summary['device_kind']}), {summary['threads']} threads",
        f"Memory: {summary['memory_gib']} GiB, {summary['free_memory_gib']} GiB free, "
        f"{summary['budget_gib']} GiB for depth maps",
        f"Python {summary['python']}",
        ", ".join(f"{name} {version}" for name, version in summary["libraries"].items()),
    ]


CLASSES = (CURECON_OT_self_check, CURECON_OT_copy_diagnostics)
