# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network's geometry and arithmetic, and the shipped weights on a ray-cast scene that they have never seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from box_scene import cast, make_view, write_scene

from curecon_blender.core.base.errors import DeviceError
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import View
from curecon_blender.core.depth.estimate import DepthEstimator, by_neighbours, within_reach
from curecon_blender.core.depth.tiles import (
    BASE_BYTES,
    BYTES_PER_SOURCE_PIXEL,
    Tile,
    bytes_per_pixel,
    plan_tiles,
    visible_region,
)
from curecon_blender.core.network import layers
from curecon_blender.core.network.config import PAPER
from curecon_blender.core.network.cost_volume_cpu import CostVolumeInput, fused_cost_volume
from curecon_blender.core.network.homographies import homography_terms, pixel_grid
from curecon_blender.core.network.model import (
    LCMMVSNet,
    decode_linear,
    decode_unified,
    depth_from_t,
    plain_cost_volume,
    t_from_depth,
    warp,
)
from curecon_blender.core.network.weights import describe, load_network, save_network
from curecon_blender.core.views.scores import depth_range, matching_score, nearest_supported
from training.losses import linear_label, unified_label


def tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32)).unsqueeze(0)


def test_a_source_warped_at_the_true_depth_is_the_reference() -> None:
    reference, source = make_view(0, 24), make_view(1, 24)
    depth, picture = cast(reference)
    _, other = cast(source)
    poses = tensor(np.stack([reference.cam_from_world, source.cam_from_world]))
    pixels = pixel_grid(torch.arange(depth.shape[1]) + 0.5, torch.arange(depth.shape[0]) + 0.5)

    def difference(shift_u: float, shift_v: float) -> float:
        """Median difference in grey levels, with the source's principal point moved by so many pixels."""
        K = source.K + np.array([[0, 0, shift_u], [0, 0, shift_v], [0, 0, 0]])
        with torch.autocast("cpu", torch.bfloat16):  # of the convolutions alone
            terms = homography_terms(tensor(np.stack([reference.K, K])), poses, 1, pixels)
            warped, _ = warp(tensor(other.transpose(2, 0, 1)), *terms, tensor(1 / np.maximum(depth, 1e-3)[None]),
                             tensor(np.array(depth.shape[::-1])))
        return float(np.median(np.abs(warped[0, :, 0].numpy().transpose(1, 2, 0) - picture)[depth > 0]))

    exact = difference(0, 0)
    assert exact < 4  # of 255: what interpolation costs
    for shift in ((0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)):
        assert difference(*shift) > 2 * exact


def test_label_and_decoder_agree_to_the_last_digit() -> None:
    first, interval, count = torch.tensor(0.2).view(1, 1, 1, 1).expand(1, 1, 1, 200), 0.01, 16
    t = torch.linspace(0.2001, 0.3599, 200).view(1, 1, 1, 200)
    label = unified_label(t, first, interval, count)
    decoded, share = decode_unified(torch.logit(label.clamp(1e-6, 1 - 1e-6)), first, interval)
    torch.testing.assert_close(decoded, t, atol=1e-5, rtol=0)
    assert (share[label.max(1, keepdim=True).values > 0.05] > 0.99).all()  # small labels are no less sure

    inner = (t > 0.2 + interval / 2) & (t < 0.2 + (count - 0.5) * interval)
    label = linear_label(t, first, interval, count)
    torch.testing.assert_close(label.sum(1, keepdim=True), torch.ones_like(t))
    decoded, share = decode_linear(torch.log(label.clamp_min(1e-9)), first, interval)
    torch.testing.assert_close(decoded[inner], t[inner], atol=1e-5, rtol=0)
    assert (share > 0.99).all()


@pytest.mark.parametrize("spread", [0.5, 1.0])
def test_a_network_that_is_unsure_is_not_pulled_to_one_side(spread: float) -> None:
    """Depths are uncertain by `spread` hypotheses about the truth; the decoder gets the labels' expectation."""
    first, interval, count = torch.zeros(1, 1, 1, 400), 1.0, 16
    true = torch.linspace(6, 10, 400).view(1, 1, 1, 400)
    offsets = torch.linspace(-3, 3, 121)
    weights = torch.exp(-0.5 * (offsets / spread) ** 2)
    labels = sum(w * linear_label(true + o * interval, first, interval, count)
                 for o, w in zip(offsets, weights, strict=True)) / weights.sum()
    decoded, _ = decode_linear(torch.log(labels.clamp_min(1e-9)), first, interval)
    assert abs((decoded - true).mean().item()) < 0.02
    assert (decoded - true).abs().max().item() < 0.25


