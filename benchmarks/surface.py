# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""CPU seconds and peak memory of mesh and texture, ours and OpenMVS's, of one cloud with the same cameras.

    python -m benchmarks.surface WORKSPACE --openmvs FOLDER [--cores N]
    python -m benchmarks.surface WORKSPACE

WORKSPACE is a finished cloud; nothing in it changes. FOLDER holds OpenMVS's programs InterfaceCOLMAP, ReconstructMesh
and TextureMesh (2.0 or later). OpenMVS gets the first part's undistorted pictures, cameras and cloud as COLMAP lays
them out, each point with the photos whose depth map agrees with it within a hundredth; its programs run with their own
defaults. Without --openmvs ours alone is measured. Ours textures from the photos at full size, OpenMVS from the
undistorted pictures: make the workspace at the photos' own size to compare.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.ply import row_type, table, write_ply
from curecon_blender.core.base.records import Component
from curecon_blender.core.base.rotations import to_quaternions
from curecon_blender.core.cloud.ply import Cloud, read_cloud
from curecon_blender.core.depth.maps import read_depth
from curecon_blender.core.surface.mesh import mesh_file, read_mesh, textured_folder
from curecon_blender.core.views import record as views_record

PROGRAMS = "InterfaceCOLMAP", "ReconstructMesh", "TextureMesh"
AGREES = 0.01  # of its depth: a photo sees a point whose depth map is no farther off
_POINT = row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("nx", "<f4"), ("ny", "<f4"), ("nz", "<f4"),
                   ("red", "u1"), ("green", "u1"), ("blue", "u1")])


