# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Another result is laid where it belongs, or it is said that it does not fit; distances are those of the shapes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import curecon
from PIL import Image

from curecon_blender.core.compare import align, distances
from curecon_blender.core.compare.geometry import Similarity, angle_of, turned
from curecon_blender.core.compare.result import CompareError, Result, result_of
from evaluation import registration_scenes as scenes
from evaluation.cloud_metrics import cloud_errors

NEAR = 0.05  # metres


def _off(laid: align.Laid, ours: Result, other: Result, true: Similarity, places: np.ndarray) -> float:
    """How far off places (n,3) of the other come to lie, RMS."""
    got = laid.motion.apply(places - other.offset) + ours.offset
    return float(np.sqrt(((got - true.apply(places)) ** 2).sum(axis=1).mean()))


def _pair(name: str, overlap: float, *, scaled: bool = False) -> tuple[Result, Result, Similarity, np.ndarray]:
    first, second, motion = scenes.pair(name, 1, overlap, scaled=scaled)
    return result_of("ours", second), result_of("theirs", first), motion, first[::100]


@pytest.fixture(scope="module")
def ruin() -> tuple[Result, Result, Similarity, np.ndarray]:
    return _pair("ruin", 0.9)


@pytest.mark.parametrize(("name", "overlap"), [("facade", 0.9), ("ruin", 0.5)])
def test_a_result_is_found_from_any_start(name: str, overlap: float) -> None:
    ours, other, motion, places = _pair(name, overlap)
    laid = align.find(ours, other, scaled=False)
    assert laid.sure, laid.remarks
    assert _off(laid, ours, other, motion, places) < NEAR


def test_a_result_of_unknown_scale_is_found_with_its_scale() -> None:
    ours, other, motion, places = _pair("ruin", 0.9, scaled=True)
    laid = align.find(ours, other, scaled=True)
    assert laid.motion.scale == pytest.approx(motion.scale, rel=2e-3)
    assert _off(laid, ours, other, motion, places) < NEAR * motion.scale and laid.sure


def test_a_ring_that_looks_alike_from_all_sides_is_told() -> None:
    rng = np.random.default_rng(2)
    ours, other = (result_of(name, scenes.ring(rng, plain=True)) for name in ("ours", "theirs"))
    laid = align.find(ours, other, scaled=False)
    assert not laid.sure and "alike from several sides" in laid.remarks[0]


@pytest.mark.parametrize("seed", [103, 114])
def test_half_a_ring_on_its_other_half_is_doubted(seed: int) -> None:
    """They share a tenth of the ring's length, and lie on each other best when one is turned half around."""
    theirs, mine, _ = scenes.pair("ring", seed, 0.1)
    laid = align.find(result_of("ours", mine), result_of("theirs", theirs), scaled=False)
    assert not laid.sure and "alike from several sides" in laid.remarks[0]


def test_colours_tell_the_sides_of_a_ring() -> None:
    rng = np.random.default_rng(2)
    rotation = turned(np.array([0, 0, 1.0]))

    def painted(places: np.ndarray) -> np.ndarray:
        around = np.arctan2(places[:, 1], places[:, 0])
        return np.repeat((128 + 60 * np.sin(around) + 50 * np.sin(2 * around + 1))[:, None], 3, 1).astype(np.uint8)

    first, second = scenes.ring(rng, plain=True), scenes.ring(rng, plain=True)
    other = result_of("theirs", first, colours=painted(first))
    ours = result_of("ours", second @ rotation.T, colours=painted(second))
    laid = align.find(ours, other, scaled=False)
    assert angle_of(laid.motion.rotation.T @ rotation) < 4  # nothing else holds it


def test_what_is_no_part_of_the_building_did_not_fit_or_is_doubted(ruin: tuple) -> None:
    rng = np.random.default_rng(4)
    noise = result_of("noise", rng.random((20_000, 3)) * 30)
    try:
        laid = align.find(ruin[0], noise, scaled=False)
    except CompareError as error:
        assert "did not fit" in error.message
    else:
        assert not laid.sure