def test_hypotheses_are_a_pixel_apart_whatever_the_photo_size() -> None:
    network = LCMMVSNet()
    views = [make_view(i, 24) for i in (0, 1, 2)]
    near, far = torch.tensor([1.0]), torch.tensor([15.0])
    counts = []
    for scale in (1.0, 2.0, 3.0):
        K = tensor(np.stack([np.diag([scale, scale, 1]) @ v.K for v in views]))
        poses = tensor(np.stack([v.cam_from_world for v in views]))
        size = (round(views[0].width * scale), round(views[0].height * scale))
        counts.append(network.coarse_hypotheses(K, poses, near, far, size))
    assert all(c % 8 == 0 for c in counts)
    assert counts[1] == pytest.approx(2 * counts[0], abs=8) and counts[2] == pytest.approx(3 * counts[0], abs=16)
    assert LCMMVSNet(PAPER).coarse_hypotheses(K, poses, near, far, size) == 48


def test_sweep_coordinate_and_depth_are_inverse_and_rise_together() -> None:
    near, far = torch.tensor([2.0]), torch.tensor([50.0])
    depth = torch.linspace(2, 50, 30).view(1, 1, 1, 30)
    t = t_from_depth(depth, near, far)
    assert (t.diff() > 0).all() and t[..., 0].item() == pytest.approx(0) and t[..., -1].item() == pytest.approx(1)
    torch.testing.assert_close(depth_from_t(t, near, far), depth)


def test_a_view_with_no_matching_score_has_no_say() -> None:
    torch.manual_seed(0)
    network = LCMMVSNet().eval()
    views = [make_view(i, 24) for i in (0, 1, 2)]
    K, poses = (tensor(np.stack([getattr(v, n) for v in views])) for n in ("K", "cam_from_world"))
    near, far = torch.tensor([3.0]), torch.tensor([15.0])
    images = torch.rand(1, 3, 3, 96, 160)
    other = images.clone()
    other[:, 2] = torch.rand(3, 96, 160)
    with torch.no_grad():
        mute = [network(x, K, poses, near, far, torch.tensor([[3.0, 0.0]]))[-1].t for x in (images, other)]
        heard = [network(x, K, poses, near, far, torch.tensor([[3.0, 1.0]]))[-1].t for x in (images, other)]
    torch.testing.assert_close(*mute)
    assert not torch.equal(*heard)


def test_slices_of_the_cost_volume_change_nothing() -> None:
    torch.manual_seed(0)
    network = LCMMVSNet().eval()
    views = [make_view(i, 24) for i in (0, 1, 2)]
    K, poses = (tensor(np.stack([getattr(v, n) for v in views])) for n in ("K", "cam_from_world"))
    arguments = (torch.rand(1, 3, 3, 96, 160), K, poses, torch.tensor([3.0]), torch.tensor([15.0]), torch.ones(1, 2))
    whole = network(*arguments)[-1].t.detach()
    with torch.no_grad():
        sliced = network(*arguments)[-1].t
    torch.testing.assert_close(whole, sliced, atol=1e-4, rtol=1e-4)


def test_folding_batch_normalisation_changes_nothing() -> None:
    network = load_network()
    views = [make_view(i, 24) for i in (0, 1, 2)]
    K, poses = (tensor(np.stack([getattr(v, n) for v in views])) for n in ("K", "cam_from_world"))
    pictures = tensor(np.stack([cast(v)[1] for v in views])).permute(0, 1, 4, 2, 3) / 255
    arguments = (pictures[..., :96, :160], K, poses, torch.tensor([3.0]), torch.tensor([15.0]), torch.ones(1, 2))
    with torch.no_grad():
        plain = network(*arguments)[-1].t
        folded = network.fold_batch_norm()(*arguments)[-1].t
    assert ((plain - folded).abs() < 1e-3).float().mean() > 0.99


@pytest.mark.parametrize(("angle", "score"), [(5, 1.0), (4, np.exp(-0.5)), (15, np.exp(-0.5)), (0.001, np.exp(-12.5))])
def test_matching_score_of_one_point_by_hand(angle: float, score: float) -> None:
    half = np.radians(angle) / 2
    centres = [np.array([s * np.sin(half), 0, np.cos(half)]) * 10 for s in (-1, 1)]
    assert matching_score(*centres, np.zeros((1, 3))) == pytest.approx(score, rel=0.02)
    assert matching_score(*centres, np.zeros((7, 3))) == pytest.approx(7 * score, rel=0.02)


