# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Fusion of exact depth maps of a ray-cast box: points on the surface, once, with the right colour and normal."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from box_scene import cast, make_view, surface_distance, texture, write_depth, write_scene
from scipy.spatial import cKDTree

from curecon_blender.core.base.errors import Cancelled, CuReconError, WorkspaceError
from curecon_blender.core.base.messages import Progress, Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Component, View
from curecon_blender.core.cloud.fuse import NoPointsError, fuse, peak_bytes, plan
from curecon_blender.core.cloud.ply import Cloud, read_cloud


def run(component: Component, workspace: Path, reporter: Reporter | None = None, **options: float) -> Cloud:
    count = fuse(component, workspace, Options(photos=workspace, workspace=workspace, **options),  # type: ignore
                 reporter or Reporter())
    cloud = read_cloud(workspace / component.cloud)
    assert len(cloud) == count
    return cloud


def ring(count: int, **kwargs: float) -> list[View]:
    return [make_view(index, count, **kwargs) for index in range(count)]


def on_roof(points: np.ndarray) -> np.ndarray:
    return (np.abs(points[:, 2] - 1.5) < 0.005) & (np.abs(points[:, :2]) < 0.98).all(axis=1)


def seen_by(view: View) -> np.ndarray:
    """World points (n,3) of one view's exact depth map."""
    depth, _ = cast(view)
    v, u = np.nonzero(depth)
    rays = np.linalg.inv(view.K) @ np.stack([u + 0.5, v + 0.5, np.ones(len(u))])
    return (rays * depth[v, u] - view.cam_from_world[:, 3:]).T @ view.cam_from_world[:, :3]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> tuple[Component, Path, Cloud]:
    workspace = tmp_path_factory.mktemp("fusion")
    component = write_scene(workspace, ring(8))
    return component, workspace, run(component, workspace)


def test_points_lie_on_the_surface(scene: tuple[Component, Path, Cloud]) -> None:
    distance = surface_distance(scene[2].points)
    assert len(distance) > 20_000
    assert distance.mean() < 0.001  # metres; a pixel is 40 mm wide here
    assert distance.max() < 0.02


def test_every_side_of_the_box_is_there(scene: tuple[Component, Path, Cloud]) -> None:
    points = scene[2].points
    for axis in (0, 1):
        for side in (-1, 1):
            assert ((np.abs(points[:, axis] - side) < 0.005) & (points[:, 2] > 0.05)).sum() > 300
    assert on_roof(points).sum() > 1000


def test_points_have_the_colour_of_their_place(scene: tuple[Component, Path, Cloud]) -> None:
    cloud = scene[2]
    error = np.abs(cloud.colours.astype(int) - texture(cloud.points))
    assert np.median(error) <= 3 and np.percentile(error, 95) < 20


def test_normals_face_out_of_the_surface(scene: tuple[Component, Path, Cloud]) -> None:
    cloud = scene[2]
    points, normals = cloud.points, cloud.normals
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-5)
    inner = (np.abs(points[:, :2]) < 0.85).all(axis=1)
    far = (np.abs(points[:, :2]) > 1.3).any(axis=1)
    assert np.percentile(normals[on_roof(points) & inner, 2], 1) > 0.999
    assert np.percentile(normals[far, 2], 1) > 0.999
    wall = (np.abs(points[:, 0] - 1) < 0.005) & (np.abs(points[:, 1]) < 0.85)
    wall &= (points[:, 2] > 0.2) & (points[:, 2] < 1.3)
    assert wall.sum() > 100
    assert np.percentile(normals[wall, 0], 1) > 0.999


def test_a_point_says_how_many_views_confirm_it_and_how_surely(scene: tuple[Component, Path, Cloud]) -> None:
    cloud = scene[2]
    assert cloud.views.min() == 2 and cloud.views.max() == 8
    roof_seen_by_all = on_roof(cloud.points)
    assert np.median(cloud.views[roof_seen_by_all]) >= 7
    np.testing.assert_allclose(cloud.confidence, 0.9, atol=1e-3)


