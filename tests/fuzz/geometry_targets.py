# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds, meshes, depth maps and the other arrays of a workspace, spoiled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from .mutations import archives, spoiled_bytes, spoiled_words
from .target import PHOTO


def make_cloud(folder: Path) -> None:
    from curecon_blender.core.cloud.edits import write_removed
    from curecon_blender.core.cloud.ply import Cloud, CloudWriter

    rng = np.random.default_rng(1)
    count = 9
    with CloudWriter(folder / "cloud.ply") as writer:
        writer.write(Cloud(
            points=rng.random((count, 3), np.float32), colours=rng.integers(0, 255, (count, 3), np.uint8),
            normals=rng.random((count, 3), np.float32), confidence=rng.random(count, np.float32),
            views=np.full(count, 3, np.uint8),
        ))
    write_removed(folder / "cloud.ply", np.arange(count) % 2 == 0)


def _header_of(content: bytes) -> int:
    return content.index(b"end_header\n") + len(b"end_header\n")


def ply_cases(name: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        content = (folder / name).read_bytes()
        return st.tuples(st.just(name), st.one_of(
            spoiled_words(content, header=_header_of(content)), spoiled_bytes(content), st.binary(max_size=100),
        ))
    return cases


def check_cloud(folder: Path) -> None:
    from curecon_blender.core.cloud.ply import point_count, read_cloud

    cloud = read_cloud(folder / "cloud.ply")
    assert np.isfinite(cloud.points).all() and np.isfinite(cloud.confidence).all()
    assert point_count(folder / "cloud.ply") == len(cloud)


def make_mesh(folder: Path) -> None:
    from curecon_blender.core.surface.mesh import Mesh, write_mesh

    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    write_mesh(folder / "mesh.ply", Mesh(
        vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32), colours=np.zeros((4, 3), np.uint8),
        distance=np.zeros(4, np.float32), views=np.ones(4, np.uint8), filled=np.array([False, True]),
    ).with_texture(np.zeros((2, 3, 2), np.float32), np.zeros(2, np.int32), ("texture_0.png",)))


def check_mesh(folder: Path) -> None:
    from curecon_blender.core.surface.mesh import filled_share, read_mesh

    mesh = read_mesh(folder / "mesh.ply")
    assert np.isfinite(filled_share([mesh]))
    assert all((folder / page).resolve().parent == folder.resolve() for page in mesh.pages)


def removed_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    from curecon_blender.core.cloud.edits import digest

    named = digest(folder / "cloud.ply").encode("utf-32-le")
    seed = {"bits": ("|u1", (2,), b"\xaa\x80"), "cloud": ("<U64", (), named)}
    return st.tuples(st.just("removed.npz"), st.one_of(
        spoiled_bytes((folder / "removed.npz").read_bytes()), archives(seed),
    ))


def check_removed(folder: Path) -> None:
    from curecon_blender.core.cloud.edits import edits_key, is_stale, read_edited_cloud

    read_edited_cloud(folder / "cloud.ply")
    is_stale(folder / "cloud.ply")
    edits_key(folder / "cloud.ply")


def some_view() -> Any:
    from curecon_blender.core.base.records import View

    pose = np.array([[1.0, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, 2]])
    return View(
        name=PHOTO, image=f"undistorted/{PHOTO}.jpg", width=5, height=4, near=1.0, far=9.0, cam_from_world=pose,
        K=np.array([[6.0, 0, 2.5], [0, 6, 2], [0, 0, 1]]), sources=(("2.jpg", 1.5),), overlaps=("2.jpg",),
        original="/photos/1.jpg",
    )


def make_depth(folder: Path) -> None:
    view = some_view()
    (folder / "depth").mkdir()
    np.savez(folder / "depth" / f"{PHOTO}.npz", depth=np.ones((4, 5), np.float32), key=np.array("k"), K=view.K,
             confidence=np.ones((4, 5), np.float16), cam_from_world=view.cam_from_world)