def test_depth_range_holds_the_points_and_shrugs_off_a_stray_one() -> None:
    depths = np.concatenate([np.linspace(10, 20, 999), [5000.0]])
    near, far = depth_range(depths)
    assert near < 10 and 20 < far < 40
    assert (near, far) == pytest.approx(depth_range(depths[:-1]), rel=0.01)


def test_a_foreground_that_several_points_share_is_swept_and_one_stray_point_is_not() -> None:
    rng = np.random.default_rng(0)
    depths = np.linspace(30, 60, 2000)
    facade = np.column_stack([rng.uniform(0, 800, 2000), rng.uniform(0, 400, 2000), depths, np.ones(2000)])
    stray = np.array([[400.0, 500.0, 8.0, 1.0]])
    yard = np.column_stack([rng.uniform(300, 340, 10), rng.uniform(560, 600, 10), np.full(10, 15.0), np.zeros(10)])
    plain = depth_range(depths)
    assert depth_range(depths, nearest_supported(np.concatenate([facade, stray]), 800)) == plain
    near, far = depth_range(depths, nearest_supported(np.concatenate([facade, stray, yard]), 800))
    assert 13 < near < 15 and far == plain[1]
    assert nearest_supported(np.zeros((0, 4)), 800) == np.inf
    nearer, _ = depth_range(depths, 0.01)  # a sweep never becomes many times as long
    assert nearer > 9


def test_depth_range_reaches_ground_beyond_the_farthest_point() -> None:
    near, far = depth_range(np.linspace(30, 150, 500))
    assert far > 600 and (1 / near - 1 / far) < 1.5 * (1 / 30 - 1 / 150)  # cheap in inverse depth


def test_the_shipped_weights_find_the_depth_of_a_scene(tmp_path: Path) -> None:
    views = [make_view(i, 30) for i in range(5)]
    component = write_scene(tmp_path, views)
    reference = component.views[2]
    others = {v.name: v for v in component.views}
    options = Options(photos=tmp_path, workspace=tmp_path, device="cpu", precision="fp32")
    depth, confidence = DepthEstimator(load_network(), tmp_path, options).estimate(
        reference, [(others[n], s) for n, s in reference.sources]
    )
    truth, _ = cast(reference)
    seen = truth > 0
    error = np.abs(depth - truth)[seen] / truth[seen]
    assert np.median(error) < 0.02
    sure = confidence[seen] > np.median(confidence[seen])
    assert error[sure].mean() < error[~sure].mean()  # confidence means something


def test_weights_come_back_as_they_were_saved(tmp_path: Path) -> None:
    network, path = load_network(), tmp_path / "weights.safetensors"
    torch.nn.init.normal_(network.refinement.leave.weight)
    save_network(network, path, {"samples": 3})
    again = load_network(path)
    assert describe(path)["samples"] == 3 and again.config == network.config
    for name, value in network.state_dict().items():
        torch.testing.assert_close(again.state_dict()[name], value, rtol=5e-4, atol=1e-6)


def test_tiles_cover_the_photo_and_what_they_see_of_sources_fits_the_budget() -> None:
    for width, height in ((800, 600), (8000, 6000), (321, 1999)):
        view, *sources = (enlarged(make_view(i, 100), width, height) for i in (0, 1, 99, 2, 98))
        for budget in (900 << 20, 4 << 30):
            covered = np.zeros((height, width), bool)
            for plan in plan_tiles(view, sources, 96, budget):
                tile = plan.tile
                assert tile.x0 >= 0 and tile.y0 >= 0 and tile.x1 <= width and tile.y1 <= height
                covered[tile.y0 : tile.y1, tile.x0 : tile.x1] = True
                sizes = [np.prod(region.size) for region in plan.seen if region]
                own = BASE_BYTES + np.prod(tile.size) * bytes_per_pixel(96)
                assert own + sum(sizes) * BYTES_PER_SOURCE_PIXEL < budget
            assert covered.all()
    with pytest.raises(DeviceError, match="too small"):
        plan_tiles(enlarged(make_view(0, 100), 8000, 6000), [], 96, 100 << 20)


