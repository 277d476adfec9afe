# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every program's file gives the points that it holds, however far from the origin, and a spoiled one says why not."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from curecon_blender.core.base.errors import SetupError
from curecon_blender.core.compare.read import read_result
from curecon_blender.core.compare.result import CompareError

FAR = np.array([512_345.678, 2_734_567.891, 432.109])  # a place in UTM
rng = np.random.default_rng(3)
PLACES = FAR + rng.random((50, 3)) * 20
COLOURS = rng.integers(0, 256, (50, 3), dtype=np.uint8)


def _places(path: Path) -> np.ndarray:
    return read_result(path).about(np.zeros(3))


def _ply(path: Path, kind: str, *, claimed: int | None = None, colour: str = "uchar") -> Path:
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind, "")
    code = {"uchar": "u1", "ushort": "u2", "float": "f4"}[colour]
    rows = np.empty(50, [("x", order + "f8"), ("y", order + "f8"), ("z", order + "f8"),
                         ("red", order + code), ("green", order + code), ("blue", order + code)])
    rows["x"], rows["y"], rows["z"] = PLACES.T
    factor = {"uchar": 1, "ushort": 257, "float": 1 / 255}[colour]
    rows["red"], rows["green"], rows["blue"] = (COLOURS * factor).T
    head = (f"ply\nformat {kind} 1.0\nelement vertex {claimed or 50}\nproperty double x\nproperty double y\n"
            f"property double z\nproperty {colour} red\nproperty {colour} green\nproperty {colour} blue\nend_header\n")
    body = rows.tobytes() if order else "\n".join(" ".join(map(repr, row.tolist())) for row in rows).encode()
    path.write_bytes(head.encode() + body)
    return path


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("colour", ["uchar", "ushort", "float"])
def test_ply_of_any_kind_keeps_millimetres_far_from_the_origin(kind: str, colour: str, tmp_path: Path) -> None:
    result = read_result(_ply(tmp_path / "a.ply", kind, colour=colour))
    assert np.abs(result.about(np.zeros(3)) - PLACES).max() < 1e-4
    assert result.colours is not None and np.array_equal(result.colours, COLOURS)


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("factor", [257, 1])
def test_las_has_its_colours_in_16_bits_or_8(suffix: str, factor: int, tmp_path: Path) -> None:
    header = laspy.LasHeader(version="1.2", point_format=2)
    header.scales, header.offsets = np.full(3, 0.001), np.floor(FAR)
    las = laspy.LasData(header)
    las.x, las.y, las.z = PLACES.T
    las.red, las.green, las.blue = (COLOURS.astype(np.uint16) * factor).T
    las.write(str(tmp_path / f"a.{suffix}"))
    result = read_result(tmp_path / f"a.{suffix}")
    assert np.abs(result.about(np.zeros(3)) - PLACES).max() < 1e-3
    assert result.colours is not None and np.array_equal(result.colours, COLOURS)


def test_las_without_colours_has_none_and_a_short_one_is_refused(tmp_path: Path) -> None:
    las = laspy.LasData(laspy.LasHeader(version="1.2", point_format=2))
    las.x, las.y, las.z = (PLACES - FAR).T
    las.write(str(tmp_path / "a.las"))
    assert read_result(tmp_path / "a.las").colours is None
    content = bytearray((tmp_path / "a.las").read_bytes())
    content[107:111] = struct.pack("<I", 1_000_000_000)
    (tmp_path / "a.las").write_bytes(content)
    with pytest.raises(CompareError, match="1,000,000,000 points"):
        read_result(tmp_path / "a.las")


