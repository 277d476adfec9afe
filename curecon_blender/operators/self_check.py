# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether the installation works, tried on synthetic views; and what to send with a report when it does not."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path
from typing import Any

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from ..preferences import settings
from . import running
from .running import WorkerOperator


class CURECON_OT_self_check(WorkerOperator, bpy.types.Operator):
    """Reconstruct a little house that is drawn for it: says within a minute whether this computer can do the work,
and what to do if not"""

    bl_idname = "curecon.self_check"
    bl_label = "Check Installation"

    task = "Checking the installation"
    panel = running.PREFERENCES

    def arguments(self, context: bpy.types.Context) -> list[str]:
        return ["self-check", "--device", settings(context).device]

    def done(self, context: bpy.types.Context, scene: bpy.types.Scene, summary: dict[str, Any]) -> str:
        return rpt_("CU-Recon works on this computer.")


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
    if running.panel != running.PREFERENCES or status.running:
        lines.append("The installation has not been checked: press Check Installation first.")
    elif status.failure is not None:
        lines += [f"Check failed ({status.failure.kind}): {status.failure.message}", status.failure.remedy]
    elif status.result is not None:
        lines += ["Check passed:", *described(status.result.summary)]
    return "\n".join([*lines, *status.warnings])


def in_words(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """What a passed check found, for everybody: lines, each with its icon."""
    lines = [(iface_("CU-Recon works on this computer."), "CHECKMARK")]
    device, kind = summary["device"], summary["device_kind"]
    if kind == "cpu":
        lines.append((iface_("The processor does the work."), "INFO"))
    else:
        lines.append((iface_("The graphics card does the work: {}.").format(device), "INFO"))
    if summary["unused_card"]:
        lines.append((iface_("The NVIDIA card in it could do it several times faster, with libraries for it. The "
                             "manual says how, under Install."), "INFO"))
    memory = iface_("Memory: {:.0f} GiB, {:.0f} GiB of it free. Depth maps take up to {:.0f} GiB.")
    lines.append((memory.format(summary["memory_gib"], summary["free_memory_gib"], summary["budget_gib"]), "INFO"))
    return lines


def described(summary: dict[str, Any]) -> list[str]:
    """What a passed check found, for a report, a line each."""
    return [
        f"{summary['synthetic_points']:,} points in {summary['seconds']:.0f} s",
        f"{summary['device']} ({summary['device_kind']}), {summary['threads']} threads",
        f"Memory: {summary['memory_gib']} GiB, {summary['free_memory_gib']} GiB free, "
        f"{summary['budget_gib']} GiB for depth maps",
        f"Python {summary['python']}",
        ", ".join(f"{name} {version}" for name, version in summary["libraries"].items()),
    ]


CLASSES = (CURECON_OT_self_check, CURECON_OT_copy_diagnostics)