def test_features_in_strips_are_those_of_the_whole_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    network = load_network().fold_batch_norm().channels_last()
    picture = torch.rand(1, 3, 320, 96, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        whole = network.pyramid(picture)
        monkeypatch.setattr(layers, "STRIP_PIXELS", 96 * 64)
        for level, strips in zip(whole, network.pyramid(picture), strict=True):
            torch.testing.assert_close(strips, level, rtol=0, atol=1e-5)


def test_with_little_memory_a_tile_goes_without_its_last_sources() -> None:
    view, *sources = (enlarged(make_view(i, 24), 4000, 3000) for i in (0, 1, 23, 5, 19))
    plenty, little = (plan_tiles(view, sources, 96, budget << 20) for budget in (8000, 1500))
    assert all(None not in plan.seen for plan in plenty)
    used = [[region is not None for region in plan.seen] for plan in little]
    assert not np.all(used) and np.all(np.sum(used, axis=1) >= 2)
    assert np.mean(used, axis=0)[0] >= np.mean(used, axis=0)[-1]  # those with the best scores stay


def enlarged(view: View, width: int, height: int) -> View:
    """The same camera with a picture of another size."""
    scale = [[width / view.width], [height / view.height], [1]]
    return replace(view, width=width, height=height, K=view.K * scale)


def test_a_tile_takes_from_a_source_all_that_it_can_see() -> None:
    reference, source = make_view(0, 24), make_view(1, 24)
    depth, _ = cast(reference)
    tile = Tile(96, 32, 160, 96)
    region = visible_region(reference, tile, source)
    v, u = np.mgrid[tile.y0 : tile.y1, tile.x0 : tile.x1] + 0.5
    z = np.clip(depth[tile.y0 : tile.y1, tile.x0 : tile.x1], reference.near, reference.far)
    camera = np.linalg.inv(reference.K) @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1) * z.reshape(-1)
    world = reference.cam_from_world[:, :3].T @ (camera - reference.cam_from_world[:, 3:])
    x, y, w = source.K @ (source.cam_from_world[:, :3] @ world + source.cam_from_world[:, 3:])
    inside = (x / w > 0) & (x / w < source.width) & (y / w > 0) & (y / w < source.height)
    assert inside.any()
    assert (x / w)[inside].min() >= region.x0 and (x / w)[inside].max() <= region.x1
    assert (y / w)[inside].min() >= region.y0 and (y / w)[inside].max() <= region.y1


def plain_and_fused(
    values: list[torch.Tensor], extents: torch.Tensor, visibility: bool, upstream: torch.Tensor
) -> list[list[torch.Tensor]]:
    """Cost volumes of two samples, and the gradients of values: the reference's and three sources' features, alpha and
    beta."""
    h, w = upstream.shape[3:]
    K = torch.tensor([[22.0, 0, 10], [0, 22, 6], [0, 0, 1]]).expand(2, 4, 3, 3)
    poses = torch.eye(3, 4).repeat(2, 4, 1, 1)
    poses[:, 1:, 0, 3] = torch.tensor([0.8, -1.6, 2.4])
    poses[:, 3, 2, 3] = -7.0  # some depths lie behind the last source
    terms = [homography_terms(K, poses, i, pixel_grid(torch.arange(w) + 0.5, torch.arange(h) + 0.5)) for i in (1, 2, 3)]
    inverse_depth = 1 / (0.3 + 12 * torch.rand(2, *upstream.shape[2:], generator=torch.Generator().manual_seed(1)))
    weights = torch.tensor([[0.5, 0.3, 0.2], [0.2, 0.2, 0.6]])
    results = []
    for compute in (plain_cost_volume, fused_cost_volume):
        own = [value.clone().requires_grad_() for value in values]
        volume = compute(CostVolumeInput(own[0], own[1:4], extents, terms, weights, inverse_depth), 8, own[4],
                         own[5] if visibility else None)
        (volume * upstream).sum().backward()
        results.append([volume.detach(), *[value.grad for value in own[: 6 if visibility else 5]]])
    return results


def random_features(level: int) -> list[torch.Tensor]:
    torch.manual_seed(level)
    channels, h, w = 8 * 2**level, 12, 20
    return [torch.randn(2, channels, h, w), torch.randn(2, channels, h, w), torch.randn(2, channels, h, w),
            torch.randn(2, channels, h + 4, w - 4), torch.tensor(1.3), torch.tensor(1.1)]


@pytest.mark.parametrize("visibility", [True, False])
@pytest.mark.parametrize("level", [0, 2])
def test_the_fused_cost_volume_is_the_plain_one_with_its_gradients(level: int, visibility: bool) -> None:
    extents = torch.tensor([[20.0, 12.0], [18.5, 9.25], [16.0, 13.0]]).expand(2, 3, 2)
    results = plain_and_fused(random_features(level), extents, visibility, torch.randn(2, 8, 6, 12, 20))
    assert (results[0][0] == 0).any()  # there are places that no source sees
    for plain, fused in zip(*results, strict=True):
        torch.testing.assert_close(fused, plain, rtol=1e-4, atol=1e-4 * float(plain.abs().max()))


