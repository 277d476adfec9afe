# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Other programs' results, spoiled."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from .mutations import spoiled_bytes, spoiled_words

_HEAD = ("ply\nformat {} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
         "element face 2\nproperty list uchar int vertex_indices\nend_header\n")
_PLACES = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f4")


def make_results(folder: Path) -> None:
    import laspy

    faces = struct.pack("<B4i", 4, 0, 1, 2, 3) + struct.pack("<B3i", 3, 0, 1, 2)
    (folder / "a.ply").write_bytes(_HEAD.format("binary_little_endian").encode() + _PLACES.tobytes() + faces)
    (folder / "b.ply").write_text(_HEAD.format("ascii") + "0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n3 0 1 2\n")
    (folder / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1/1 2/2 3/3\nf -1 -2 -3\n")
    (folder / "a.xyz").write_text("x;y;z;r;g;b\n1,5;2;3;255;0;0\n4;5;6;0;255;0\n")
    las = laspy.LasData(laspy.LasHeader(version="1.2", point_format=2))
    las.x, las.y, las.z = _PLACES.T.astype(float)
    for suffix in ("las", "laz"):
        las.write(str(folder / f"a.{suffix}"))
    document = json.dumps({
        "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0, "translation": [1, 2, 3]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}], "buffers": [{"byteLength": 60}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 4},
                      {"bufferView": 1, "componentType": 5123, "type": "SCALAR", "count": 6}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
    }).encode()
    document += b" " * (-len(document) % 4)
    binary = _PLACES.tobytes() + np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()
    size = 28 + len(document) + len(binary)
    (folder / "a.glb").write_bytes(
        struct.pack("<5I", 0x46546C67, 2, size, len(document), 0x4E4F534A) + document
        + struct.pack("<2I", len(binary), 0x004E4942) + binary)


def result_cases(*names: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        def of(name: str) -> st.SearchStrategy[tuple[str, bytes]]:
            content = (folder / name).read_bytes()
            return st.tuples(st.just(name), st.one_of(spoiled_bytes(content), spoiled_words(content)))
        return st.one_of(*map(of, names))
    return cases


def result_reader(*names: str) -> Callable[[Path], None]:
    def check(folder: Path) -> None:
        from curecon_blender.core.compare.read import read_result
        from curecon_blender.core.compare.result import CompareError

        for name in names:
            try:
                result = read_result(folder / name)
            except CompareError:
                continue
            assert len(result) and np.isfinite(result.places).all()
            assert result.faces is None or not len(result.faces) or result.faces.max() < len(result)
    return check