def main() -> int:
    parser = argparse.ArgumentParser(prog="benchmarks.surface", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("workspace", type=Path)
    parser.add_argument("--openmvs", type=Path, help="folder of OpenMVS's programs")
    parser.add_argument("--cores", type=int, default=os.cpu_count(), help="how many OpenMVS may use")
    given = parser.parse_args()
    programs = {}
    if given.openmvs is not None:
        programs = {name: shutil.which(name, path=given.openmvs) for name in PROGRAMS}
        if lacking := [name for name, found in programs.items() if found is None]:
            print(f"{given.openmvs} has no program {', '.join(lacking)}. Build OpenMVS, then name the folder with its "
                  "programs, such as build/bin.", file=sys.stderr)
            return 2
    try:
        component = views_record.read(given.workspace)[0]
        cloud = read_cloud(given.workspace / component.cloud)
        print(f"{len(cloud):,} points, {len(component.views)} photos")
        with tempfile.TemporaryDirectory() as scratch:
            measure_ours(given.workspace, component, Path(scratch) / "ours")
            if programs:
                folder = Path(scratch) / "openmvs"
                lay_out(given.workspace, component, cloud, folder)
                measure_openmvs(programs, folder, given.cores)
    except CuReconError as error:
        print(f"{error.message} {error.remedy}", file=sys.stderr)
        return error.exit_code
    except subprocess.CalledProcessError as error:
        print(f"{error.cmd[0]} ended with {error.returncode}.", file=sys.stderr)
        return 1
    return 0


def measure_ours(workspace: Path, component: Component, copy: Path) -> None:
    """Print a row each of mesh and texture, made in a copy."""
    left_out = shutil.ignore_patterns("mesh*.ply", "textured*", "detail*", "mesh.json", "texture.json",
                                      "workspace.lock")
    shutil.copytree(workspace, copy, ignore=left_out)
    command = [sys.executable, "-m", "curecon_blender.core", "surface", str(copy), "--until"]
    report("ours, mesh", *spent([*command, "mesh"]), len(read_mesh(copy / mesh_file(component.index)).faces))
    textured = copy / textured_folder(component.index) / "mesh.ply"
    report("ours, texture", *spent([*command, "texture"]), len(read_mesh(textured).faces))


def measure_openmvs(programs: dict[str, str], folder: Path, cores: int) -> None:
    """Print a row each of the scene's import, the mesh and the texture."""
    common = ["--working-folder", str(folder), "--max-threads", str(cores)]
    report("OpenMVS, import", *spent([programs["InterfaceCOLMAP"], "-i", str(folder), "-o", "scene.mvs",
                                      "--image-folder", str(folder / "images"), *common]))
    report("OpenMVS, mesh", *spent([programs["ReconstructMesh"], "scene.mvs", "-o", "mesh.ply", *common]),
           faces_of(folder / "mesh.ply"))
    report("OpenMVS, texture", *spent([programs["TextureMesh"], "scene.mvs", "--mesh-file", "mesh.ply", "-o",
                                       "textured.ply", *common]), faces_of(folder / "textured.ply"))


def lay_out(workspace: Path, component: Component, cloud: Cloud, folder: Path) -> None:
    """A dense workspace of COLMAP: pictures, pinhole cameras, and the points with the photos that see each."""
    for name in ("images", "sparse"):
        (folder / name).mkdir(parents=True)
    cameras, poses = [], []
    rotations = to_quaternions(np.stack([view.cam_from_world[:, :3] for view in component.views]))
    for number, (view, rotation) in enumerate(zip(component.views, rotations, strict=True), start=1):
        name = Path(view.image).name
        shutil.copyfile(workspace / view.image, folder / "images" / name)
        K = view.K
        lens = " ".join(f"{value:.9g}" for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
        cameras.append(f"{number} PINHOLE {view.width} {view.height} {lens}\n")
        pose = " ".join(f"{value:.12g}" for value in (*rotation, *view.cam_from_world[:, 3]))
        poses.append(f"{number} {pose} {number} {name}\n0 0 -1\n")
    (folder / "sparse" / "cameras.txt").write_text("".join(cameras))
    (folder / "sparse" / "images.txt").write_text("".join(poses))
    seen = np.stack([*visibility(workspace, component, cloud.points)], axis=1)
    kept = seen.any(axis=1)
    cloud, seen = cloud.take(kept), seen[kept]
    write_ply(folder / "fused.ply", {"vertex": table(_POINT, {
        "x y z": cloud.points, "nx ny nz": cloud.normals, "red green blue": cloud.colours})})
    with open(folder / "fused.ply.vis", "wb") as file:
        file.write(np.uint64(len(cloud)).tobytes())
        for row in seen:
            views = np.flatnonzero(row).astype("<u4")
            file.write(np.uint32(len(views)).tobytes() + views.tobytes())


def visibility(workspace: Path, component: Component, points: np.ndarray) -> Iterator[np.ndarray]:
    """For each photo, which of the points (N,3) its depth map agrees with, (N,) bool."""
    for view in component.views:
        depth, _ = read_depth(workspace, view)
        camera = points @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = ((camera @ view.K.T)[:, :2] / camera[:, 2:]).T
        inside = (camera[:, 2] > 0) & (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
        agrees = np.zeros(len(points), bool)
        at = depth[y[inside].astype(int), x[inside].astype(int)]
        agrees[inside] = np.abs(at - camera[inside, 2]) < AGREES * camera[inside, 2]
        yield agrees


def spent(command: list[str]) -> tuple[float, float]:
    """CPU seconds and peak GiB of a program. Raises CalledProcessError."""
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        if code := os.waitstatus_to_exitcode(status):
            log.seek(0)
            print(log.read()[-2000:], file=sys.stderr)
            raise subprocess.CalledProcessError(code, command)
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 2**20


def faces_of(path: Path) -> int:
    """By a PLY's header."""
    with open(path, "rb") as file:
        for line in file:
            if line.startswith(b"element face"):
                return int(line.split()[2])
    raise ValueError(f"{path} has no faces")


def report(what: str, cpu: float, memory: float, faces: int | None = None) -> None:
    told = "" if faces is None else f", {faces:,} faces"
    print(f"{what}: {cpu:.0f} CPU s, {memory:.2f} GiB{told}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