@pytest.mark.parametrize("visibility", [True, False])
def test_what_pads_a_source_changes_no_cost_and_learns_nothing(visibility: bool) -> None:
    values, upstream = random_features(0), torch.randn(2, 8, 6, 12, 20)
    extents = torch.tensor([[20.0, 12.0], [15.0, 8.0], [16.0, 16.0]]).expand(2, 3, 2)
    other = [value.clone() for value in values]
    padding = np.s_[..., 9:, :], np.s_[..., :, 16:]  # a photo's last row and column are mixed with the next ones
    for place in padding:
        other[2][place] = 3.0
    for ours, theirs in zip(plain_and_fused(values, extents, visibility, upstream),
                            plain_and_fused(other, extents, visibility, upstream), strict=True):
        torch.testing.assert_close(ours[0], theirs[0])
        assert all(not ours[3][place].any() for place in padding) and ours[3].any()


def test_below_a_sources_last_row_the_other_source_is_believed(tmp_path: Path) -> None:
    """One of two sources has 97 rows, which the network takes as 128. That costs no more than 96 rows do."""
    errors = {}
    for rows in (96, 97):
        short, view, whole = (make_view(i, 30) for i in (2, 3, 4))
        short = replace(short, height=rows)
        folder = tmp_path / str(rows)
        (folder / "undistorted").mkdir(parents=True)
        for each in (short, view, whole):
            cv2.imwrite(str(folder / each.image), cast(each)[1][..., ::-1])
        truth, _ = cast(view)
        v, u = np.mgrid[: view.height, : view.width] + 0.5
        rays = np.linalg.inv(view.K) @ np.stack([u, v, np.ones_like(u)]).reshape(3, -1) * truth.reshape(-1)
        world = view.cam_from_world[:, :3].T @ (rays - view.cam_from_world[:, 3:])
        places = []
        for source in (short, whole):
            x, y, z = source.K @ (source.cam_from_world[:, :3] @ world + source.cam_from_world[:, 3:])
            places.append(((x / z).reshape(truth.shape), (y / z).reshape(truth.shape)))
        (x, y), (x_whole, y_whole) = places
        below = (truth > 0) & (y > 97) & (x > 0) & (x < 160)
        below &= (y_whole < 120) & (y_whole > 0) & (x_whole > 0) & (x_whole < 160)
        assert below.mean() > 0.1
        options = Options(photos=folder, workspace=folder, device="cpu", precision="fp32")
        depth, _ = DepthEstimator(load_network(), folder, options).estimate(view, [(short, 1.0), (whole, 1.0)])
        errors[rows] = (np.abs(depth - truth)[below] / truth[below]).mean()
    assert errors[97] < 1.3 * errors[96]  # 0.9; where padding is believed, 3


def test_an_unsure_pixel_is_not_thrown_far_beyond_what_the_photo_reaches() -> None:
    depth = np.full((40, 50), 20.0, np.float32)
    depth[:4, :25], depth[:4, 25:] = 400.0, 60.0
    confidence = np.full(depth.shape, 0.95, np.float16)
    confidence[:4, :25] = 0.2  # a guess at the sweep's end
    matched = np.array([[5, 5, 30, 1], [9, 9, 390, 0]], np.float32)  # the second is another photo's point

    held = within_reach(depth, confidence, matched)
    assert np.allclose(held[:4, :25], 72) and (held[4:] == 20).all() and (held[:4, 25:] == 60).all()
    confidence[:4, 25:] = 0.2  # then the photo reaches as far as its point
    assert np.allclose(within_reach(depth, confidence, matched)[:4], 36)
    assert (within_reach(depth, np.zeros_like(confidence), matched[1:]) == depth).all()  # nothing to go by


def test_photos_take_turns_so_that_few_features_are_computed_twice() -> None:
    """Two passes of ten photos along a wall, taken in turns; each asks for those beside it in its own pass."""
    names = [f"{place}{line}" for place in range(10) for line in "ab"]
    views = {name: replace(make_view(0, 4), name=name, sources=tuple(
        (f"{near}{name[1]}", 1.0) for near in (int(name[0]) - 1, int(name[0]) + 1) if 0 <= near < 10
    )) for name in names}
    left = [(view, views) for view in views.values()]
    ordered = by_neighbours(left, 4)
    assert sorted(view.name for view, _ in ordered) == sorted(names)

    def computed(photos: list[tuple[View, dict[str, View]]]) -> int:
        kept: list[str] = []
        count = 0
        for view, _ in photos:
            for name in (view.name, *(source for source, _ in view.sources)):
                count += name not in kept
                kept = [*(k for k in kept if k != name), name][-4:]
        return count

    assert computed(ordered) == 20 < computed(left)