@pytest.mark.parametrize("known", [2, 4, 15])
def test_no_double_points(tmp_path: Path, known: int) -> None:
    """As dense as one view sees it, not times sixteen, even where views of opposite sides do not know each other."""
    views = [replace(view, overlaps=view.overlaps[:known]) for view in ring(16)]
    points = run(write_scene(tmp_path, views), tmp_path).points
    roof = points[on_roof(points)]
    one_view = [seen[on_roof(seen)] for seen in map(seen_by, views[:4])]
    assert 0.85 < len(roof) / np.mean([len(p) for p in one_view]) < 1.2
    spacing, _ = cKDTree(roof).query(roof, k=2)
    reference, _ = cKDTree(one_view[0]).query(one_view[0], k=2)
    assert np.median(spacing[:, 1]) > 0.9 * np.median(reference[:, 1])
    assert (spacing[:, 1] < 0.4 * np.median(reference[:, 1])).mean() < 0.01


def test_the_finest_photo_writes_the_surface(tmp_path: Path) -> None:
    """Three near views among eight far ones: the roof is as dense as the near ones see it."""
    near = ring(8, radius=4.0, elevation=60.0)[:3]
    far = [replace(view, name=f"far {i}.png", image=f"undistorted/far {i}.png")
           for i, view in enumerate(ring(8, radius=9.0, elevation=60.0))]
    names = tuple(view.name for view in (*near, *far))
    views = [replace(view, overlaps=tuple(n for n in names if n != view.name)) for view in (*far, *near)]
    points = run(write_scene(tmp_path, views), tmp_path).points
    expected = [on_roof(seen_by(view)).sum() for view in near]
    assert 0.9 * min(expected) < on_roof(points).sum() < 1.2 * max(expected)


def test_wrong_depth_in_one_view_is_rejected(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(8))
    wrong = component.views[3]
    depth, _ = cast(wrong)
    write_depth(tmp_path, wrong, np.where(depth > 0, depth * 0.93, 0), np.full(depth.shape, 0.99))
    cloud = run(component, tmp_path)
    assert surface_distance(cloud.points).max() < 0.02
    assert len(cloud) > 15_000


@pytest.mark.parametrize(("confidence", "arc", "found"), [(0.95, 64.0, True), (0.6, 360.0, True),
                                                            (0.6, 64.0, False), (0.95, 16.0, False)])
def test_what_two_photos_alone_see_counts_if_they_are_sure_and_apart(
    tmp_path: Path, confidence: float, arc: float, found: bool
) -> None:
    """45 degrees between neighbours, 8 or 2."""
    component = write_scene(tmp_path, ring(8, arc=arc), confidence=confidence)
    for view in component.views[2:]:
        write_depth(tmp_path, view, *np.zeros((2, view.height, view.width), np.float32))
    if found:
        assert surface_distance(run(component, tmp_path).points).max() < 0.02
    else:
        with pytest.raises(NoPointsError):
            run(component, tmp_path)


def test_depth_that_only_two_views_share_is_rejected(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(8))
    for view in component.views[:2]:  # the same ghost wall, in front of two cameras side by side
        depth, _ = cast(view)
        ghost = seen_plane(view, 0.7)
        write_depth(tmp_path, view, np.where((ghost > 0) & (ghost < depth), ghost, depth), np.full(depth.shape, 0.99))
    # Where the ghost meets the box, it is within the limits (1 %, 1 pixel: 6 cm, 4 cm) of what the other views see.
    assert surface_distance(run(component, tmp_path).points).max() < 0.06
    assert surface_distance(run(component, tmp_path, min_views=2).points).max() > 0.5


