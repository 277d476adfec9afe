# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Screened Poisson reconstruction by pycolmap and quadric edge collapse, each in a process of its own."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..base.allocator import release
from ..base.files import disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.ply import column, read_ply, row_type, table, write_ply
from ..cloud.ply import Cloud, CloudWriter, joined
from .mesh import MeshError
from .triangles import triangle_areas

_DEPTHS = (6, 12)  # of the octree; its memory grows with the points, not with the depth
_SURPLUS = 4.5  # faces made for each one that stays: more cost time and memory, and show no more
_FACES_A_POINT = 3  # that come of leaves as wide as the points' spacing
_CUBE = 1.1  # Poisson's cube is this much larger than the cloud
_LEAST_FREE = 1 << 20  # bytes: a disk with less is full
_VERTEX = row_type([("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
_FACE = row_type([("vertex_indices", "<i4", 3)])
_EDGE = 0.06  # of faces that are collapsed: the collapse's thresholds are lengths
_EAGERNESS = (5, 8, 12, 16)  # how fast they grow: slowly is nearer to the surface, and may not come to the count
# The process goes with the worker, even if that is killed; where the system cannot arrange it, it ends when it is done.
_CHILD = """
import ctypes, json, sys
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, 9)
"""
_POISSON = _CHILD + """
import pycolmap
source, target, settings = sys.argv[1:]
options = pycolmap.PoissonMeshingOptions()
for name, value in json.loads(settings).items():
    setattr(options, name, value)
pycolmap.poisson_meshing(source, target, options)
"""
_COLLAPSE = _CHILD + """
import fast_simplification
import numpy as np
source, target, settings = sys.argv[1:]
count, eagerness = json.loads(settings)
with np.load(source) as file:
    vertices, faces = file["vertices"], file["faces"]
for eager in eagerness:
    if len(faces) > count:
        vertices, faces = fast_simplification.simplify(vertices, faces, target_count=count, agg=eager)
np.savez(target, vertices=vertices, faces=faces)
"""


def poisson(
    cloud: Cloud, spacing: float, count: int, scratch: Path, reporter: Reporter
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,3) float32 and faces (m,3) int32 of the untrimmed Poisson surface, from an octree whose leaves are
    `spacing` wide, or wider where more than _SURPLUS times the `count` of faces that may stay would come of them.
    Raises MeshError, and WorkspaceError for a full disk."""
    leaf = spacing * max(1.0, np.sqrt(_FACES_A_POINT * len(cloud) / (_SURPLUS * count)))
    cloud, depth = _as_wide_as_leaves_ask(cloud, leaf)
    source, target = scratch / "poisson_points.ply", scratch / "poisson_surface.ply"
    with _exchange(source, target, "No surface could be made of the cloud",
                   "See that the disk is not full; reconstruct again if the cloud looks wrong."):
        with CloudWriter(source) as writer:
            writer.write(cloud)
        _run(_POISSON, source, target, {"depth": depth, "trim": 0, "color": False}, reporter)
        return read_triangles(target)


def simplify(
    vertices: np.ndarray, faces: np.ndarray, count: int, scratch: Path, reporter: Reporter
) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` faces, by quadric edge collapse; more only where each part is as small as it can be. Raises
    MeshError, and WorkspaceError for a full disk."""
    source, target = scratch / "fine.npz", scratch / "coarse.npz"
    with _exchange(source, target, "The surface could not be simplified",
                   "See that the disk is not full, or give a larger face target."):
        middle = vertices.mean(axis=0, dtype=np.float64)
        edge = float(np.sqrt(triangle_areas(vertices[faces]).mean(dtype=np.float64))) or 1.0
        np.savez(source, vertices=(vertices - middle) * (_EDGE / edge), faces=faces)
        _run(_COLLAPSE, source, target, [count, _EAGERNESS], reporter)
        with np.load(target) as found:
            return (found["vertices"] * (edge / _EDGE) + middle).astype(np.float32), found["faces"].astype(np.int32)


def _as_wide_as_leaves_ask(cloud: Cloud, leaf: float) -> tuple[Cloud, int]:
    """The cloud, and a depth of the octree at which its leaves are so wide: Poisson halves the cloud's own width, so
    that leaves could be twice as wide as asked for. One point far beside the cloud makes it wider; what comes of it is
    cut away, as nothing measured lies near."""
    extent = _CUBE * np.ptp(cloud.points, axis=0)
    axis = int(extent.argmax())
    depth = int(np.clip(np.ceil(np.log2(extent[axis] / leaf)), *_DEPTHS))
    beside = cloud.take(cloud.points[:, axis].argmin(keepdims=True))
    away = np.zeros(3, np.float32)
    away[axis] = max(leaf * 2**depth - extent[axis], 0) / _CUBE
    return joined(cloud, replace(beside, points=beside.points - away)), depth


@contextmanager
def _exchange(source: Path, target: Path, failure: str, remedy: str) -> Iterator[None]:
    """For a block that writes `source` and has another process make `target` of it: both are deleted in the end. Raises
    MeshError for what goes wrong, and WorkspaceError for a full disk."""
    folder = source.parent
    try:
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            try:
                yield
            except (FileNotFoundError, RuntimeError, ValueError) as error:
                # A native library that meets a full disk may say nothing and leave half a file.
                if shutil.disk_usage(folder).free < _LEAST_FREE:
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
                raise
    except (FileNotFoundError, RuntimeError, ValueError) as error:
        raise MeshError(Text("{}: {}", Text(failure), Text(str(error))), remedy=remedy, path=source) from error
    finally:
        source.unlink(missing_ok=True)
        target.unlink(missing_ok=True)


def _run(program: str, source: Path, target: Path, settings: object, reporter: Reporter) -> None:
    """Run a program on `source`, which makes `target`, in a process of its own: the libraries hold Python's lock for as
    long as they work, and nobody could cancel. Raises RuntimeError with its last words when it fails."""
    command = [sys.executable, "-c", program, str(source), str(target), json.dumps(settings)]
    words = source.with_suffix(".log")
    release()  # that process will need it
    # Threads that wait must not spin: beside other work they would take the cores from those that have something to do.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OMP_WAIT_POLICY": "passive"}
    try:
        with words.open("wb") as log, subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment,
        ) as process:
            try:
                while process.poll() is None:
                    reporter.check_cancelled()
                    time.sleep(0.05)
            finally:
                process.kill()
        if process.returncode:
            said = words.read_text("utf-8", "replace").strip().splitlines()
            raise RuntimeError(said[-1] if said else f"it ended with {process.returncode}")
    finally:
        words.unlink(missing_ok=True)


def write_triangles(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    """A binary PLY of vertices (n,3) and faces (m,3)."""
    write_ply(path, {"vertex": table(_VERTEX, {"x y z": vertices}), "face": table(_FACE, {"vertex_indices": faces})})


def read_triangles(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n,3) float32 and faces (m,3) int32 of a PLY of triangles. Raises ValueError where it is cut short."""
    rows = read_ply(path, ["vertex", "face"], {"vertex_indices": 3})[1]
    return column(rows["vertex"], "x y z").astype(np.float32), rows["face"]["vertex_indices"].copy()
