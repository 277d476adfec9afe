# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A workspace's mesh against the exact truth of the sample site.

    python -m evaluation.mesh WORKSPACE SITE [--mesh FILE ...] [--radius 32] [--json]

Points are drawn evenly from the mesh's surface and measured as evaluation.site measures the cloud: brought into the
truth's frame by the cameras, cropped to an upright cylinder, thinned to a voxel of 5 cm. Once from the whole surface
and once without the faces marked as filled: what the photos did not see is missing there, not wrong. Beside them the
share of filled surface, by area, within the cylinder and in the whole mesh. `--mesh` measures other meshes than the
workspace's mesh.ply; they must be in its frame and hold triangles as core.mesh writes them.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.surface.mesh import Mesh, filled_share, read_mesh

from . import cloud_metrics
from .alignment import align_cameras, read_centres
from .cloud_metrics import CloudErrors
from .site import MAX_DISTANCE, THRESHOLDS, VOXEL

_DENSITY = 2.0  # points drawn, on average, for each square of the voxel's side


@dataclass(frozen=True, kw_only=True)
class MeshReport:
    """One mesh's figures; shares of filled surface are of the area, in percent."""

    mesh: str
    faces: int
    filled: float  # within the cylinder
    filled_everywhere: float
    surface: CloudErrors
    measured: CloudErrors  # without the filled faces


def report(mesh_file: Path, workspace: Path, site: Path, radius: float | None = None) -> MeshReport:
    """Measure a mesh in the frame of a workspace. Raises WorkspaceError where a file is missing or nothing is left."""
    mesh = read_mesh(mesh_file)
    to_truth = align_cameras(read_centres(workspace), read_centres(site / "truth"))
    truth = cloud_metrics.read_points(site / "truth" / "cloud.npz")
    if radius is None:
        with np.load(site / "truth" / "cloud.npz") as file:
            radius = float(file["radius"])
    truth = truth[np.hypot(truth[:, 0], truth[:, 1]) < radius]
    points, face = sample(mesh, VOXEL / np.sqrt(_DENSITY) / to_truth.scale)
    points = to_truth.apply(points)
    inside = np.hypot(points[:, 0], points[:, 1]) < radius
    filled = mesh.filled[face]

    def errors(which: np.ndarray) -> CloudErrors:
        return cloud_metrics.cloud_errors(cloud_metrics.thin(points[which], VOXEL), truth, THRESHOLDS, MAX_DISTANCE)

    return MeshReport(
        mesh=str(mesh_file), faces=len(mesh.faces), filled=100 * float(filled[inside].mean()) if inside.any() else 0.0,
        filled_everywhere=100 * filled_share([mesh]),
        surface=errors(inside), measured=errors(inside & ~filled),
    )


def sample(mesh: Mesh, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (n,3) float64 drawn evenly from the surface, one a square of side `spacing`, and the face of each (n,)."""
    random = np.random.default_rng(0)
    area = mesh.areas
    ends = np.cumsum(area)
    count = int(np.ceil(ends[-1] / spacing**2))
    face = np.searchsorted(ends, (np.arange(count) + random.random(count)) * ends[-1] / count)
    face = np.minimum(face, len(area) - 1)
    root, second = np.sqrt(random.random(count)), random.random(count)
    weights = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    points: np.ndarray = np.einsum("nk,nkc->nc", weights, mesh.vertices[mesh.faces[face]].astype(np.float64))
    return points, face


def text(reports: list[MeshReport]) -> str:
    """The reports side by side, for people."""
    rows = {}
    for r in reports:
        name = Path(r.mesh).name
        rows[name] = r.surface
        rows[f"{name}, not filled"] = r.measured
    lines = ["Mesh, metres", cloud_metrics.table(rows), ""]
    lines += [f"{Path(r.mesh).name:24.24} {r.faces} faces; filled {r.filled:.2f} % of the area within the cylinder, "
              f"{r.filled_everywhere:.2f} % of the whole" for r in reports]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.mesh", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path, metavar="WORKSPACE")
    parser.add_argument("site", type=Path, metavar="SITE")
    parser.add_argument("--mesh", type=Path, nargs="+", help="meshes to measure (default: WORKSPACE/mesh.ply)")
    parser.add_argument("--radius", type=float, help="metres about the origin (default: that of the true cloud)")
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    args = parser.parse_args(arguments)
    meshes = args.mesh or [args.workspace / "mesh.ply"]
    try:
        reports = [report(mesh, args.workspace, args.site, args.radius) for mesh in meshes]
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    print(json.dumps([asdict(r) for r in reports]) if args.json else text(reports))
    return 0


if __name__ == "__main__":
    sys.exit(main())