def seen_plane(view: View, height: float) -> np.ndarray:
    """z-depth (H,W) of a level patch |x|, |y| < 2 at `height` over the ground, 0 elsewhere."""
    u, v = np.meshgrid(np.arange(view.width) + 0.5, np.arange(view.height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(view.K).T @ view.cam_from_world[:, :3]
    depth = (height - view.centre[2]) / rays[..., 2]
    inside = (np.abs((view.centre + rays * depth[..., None])[..., :2]) < 2).all(axis=-1)
    return np.where((depth > 0) & inside, depth, 0).astype(np.float32)


def test_unsure_pixels_are_left_out(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(6))
    for view in component.views:
        depth, _ = cast(view)
        confidence = np.full(depth.shape, 0.8)
        confidence[:, : view.width // 2] = 0.2
        write_depth(tmp_path, view, depth, confidence)
    strict, loose = run(component, tmp_path), run(component, tmp_path, min_confidence=0.1)
    assert 0 < len(strict) < len(loose)
    with pytest.raises(NoPointsError):
        run(component, tmp_path, min_confidence=0.85)


def test_unsure_views_weigh_less(tmp_path: Path) -> None:
    """Two views 0.5 % off with little confidence hardly move what four sure ones say."""
    component = write_scene(tmp_path, ring(6))
    for view in component.views[:2]:
        depth, _ = cast(view)
        write_depth(tmp_path, view, depth * 1.002, np.full(depth.shape, 0.01))
    assert surface_distance(run(component, tmp_path).points).mean() < 0.0015


def test_nothing_agrees(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(3, arc=30.0))
    run(component, tmp_path)
    before = (tmp_path / "cloud.ply").read_bytes()
    for index, view in enumerate(component.views):
        depth, _ = cast(view)
        write_depth(tmp_path, view, depth * (1 + 0.4 * index), np.full(depth.shape, 0.9))
    with pytest.raises(NoPointsError, match="Too few views agree") as caught:
        run(component, tmp_path)
    assert "overlap" in caught.value.remedy
    assert (tmp_path / "cloud.ply").read_bytes() == before  # the earlier cloud is not lost


def test_three_photos_are_enough_and_two_come_with_a_word(tmp_path: Path) -> None:
    three = write_scene(tmp_path / "three", ring(3, arc=30.0))
    reporter = Reporter()
    assert len(run(three, tmp_path / "three", reporter)) > 3000 and not reporter.warnings
    two = write_scene(tmp_path / "two", ring(2, arc=20.0))
    assert len(run(two, tmp_path / "two", reporter)) > 3000
    assert "Only 2 photos" in reporter.warnings[0]


def test_the_same_cloud_each_time_in_any_order(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(5))
    run(component, tmp_path)
    first = (tmp_path / "cloud.ply").read_bytes()
    run(replace(component, views=component.views[::-1]), tmp_path)
    assert (tmp_path / "cloud.ply").read_bytes() == first


def test_any_memory_budget_gives_the_same_cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one band, in bands of a few rows, and of one row, which is less than a normal's neighbourhood."""
    component = write_scene(tmp_path, ring(5))
    run(component, tmp_path)
    whole = (tmp_path / "cloud.ply").read_bytes()
    for rows in (7, 1):
        monkeypatch.setattr("curecon_blender.core.cloud.fuse.LEAST_BAND", rows * component.views[0].width)
        run(component, tmp_path, memory_gib=1e-3)
        assert (tmp_path / "cloud.ply").read_bytes() == whole


def test_memory_is_that_of_the_budget_not_of_the_photos(tmp_path: Path) -> None:
    def peak(workspace: Path, component: Component, memory_gib: float) -> int:
        tracemalloc.start()
        try:
            run(component, workspace, memory_gib=memory_gib)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    def least_peak(count: int, memory_gib: float) -> int:
        """Of two runs: the interpreter's table of interned names may double within one of them, by 2 MB."""
        workspace = tmp_path / f"{count} {memory_gib}"
        component = write_scene(workspace, ring(count, arc=60.0))
        return min(peak(workspace, component, memory_gib) for _ in range(2))

    few, many, roomy = least_peak(8, 1e-3), least_peak(24, 1e-3), least_peak(24, 1.0)
    assert many < 1.15 * few
    assert roomy > 1.5 * many  # the measure sees what is kept


def test_photos_of_48_megapixels_keep_to_the_budget() -> None:
    photos = [8064 * 6048] * 30
    for gib in (3, 6, 12):
        budget = gib << 30
        assert budget / 3 < peak_bytes(photos, budget) <= budget
        assert plan(photos, budget).band > plan(photos, budget // 2).band or plan(photos, budget).band == photos[0]
    assert peak_bytes(photos, 0) < 2.5 * 2**30  # the least there is


def test_odd_names(tmp_path: Path) -> None:
    names = ["it's \"one\".jpg", "土楼 二.JPG", "three#%&.tif"]
    views = [replace(view, name=name, image=f"undistorted/{name}.png",
                     overlaps=tuple(n for n in names if n != name))
             for view, name in zip(ring(3, arc=30.0), names, strict=True)]
    assert len(run(write_scene(tmp_path, views), tmp_path)) > 3000


def test_progress_moves_within_a_photo_and_cancel_there_keeps_the_earlier_cloud(tmp_path: Path) -> None:
    component = write_scene(tmp_path, ring(4))
    messages: list[object] = []
    run(component, tmp_path, Reporter(messages.append))
    told = [m.done for m in messages if isinstance(m, Progress)]
    assert all(m.total == 100 for m in messages if isinstance(m, Progress))
    assert told[0] == 0 and told[-1] == 100 and told == sorted(told)
    assert sum(25 < done < 50 for done in told) >= 2  # of the second of four photos
    before = sorted((p.name, p.stat().st_size) for p in tmp_path.iterdir())
    for photo in range(4):
        seen: list[int] = []
        asked = 0

        def cancelled(photo: int = photo, seen: list[int] = seen) -> bool:
            """From the second question on after the photo began: between two messages."""
            nonlocal asked
            asked += bool(seen) and seen[-1] >= 25 * photo
            return asked > 2

        reporter = Reporter(lambda m, seen=seen: seen.append(m.done) if isinstance(m, Progress) else None, cancelled)
        with pytest.raises(Cancelled):
            run(component, tmp_path, reporter)
        assert seen[-1] < 25 * photo + 25
        assert sorted((p.name, p.stat().st_size) for p in tmp_path.iterdir()) == before


@pytest.mark.parametrize("damage", ["missing depth", "cut depth", "flipped bytes", "text", "other camera", "other size",
                                    "missing picture", "cut picture", "small picture"])
def test_damaged_files_are_named_with_a_remedy(tmp_path: Path, damage: str) -> None:
    component = write_scene(tmp_path, ring(4))
    view = component.views[2]
    path, picture = tmp_path / "depth" / f"{view.name}.npz", tmp_path / view.image
    content = path.read_bytes()
    depth, _ = cast(view)
    if damage == "missing depth":
        path.unlink()
    elif damage == "cut depth":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "flipped bytes":
        middle = len(content) // 4
        path.write_bytes(content[:middle] + bytes(200) + content[middle + 200 :])
    elif damage == "text":
        path.write_text("not a depth map")
    elif damage == "other camera":
        write_depth(tmp_path, component.views[1], depth, depth)
        path.write_bytes((tmp_path / "depth" / f"{component.views[1].name}.npz").read_bytes())
    elif damage == "other size":
        write_depth(tmp_path, view, depth[:-2], depth[:-2])
    elif damage == "missing picture":
        path = picture
        path.unlink()
    elif damage == "cut picture":
        path = picture
        path.write_bytes(path.read_bytes()[:30])
    else:
        path = picture
        path.write_bytes(png_of_one_pixel())
    with pytest.raises(WorkspaceError) as caught:
        run(component, tmp_path)
    error: CuReconError = caught.value
    assert view.name in error.message and error.path == str(path) and error.remedy
    assert not (tmp_path / "cloud.ply").exists() and not (tmp_path / ".fusion.partial").exists()


def png_of_one_pixel() -> bytes:
    import cv2

    return bytes(cv2.imencode(".png", np.zeros((1, 1, 3), np.uint8))[1])