def test_e57_comes_back_as_it_was_written(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        data = {f"cartesian{axis}": (PLACES - FAR)[:, number] for number, axis in enumerate("XYZ")}
        data |= {f"color{name}": COLOURS[:, number] for number, name in enumerate(("Red", "Green", "Blue"))}
        file.write_scan_raw(data, translation=FAR)
    result = read_result(tmp_path / "a.e57")
    assert np.abs(result.about(np.zeros(3)) - PLACES).max() < 1e-4 and np.array_equal(result.colours, COLOURS)


def test_e57_without_its_library_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pye57", None)
    (tmp_path / "a.e57").write_bytes(b"ASTM-E57")
    with pytest.raises(SetupError, match="pye57"):
        read_result(tmp_path / "a.e57")


@pytest.mark.parametrize(("text", "coloured"), [
    ("1 2 3\n4 5 6\n", False), ("x;y;z;r;g;b\n1,5;2,5;3,5;255;0;0\n4;5;6;0;255;0\n", True),
    ("//X,Y,Z,R,G,B\n1,2,3,10,20,30\n4,5,6,10,20,30\n", True), ("2\n1 2 3 -900 10 20 30\n4 5 6 20 10 20 30\n", True),
    ("1 2 3 0 0 1\n4 5 6 0 1 0\n", False),
])
def test_text_is_read_by_its_columns(text: str, coloured: bool, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text)
    result = read_result(tmp_path / "a.xyz")
    assert len(result) == 2 and abs(result.places[1, 1] - 5) < 1e-6 and (result.colours is not None) == coloured
    assert (result.normals is not None) == ("0 0 1" in text)


def test_obj_and_ply_meshes_are_triangles(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 2 0 0\nv 2 1 0\nv 0 1 0\nv 1 2 0\nf 1/1/1 2/2/1 3//1 4\nf -1 -2 -3\n")
    made = read_result(tmp_path / "a.obj")
    assert made.faces is not None and made.faces.tolist() == [[0, 1, 2], [0, 2, 3], [4, 3, 2]]
    header = ("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
              "element face 2\nproperty list uchar int vertex_indices\nend_header\n")
    (tmp_path / "a.ply").write_text(header + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n")
    made = read_result(tmp_path / "a.ply")
    assert made.faces is not None and made.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 2]]
    body = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4").tobytes()
    mixed = body + struct.pack("<B4i", 4, 0, 1, 2, 3) + struct.pack("<B3i", 3, 0, 1, 2)
    (tmp_path / "b.ply").write_bytes(header.replace("ascii", "binary_little_endian").encode() + mixed)
    assert np.array_equal(read_result(tmp_path / "b.ply").faces, made.faces)


def _glb(path: Path, document: dict, binary: bytes) -> Path:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    path.write_bytes(struct.pack("<3I", 0x46546C67, 2, 28 + len(text) + len(binary))
                     + struct.pack("<2I", len(text), 0x4E4F534A) + text
                     + struct.pack("<2I", len(binary), 0x004E4942) + binary)
    return path


def _triangle() -> tuple[dict, bytes]:
    binary = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0]], "<f4").tobytes() + np.array([0, 1, 2], "<u2").tobytes()
    return {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}],
        "nodes": [{"translation": [10, 0, 0], "children": [1]}, {"scale": [2, 2, 2], "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3},
                      {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 3}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{"byteLength": 42}],
    }, binary


def test_glb_is_placed_by_its_nodes_and_turned_to_z_up(tmp_path: Path) -> None:
    made = read_result(_glb(tmp_path / "a.glb", *_triangle()))
    assert np.allclose(made.about(np.zeros(3)), [[10, 0, 0], [12, 0, 0], [10, 0, 4]]) and made.faces is not None


def test_glb_that_claims_too_much_or_is_packed_is_refused(tmp_path: Path) -> None:
    document, binary = _triangle()
    document["accessors"][0]["count"] = 1_000_000_000
    with pytest.raises(CompareError, match="cut short"):
        read_result(_glb(tmp_path / "a.glb", document, binary))
    document, binary = _triangle()
    document["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    with pytest.raises(CompareError, match="without compression"):
        read_result(_glb(tmp_path / "a.glb", document, binary))
    document, binary = _triangle()
    document["nodes"][1]["children"] = [0]
    with pytest.raises(CompareError, match="nested"):
        read_result(_glb(tmp_path / "a.glb", document, binary))


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
def test_a_billion_claimed_points_are_refused_at_once(kind: str, tmp_path: Path) -> None:
    with pytest.raises(CompareError, match="1,000,000,000"):
        read_result(_ply(tmp_path / "a.ply", kind, claimed=1_000_000_000))
    with pytest.raises(CompareError, match="cut short"):
        read_result(_ply(tmp_path / "a.ply", kind, claimed=100_000_000))


def test_points_that_are_no_numbers_are_left_out_and_told(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("1 2 3\nnan 2 3\n4 5 inf\n7 8 9\n")
    result = read_result(tmp_path / "a.xyz")
    assert len(result) == 2 and "2 points" in result.remarks[0]


@pytest.mark.parametrize(("name", "content", "word"), [
    ("a.ply", b"plywood", "PLY"), ("a.las", b"LASF" + bytes(400), "LAS"), ("a.laz", b"", "cannot be read"),
    ("a.obj", b"# nothing\n", "no vertices"), ("a.obj", b"v 0 0 0\nf 1 2 3\n", "not there"),
    ("a.glb", b"glTF", "cannot"),
    ("a.xyz", b"hello\n", "three numbers"), ("a.xyz", b"nan nan nan\n", "finite"), ("a.stl", b"", "kind"),
    ("a.e57", b"ASTM-E57" + bytes(100), "E57"),
])
def test_what_is_no_result_is_refused_by_name(name: str, content: bytes, word: str, tmp_path: Path) -> None:
    if name.endswith("e57"):
        pytest.importorskip("pye57")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CompareError, match=word) as caught:
        read_result(tmp_path / name)
    assert name in caught.value.message and caught.value.remedy


def test_a_dense_workspace_of_another_program_is_found(tmp_path: Path) -> None:
    (tmp_path / "dense" / "0").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    _ply(tmp_path / "dense" / "0" / "fused.ply", "binary_little_endian")
    assert len(read_result(tmp_path)) == 50
    with pytest.raises(CompareError, match="holds no result"):
        read_result(tmp_path / "empty")
