# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes in files of other programs, mesh topology, graphs, and which pixels a triangle covers."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from curecon_blender.core.base.graphs import connected_components, spanning_tree
from curecon_blender.core.base.ply import column, read_ply
from curecon_blender.core.surface.triangles import face_neighbours, mesh_edges
from curecon_blender.core.texture.rasterise import inverse_depth_buffer, scan_convert

FAN = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 4]])  # 1-2 and 0-2 are inner edges


def ply_with_faces(path: Path, *faces: tuple[int, ...]) -> Path:
    """Five vertices with a property that no program of ours knows, and faces as others name them."""
    header = ["ply", "format binary_little_endian 1.0", "comment made elsewhere", "element vertex 5",
              "property double x", "property double y", "property double z", "property short quality",
              f"element face {len(faces)}", "property list uchar int vertex_index", "element edge 1",
              "property int vertex1", "end_header", ""]
    body = b"".join(struct.pack("<3dh", i, 2 * i, 3 * i, -i) for i in range(5))
    body += b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    path.write_bytes("\n".join(header).encode() + body + struct.pack("<i", 7))
    return path


def test_a_mesh_by_another_program_is_read(tmp_path: Path) -> None:
    path = ply_with_faces(tmp_path / "theirs.ply", *map(tuple, FAN.tolist()))
    header, rows = read_ply(path, ["vertex", "face"], {"vertex_indices": 3})
    assert header.comments == ("made elsewhere",)
    np.testing.assert_array_equal(column(rows["vertex"], "x y z")[4], [4, 8, 12])
    np.testing.assert_array_equal(rows["face"]["vertex_indices"], FAN)


def test_faces_that_are_no_triangles_are_refused(tmp_path: Path) -> None:
    path = ply_with_faces(tmp_path / "quad.ply", (0, 1, 2, 3), (0, 1, 2))
    with pytest.raises(ValueError, match="another length than 3"):
        read_ply(path, ["vertex", "face"], {"vertex_indices": 3})


def test_edges_and_the_faces_across_them() -> None:
    edges, edge = mesh_edges(FAN)
    assert edges.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [1, 4], [2, 3], [2, 4]]
    assert [sorted(map(int, edges[number])) for number in edge[2]] == [[1, 2], [1, 4], [2, 4]]
    assert face_neighbours(FAN).tolist() == [[-1, 2, 1], [0, -1, -1], [0, -1, -1]]


def test_three_faces_at_an_edge_are_joined_in_pairs() -> None:
    neighbours = face_neighbours(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
    assert neighbours[:, 0].tolist() == [1, 0, -1]


def test_components_and_a_tree_that_joins_photos_at_one_place() -> None:
    assert connected_components(np.array([[0, 3], [3, 1]]), 5).tolist() == [0, 0, 1, 0, 2]
    places = np.array([0.0, 0, 0, 10, 10, 11, 30])
    tree = spanning_tree(np.abs(places[:, None] - places))
    assert len(tree) == 6 and connected_components(tree, 7).max() == 0
    assert sorted(np.abs(np.diff(places[tree], axis=1)).ravel()) == [0, 0, 0, 1, 10, 19]


def test_triangles_side_by_side_share_no_pixel_and_leave_none_out() -> None:
    random = np.random.default_rng(0)
    outline = np.array([[0.0, 0], [20, 0], [20, 16], [0, 16]])
    for _ in range(20):
        middle = random.uniform(2, 14, 2).round(1)
        corners = np.stack([[a, b, middle] for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True)])
        found = list(scan_convert(corners, 20, 16, block=50))
        pixels = np.concatenate([pixel for _, pixel, _ in found])
        assert len(found) > 1 and np.array_equal(np.sort(pixels), np.arange(20 * 16))
        for face, pixel, weights in found:
            centres = np.stack([pixel % 20, pixel // 20], axis=1) + 0.5
            np.testing.assert_allclose(np.einsum("nk,nkc->nc", weights, corners[face]), centres, atol=1e-4)


def test_the_nearest_triangle_is_in_the_depth_buffer_and_one_behind_the_camera_is_not() -> None:
    square = np.array([[0.0, 0], [8, 0], [0, 8]])
    corners = np.stack([square, square, np.where(square == 8, np.nan, square)])
    buffer = inverse_depth_buffer(corners, np.array([[0.1] * 3, [0.5, 0.25, 0.25], [9.0] * 3]), 10, 10)
    assert buffer[0, 0] == pytest.approx(0.5, abs=0.04) and buffer[0, 6] == pytest.approx(0.28, abs=0.03)
    assert buffer[9].max() == 0 and buffer.max() < 0.51
