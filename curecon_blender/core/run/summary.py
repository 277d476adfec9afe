# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What a finished job tells: counts, what each stage took, and where everything lies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..adjust.record import read_accuracy, rms
from ..base.options import SURFACE_STAGES
from ..cloud.ply import point_count
from ..sparse.models import MAPPED
from ..surface.mesh import filled_share, mesh_file, read_mesh, textured_folder, unseen_share, weak_share
from ..views import record as views_record
from .stages import Job
from .workspace import folder_bytes


def summarise(job: Job, stages: Sequence[str]) -> dict[str, Any]:
    """The JSON summary of a job that ran these stages; seconds and peaks are of when each last ran."""
    root, frames = job.root, [component.frame for component in job.components]
    with_clouds = {"fusion", *SURFACE_STAGES} & set(stages)
    clouds = [root / c.cloud for c in job.components if (root / c.cloud).exists()] if with_clouds else []
    meshes = [c.index for c in job.components if (root / mesh_file(c.index)).exists()]
    records = {stage: record for stage in stages if (record := job.workspace.record(stage))}
    return {
        "photos": len(job.photo_set.photos),
        "skipped": [{"path": str(skipped.path), "reason": skipped.reason} for skipped in job.photo_set.skipped],
        "registered": sum(_registered(root / MAPPED)) if (root / MAPPED).is_dir() else 0,
        "components": [
            {"index": component.index, "photos": len(component.views), "scale": frame.scale, "up": frame.up,
             "gps_residual": frame.gps_residual, "note": frame.note, "doubt": frame.doubt,
             "points": point_count(root / component.cloud), "control": _control(root / component.sparse)}
            for component, frame in zip(job.components, frames, strict=True)
        ],
        "points": sum(point_count(path) for path in clouds),
        "meshes": [_surface(root, index) for index in meshes] if set(SURFACE_STAGES) & set(stages) else [],
        "seconds": {stage: round(record.seconds, 1) for stage, record in records.items()},
        "peak_memory_gib": {stage: round(record.peak_gib, 2) for stage, record in records.items()},
        "workspace_gib": round(folder_bytes(root) / 2**30, 3),
        "warnings": job.reporter.warnings,
        "paths": {
            "workspace": str(root), "sparse": str(root / "sparse"), "views": str(root / views_record.FILE_NAME),
            "depth": str(root / "depth"), "clouds": [str(path) for path in clouds],
        },
    }


def _control(folder: Path) -> dict[str, Any]:
    """What control points, check points and points left out are off in a component (RMS, metres), each kind apart."""
    accuracy = read_accuracy(folder)
    if accuracy is None:
        return {}
    kinds = {"control": accuracy.control, "check": accuracy.check, "left_out": accuracy.left_out}
    return {kind: {"points": len(found), **dict(zip(("plan", "height"), rms(found), strict=True))}
            for kind, found in kinds.items() if found}


def _surface(root: Path, index: int) -> dict[str, Any]:
    """A component's surface; its shares are of the area."""
    textured = root / textured_folder(index) / "mesh.ply"
    mesh = read_mesh(textured if textured.exists() else root / mesh_file(index))
    return {"index": index, "faces": len(mesh.faces), "vertices": len(mesh.vertices),
            "filled_share": round(filled_share([mesh]), 4), "weak_share": round(weak_share([mesh]), 4),
            "unseen_share": round(unseen_share([mesh]), 4),
            "textured": textured.exists()}


def _registered(mapped: Path) -> list[int]:
    """Registered photos of each component: the count that a binary COLMAP model's images begin with."""
    return [int.from_bytes(file.read_bytes()[:8], "little") for file in sorted(mapped.glob("[0-9]*/images.bin"))]