def test_a_mirrored_result_is_named(ruin: tuple) -> None:
    ours, other, _, _ = ruin
    mirrored = result_of("theirs", other.places.astype(float) * [-1, 1, 1])
    with pytest.raises(CompareError, match="mirror image"):
        align.find(ours, mirrored, scaled=False)


def test_a_result_in_feet_is_named(ruin: tuple) -> None:
    ours, other, _, _ = ruin
    with pytest.raises(CompareError, match="in feet"):
        align.find(ours, result_of("theirs", other.about(np.zeros(3)) / 0.3048), scaled=False)


def test_where_little_is_shared_nothing_is_sure_and_nothing_is_made_up() -> None:
    """A tenth is shared: what is found is wrong, or cannot be known to be right; nor is it mirrored or in feet."""
    ours, other, _, _ = _pair("facade", 0.1)
    try:
        laid = align.find(ours, other, scaled=False)
    except CompareError as error:
        assert "did not fit" in error.message
    else:
        assert not laid.sure and laid.remarks


def test_marked_pairs_hold_where_the_surfaces_would_slide() -> None:
    ours, other, motion, places = _pair("facade", 0.1)  # they share a strip of plain wall
    marked = other.about(np.zeros(3))[::40]
    shared = marked[align._thin(ours).tree.query(motion.apply(marked) - ours.offset)[0] < 0.3]
    chosen = shared[[0, len(shared) // 3, len(shared) // 2, -1]]
    laid = align.by_pairs(ours, other, np.hstack([chosen, motion.apply(chosen)]), scaled=False)
    assert _off(laid, ours, other, motion, places) < 2 * NEAR


def test_marked_pairs_lay_a_ring_and_are_told_how_far_off_they_are() -> None:
    ours, other, motion, places = _pair("ring", 0.5)
    marked = other.about(np.zeros(3))[[10, 5000, 9000, 20000]]
    mine = motion.apply(marked)
    mine[1] += 0.1
    laid = align.by_pairs(ours, other, np.hstack([marked, mine]), scaled=False)
    assert laid.sure and _off(laid, ours, other, motion, places) < 2 * NEAR
    assert 0.02 < max(laid.residuals) < 0.2
    mine[1] += 8
    assert any("Pair 2" in remark for remark in align.by_pairs(ours, other, np.hstack([marked, mine]),
                                                              scaled=False).remarks)


@pytest.mark.parametrize(("rows", "word"), [([0, 1], "do not fix"), ([0, 0, 0], "one line")])
def test_pairs_that_fix_nothing_are_refused(rows: list[int], word: str, ruin: tuple) -> None:
    marked = ruin[1].about(np.zeros(3))[rows]
    with pytest.raises(CompareError, match=word):
        align.by_pairs(ruin[0], ruin[1], np.hstack([marked, marked]), scaled=False)


def test_mirrored_pairs_are_named(ruin: tuple) -> None:
    marked = ruin[1].about(np.zeros(3))[[10, 9000, 20000, -10, -9000, -20000]]  # some on walls
    with pytest.raises(CompareError, match="mirror image"):
        align.by_pairs(ruin[0], ruin[1], np.hstack([marked * [-1, 1, 1], ruin[2].apply(marked)]), scaled=False)


def test_coordinates_far_from_the_origin_meet_to_the_millimetre() -> None:
    rng = np.random.default_rng(1)
    scene, far = scenes.ruin(rng), np.array([512_345.0, 2_734_567.0, 100.0])
    laid = align.by_coordinates(result_of("ours", scene + far), result_of("theirs", scene + far + 0.004))
    assert laid.sure and laid.share > 0.99 and laid.rms < 0.01


@pytest.mark.parametrize(("other", "word"), [
    (lambda scene: scene + [500_000, 4_000_000, 0], "do not overlap"),
    (lambda scene: scene * [1e-5, 1e-5, 1] + [117, 25, 100], "degrees"),
    (lambda scene: scene[:1], "only 1 points"), (lambda scene: np.ones((500, 3)), "in one place"),
])
def test_coordinates_that_cannot_meet_say_why(other: object, word: str) -> None:
    scene = scenes.ruin(np.random.default_rng(1), 10)
    with pytest.raises(CompareError, match=word):
        align.by_coordinates(result_of("ours", scene), result_of("theirs", other(scene)))  # type: ignore[operator]


# ---- distances

def test_distances_to_a_mesh_are_exact() -> None:
    vertices = np.array([[0.0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [0.1, 0, 0], [0, 0.1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 5]])
    points = np.array([[5.0, 5, 2], [12, 5, 0], [11, 11, 1], [3, 1, -0.5]])
    assert np.allclose(distances.to_mesh(points, vertices, faces), [2, 2, np.sqrt(3), 0.5])
    spread = distances.sampled(vertices, faces, 0.1)
    assert 9_000 < len(spread) < 11_000 and np.abs(spread[:, 2]).max() == 0


def test_shares_are_those_of_the_evaluation() -> None:
    rng = np.random.default_rng(1)
    a, b = scenes.ruin(rng, 5), scenes.ruin(rng, 5)
    found = distances.shares(distances.to_cloud(a, b), distances.to_cloud(b, a), (0.1, 0.3))
    for one, theirs in zip(found, cloud_errors(a, b, [0.1, 0.3]).scores, strict=True):
        assert (100 * one.precision, 100 * one.completeness) == pytest.approx((theirs.precision, theirs.recall))


def test_signed_distances_and_their_limit_are_those_of_the_formula() -> None:
    rng = np.random.default_rng(1)
    ours = np.column_stack([rng.random((20_000, 2)) * 10, rng.normal(0, 0.01, 20_000)])
    other = np.column_stack([rng.random((10_000, 2)) * 10, rng.normal(0.05, 0.02, 10_000)])
    places = np.array([[5.0, 5, 0], [2, 7, 0], [50, 50, 0]])
    found = distances.signed(ours, other, places=places, normals=np.tile([0, 0, 1.0], (3, 1)), width=1.0, depth=0.5,
                             registration=0.003)
    for row in range(2):
        inside = [cloud[np.hypot(*(cloud[:, :2] - places[row, :2]).T) <= 0.5][:, 2] for cloud in (ours, other)]
        assert found.distance[row] == pytest.approx(inside[1].mean() - inside[0].mean(), abs=1e-9)
        spread = np.sqrt(sum(one.var(ddof=1) / len(one) for one in inside))
        assert found.limit[row] == pytest.approx(1.96 * (spread + 0.003), abs=1e-9)
    assert np.isnan(found.distance[2]) and not found.significant[2] and found.significant[:2].all()


def test_signed_distances_are_those_of_another_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # it writes a log where it is imported
    py4dgeo = pytest.importorskip("py4dgeo")
    rng = np.random.default_rng(1)
    ours, other = scenes.ruin(rng, 10), scenes.ruin(rng, 10) + [0, 0, 0.03]
    places, normals = distances.cores_of(ours, None, 0.5)
    found = distances.signed(ours, other, places=places, normals=normals, width=1.0, depth=2.5, registration=0.01)
    # It cuts the cylinder into pieces: of an odd number, so that no place lies on a cut.
    theirs, told = py4dgeo.M3C2(
        epochs=(py4dgeo.Epoch(ours), py4dgeo.Epoch(other)), corepoints=places, corepoint_normals=normals.copy("C"),
        cyl_radius=0.5, max_distance=2.5, registration_error=0.01).run()
    known = found.known
    assert known.sum() > 3000 and np.abs(found.distance - theirs)[known].max() < 1e-9
    assert np.abs(found.limit - told["lodetection"])[known].max() < 1e-9
    fewer = np.minimum(told["num_samples1"], told["num_samples2"])[~known]
    assert (fewer < 4).all(), "a place with points on both sides has no distance"


def test_what_fell_down_is_found_with_its_place_and_size() -> None:
    rng = np.random.default_rng(1)
    places = scenes.ruin(rng)
    later = scenes.ruin(rng)
    block = (np.abs(later[:, :2] - [24, 23.5]) < [2.1, 1.6]).all(axis=1)  # 4 x 3 x 2.5 m
    ground = scenes._plate(rng, 480, (22, 22, 0), (4, 0, 0), (0, 3, 0))
    later = np.concatenate([later[~block], ground]) + rng.normal(0, 0.01, 3)
    cores, normals = distances.cores_of(places, None, 0.5)
    found = distances.signed(places, later, places=cores, normals=normals, width=1.0, depth=4.0, registration=0.01)
    first = distances.changes(found, 0.2, 0.5)[0]
    assert np.hypot(first.place[0] - 24, first.place[1] - 23.5) < 1 and first.distance < -1
    assert np.allclose(first.size, [4, 3, 2.2], atol=1.1)  # and the ground about it
    assert found.significant[np.abs(cores[:, 0] - 24) > 4].mean() < 0.1


def test_what_lies_where_the_reference_does_not_reach_is_not_judged() -> None:
    rng = np.random.default_rng(1)
    disc = scenes._plate(rng, 4000, (-10, -10, 0), (20, 0, 0), (0, 20, 0))
    disc = disc[np.hypot(*disc[:, :2].T) < 10]
    points = np.array([[0.0, 0, 0.1], [9, 0, 0], [8, 8, 0], [0, 0, 5]])  # the third in its box's corner, the last above
    assert distances.reached(points, disc, 0.2).tolist() == [True, True, False, False]
    wall = np.column_stack([np.zeros(500), rng.random((500, 2))])
    assert distances.reached(np.array([[0.1, 0.5, 0.5], [0.5, 0.5, 0.5]]), wall, 0.2).tolist() == [True, False]


def test_noise_is_that_of_a_flat_wall() -> None:
    rng = np.random.default_rng(1)
    wall = np.column_stack([rng.random((40_000, 2)) * 10, rng.normal(0, 0.03, 40_000)])
    noise, density = distances.noise_and_density(wall, distances.flat_places(wall, 0.5), 0.4)
    assert noise == pytest.approx(0.03, rel=0.05) and density == pytest.approx(400, rel=0.1)


# ---- the command

def _save(path: Path, places: np.ndarray) -> Path:
    np.savetxt(path, places, fmt="%.4f")
    return path


def test_the_command_writes_a_sheet_its_figures_and_clouds(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    ours = _save(tmp_path / "ours.xyz", scenes.ruin(rng, 5))
    other = scenes.ruin(rng, 5)
    good = _save(tmp_path / "good.xyz", other + rng.normal(0, 0.01, other.shape))
    half = _save(tmp_path / "half.xyz", other[other[:, 0] < 15] + [0, 0, 0.15])
    ran = curecon("compare", ours, good, half, "--out", tmp_path / "out", "--thresholds", "0.3", "0.6",
                  "--minutes", "9")
    assert ran.code == 0, ran.said
    record = json.loads((tmp_path / "out" / "compare.json").read_text())
    by_name = {one["name"]: one for one in record["results"]}
    assert by_name["good"]["shares"][1]["completeness"] > 0.95 > 0.75 > by_name["half"]["shares"][1]["completeness"]
    assert by_name["ours"]["minutes"] == 9 and by_name["good"]["laid"]["sure"]
    assert sum(by_name["good"]["histogram"]) > 1000
    with Image.open(tmp_path / "out" / "sheet.png") as sheet:
        assert sheet.size == (3508, 2480)
    assert (tmp_path / "out" / "sheet.pdf").read_bytes().startswith(b"%PDF")
    assert (tmp_path / "out" / "2_half.compared.ply").is_file()


def test_the_command_tells_what_cannot_be_compared(tmp_path: Path) -> None:
    ours = _save(tmp_path / "ours.xyz", scenes.ruin(np.random.default_rng(1), 3))
    ran = curecon("compare", ours, tmp_path / "none.ply", "--out", tmp_path / "out")
    assert ran.code == 16 and "none.ply" in ran.said
    ran = curecon("compare", ours, "--out", tmp_path / "out")
    assert ran.code == 16 and "beside ours" in ran.said