def depth_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    view, name = some_view(), f"depth/{PHOTO}.npz"
    seed = {
        "depth": ("<f4", (4, 5), np.ones((4, 5), "<f4").tobytes()), "K": ("<f8", (3, 3), view.K.tobytes()),
        "confidence": ("<f2", (4, 5), np.ones((4, 5), "<f2").tobytes()), "key": ("<U1", (), "k".encode("utf-32-le")),
        "cam_from_world": ("<f8", (3, 4), view.cam_from_world.tobytes()),
    }
    return st.tuples(st.just(name), st.one_of(spoiled_bytes((folder / name).read_bytes()), archives(seed)))


def check_depth(folder: Path) -> None:
    from curecon_blender.core.depth.maps import is_finished, read_depth

    view = some_view()
    is_finished(folder, view, "k")
    depth, confidence = read_depth(folder, view)
    assert depth.shape == confidence.shape == (4, 5)


def _told() -> Any:
    return replace(some_view(), points=2)


def make_points(folder: Path) -> None:
    from curecon_blender.core.views import sparse_points

    sparse_points.write(folder, PHOTO, np.ones((2, 4), np.float32))


def points_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    name = f"undistorted/{PHOTO}.points.npz"
    seed = {"points": ("<f4", (2, 4), np.ones((2, 4), "<f4").tobytes())}
    return st.tuples(st.just(name), st.one_of(spoiled_bytes((folder / name).read_bytes()), archives(seed)))


def check_points(folder: Path) -> None:
    from curecon_blender.core.network import refinement
    from curecon_blender.core.views import sparse_points

    found = sparse_points.read(folder, _told())
    assert found.shape == (2, 4)
    assert np.isfinite(refinement.rasterise_points(found, 1.0, 9.0, (32, 32))).all()


_PRECISION = {"places": (2, 3), "points": (2, 3, 3), "shapes": (2, 3, 3), "own": (2, 3, 3), "centres": (1, 3, 3),
              "turns": (1, 3), "lenses": (1, 9), "datum": (7, 7), "middle": (3,)}


def make_precision(folder: Path) -> None:
    from curecon_blender.core.adjust.precision_record import Precision, write_precision

    write_precision(folder, Precision(
        **{name: np.ones(shape) for name, shape in _PRECISION.items()}, rays=np.array([2, 3]), sigma=0.5, held=True,
    ))


def precision_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    seed = {name: ("<f8" if name == "datum" else "<f4", shape,
                   np.ones(shape, "<f8" if name == "datum" else "<f4").tobytes())
            for name, shape in _PRECISION.items()}
    seed |= {"rays": ("<i4", (2,), np.array([2, 3], "<i4").tobytes()), "sigma": ("<f8", (), np.ones(1).tobytes()),
             "held": ("<i8", (), np.ones(1, "<i8").tobytes()), "counts": ("<i8", (3,), np.array([2, 1, 1]).tobytes())}
    return st.tuples(st.just("precision.npz"), st.one_of(
        spoiled_bytes((folder / "precision.npz").read_bytes()), archives(seed),
    ))


def check_precision(folder: Path) -> None:
    from curecon_blender.core.adjust.precision_record import read_precision
    from curecon_blender.core.cloud.precision import SparsePrecision

    if (found := read_precision(folder)) is not None:
        assert np.isfinite(found.datum_sigmas).all()
        sigmas = SparsePrecision(folder, (some_view(),)).sigmas(np.zeros((1, 3)), np.ones(1), np.ones(1))
        assert np.isfinite(sigmas).all()


def make_patches(folder: Path) -> None:
    from curecon_blender.core.plan.coverage import ENOUGH, Parts, Seen
    from curecon_blender.core.plan.patches import Judged, Patches, write_patches

    rng = np.random.default_rng(1)
    parts = Parts(rng.random((9, 3)), rng.random((9, 3)))
    patches = Patches(parts, rng.random(9), np.zeros(9, np.uint8))
    seen = Seen(np.full(9, 2), rng.random(9), rng.random(9))
    judged = Judged(patches, seen, np.zeros((9, ENOUGH, 3)), np.ones(9, np.uint8), 9.0)
    write_patches(folder / "gaps.ply", judged, parts)


def check_patches(folder: Path) -> None:
    from curecon_blender.core.plan.patches import read_patches

    kept = read_patches(folder / "gaps.ply")
    assert np.isfinite(kept.parts.places).all() and np.isfinite(kept.areas).all()
