# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds, meshes, arrays and COLMAP models that a stranger made to do harm are refused, each by its name."""

from __future__ import annotations

import io
import pickle
import struct
import zipfile
from pathlib import Path

import pytest
from hostile import HUGE, Harm, refused

from curecon_blender.core.base.errors import SparseError, WorkspaceError
from curecon_blender.core.cloud import edits as cloud_edits
from curecon_blender.core.cloud.ply import point_count, read_cloud
from curecon_blender.core.sparse import models as colmap_model
from curecon_blender.core.surface.mesh import read_mesh
from tests.fuzz import geometry_targets, model_targets


def ply(*lines: str, body: bytes = b"") -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode() + body


XYZ = ("property float x", "property float y", "property float z")


@pytest.mark.parametrize("content", [
    b"", b"ply\n", b"ply\nformat\n", b"ply\n" + b"comment x\n" * 100_000, b"ply\n" + b"x" * 10_000_000,
    ply("element vertex 999999999999", *XYZ), ply("element vertex " + "9" * 5000, *XYZ),
    ply("element vertex -1", *XYZ), ply("element vertex \u00b2", *XYZ), ply("element vertex", *XYZ),
    ply("element vertex x", *XYZ), ply("element", *XYZ),
    ply("element vertex 1", "property", *XYZ), ply("element vertex 1", *XYZ, XYZ[0], body=bytes(16)),
    ply("element vertex 1", *XYZ, "property list uchar int x2", body=bytes(12)), ply("element face 1", *XYZ),
    ply("element vertex 1", *XYZ, body=struct.pack("<3f", 0, float("nan"), 0)),
    ply("element vertex 1", *XYZ, body=struct.pack("<3f", 0, 0, float("inf"))),
    ply("element vertex 1", *[line.replace("float", "double") for line in XYZ], body=struct.pack("<3d", 0, 0, 1e300)),
    ply("element vertex 1", "element vertex 2", *XYZ, body=bytes(24)),
], ids=range(20))
def test_a_cloud_that_promises_or_holds_what_cannot_be(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(content)
    refused(WorkspaceError, path, lambda: read_cloud(path))


def test_a_header_cut_short_has_no_points_to_count(tmp_path: Path) -> None:
    (tmp_path / "cloud.ply").write_bytes(b"ply\nelement vertex\n")
    refused(WorkspaceError, tmp_path / "cloud.ply", lambda: point_count(tmp_path / "cloud.ply"))


@pytest.mark.parametrize(("old", "new"), [
    (b"vertex 4", b"vertex 999999999999"), (b"face 2", b"face 999999999999"), (b"vertex 4", b"vertex " + b"9" * 100),
    (b"texture_0.png", b"../../x.png"), (b"texture_0.png", b"/etc/passwd"), (b"texture_0.png", b"C:\\x.png"),
    (b"texture_0.png", b"\\\\host\\x.png"), (struct.pack("<3f", 1, 0, 0), struct.pack("<3f", 1, float("nan"), 0)),
])
def test_a_mesh_that_promises_or_names_what_it_must_not(tmp_path: Path, old: bytes, new: bytes) -> None:
    geometry_targets.make_mesh(tmp_path)
    path = tmp_path / "mesh.ply"
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    refused(WorkspaceError, path, lambda: read_mesh(path))


# ---- arrays

def npz(**members: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return made.getvalue()


def npy(kind: str, shape: str, content: bytes = b"") -> bytes:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


@pytest.mark.parametrize("bits", [
    npy("|O", "(1,)", pickle.dumps([Harm()])), npy("|u1", "(1099511627776,)"), npy("|u1", "(2,)", b"\0"),
    npy("|u1", "(2, -1)"), npy("<U999999999", "()"), npy("<f8", "(2,)", bytes(16)), b"", b"\x93NUMPY\x01\x00\xff\xff{",
    npy("|u1", "(300000000,)", bytes(300_000_000)),  # 300 kB in the archive
    npy("|u1", "(2,"), npy("|u1", "(" * 5000),  # found by fuzzing: NumPy reads the header as if it were Python
], ids=range(11))
def test_arrays_that_promise_or_hold_something_else(
    tmp_path: Path, bits: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    geometry_targets.make_cloud(tmp_path)
    cloud, path = tmp_path / "cloud.ply", tmp_path / "removed.npz"
    monkeypatch.chdir(tmp_path)
    path.write_bytes(npz(bits=bits, cloud=npy("<U64", "()", cloud_edits.digest(cloud).encode("utf-32-le"))))
    refused(WorkspaceError, path, lambda: cloud_edits.read_edited_cloud(cloud))
    assert not (tmp_path / "harmed").exists()


@pytest.mark.parametrize("damage", ["object", "huge", "cut"])
def test_depth_maps_that_promise_or_hold_something_else(tmp_path: Path, damage: str) -> None:
    from curecon_blender.core.depth.maps import read_depth

    geometry_targets.make_depth(tmp_path)
    view = geometry_targets.some_view()
    path = tmp_path / "depth" / f"{view.name}.npz"
    with zipfile.ZipFile(path) as archive:
        members = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    members["depth"] = {"object": npy("|O", "(4, 5)", pickle.dumps([Harm()])), "huge": npy("<f4", "(99999, 99999)"),
                        "cut": members["depth"][:-1]}[damage]
    path.write_bytes(npz(**members))
    refused(WorkspaceError, path, lambda: read_depth(tmp_path, view))


# ---- COLMAP models

@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    model_targets.make_model(folder)
    return folder


def spoiled(model: Path, tmp_path: Path, name: str, place: int, content: bytes) -> Path:
    """A copy of the binary model with some bytes of a file replaced."""
    folder = tmp_path / "given"
    folder.mkdir()
    for file in (model / "bin").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    data = bytearray((folder / name).read_bytes())
    data[place : place + len(content)] = content
    (folder / name).write_bytes(data)
    return folder


NAN = struct.pack("<d", float("nan"))


@pytest.mark.parametrize(("name", "place", "content"), [
    ("cameras.bin", 0, HUGE), ("images.bin", 0, HUGE), ("points3D.bin", 0, HUGE), ("rigs.bin", 0, HUGE),
    ("frames.bin", 0, HUGE), ("cameras.bin", 12, b"\xff\xff\xff\x7f"), ("cameras.bin", 16, bytes(8)),
    ("cameras.bin", 16, b"\xff" * 8), ("cameras.bin", 32, NAN), ("cameras.bin", 32, bytes(8)),
    ("cameras.bin", 8, b"\x63"), ("points3D.bin", 16, NAN), ("points3D.bin", 59, b"\xff\xff"),
    ("points3D.bin", 63, b"\xff\xff"), ("points3D.bin", 51, HUGE), ("points3D.bin", 8, b"\xfe"),
    ("images.bin", 8, b"\x63"), ("frames.bin", 12, b"\x63"), ("rigs.bin", 12, b"\xff\xff\xff\xff"),
])
def test_a_binary_model_that_promises_or_names_what_is_not_there(
    model: Path, tmp_path: Path, name: str, place: int, content: bytes
) -> None:
    folder = spoiled(model, tmp_path, name, place, content)
    refused(SparseError, folder, lambda: colmap_model.read_model(folder))


@pytest.mark.parametrize(("name", "old", "new"), [
    ("cameras.txt", "SIMPLE_RADIAL", "NONE"), ("cameras.txt", "1024", "-5"), ("cameras.txt", "1280", "nan"),
    ("points3D.txt", "\n1 ", "\n1 nan "), ("images.txt", "\n1 ", "\n99999999999999999999 "),
])
def test_a_text_model_with_what_is_no_number(model: Path, tmp_path: Path, name: str, old: str, new: str) -> None:
    folder = tmp_path / "given"
    folder.mkdir()
    for file in (model / "txt").iterdir():
        (folder / file.name).write_text(file.read_text())
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    refused(SparseError, folder, lambda: colmap_model.read_model(folder))
