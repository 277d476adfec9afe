# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: planes go on where nothing is known, points say where, and a new one leaves the cascade's estimate
alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from curecon_blender.core.network.refinement import (
    POINT_KINDS,
    RADII,
    SIDES,
    STEP,
    Proposal,
    Refinement,
    evaluate_planes,
    moments,
    picture_planes,
    plain_refined_depth,
    rasterise_points,
    refined_depth,
    sampled_refined_depth,
    window_planes,
)

INTERVAL = 1 / 400


def sloping(height: int, width: int) -> torch.Tensor:
    """A plane's t (1,1,H,W), as it stands at the centres of the pixels."""
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return (0.3 + 0.001 * columns - 0.0005 * rows)[None, None]


def offered(planes: list[torch.Tensor]) -> torch.Tensor:
    """What each plane says at the photo's pixels, (P,1,1,H,W)."""
    return evaluate_planes(torch.stack(planes, 1), STEP)[0, :, None, None]


def test_a_plane_goes_on_across_what_nobody_knows() -> None:
    truth = sloping(128, 192)
    quarter = torch.nn.functional.avg_pool2d(truth, STEP)
    weight = torch.ones_like(quarter)
    weight[..., 12:20, 20:28] = 0  # 32 pixels of the photo
    quarter = torch.where(weight > 0, quarter, 0.9)
    found = offered(window_planes(moments(quarter) * weight, SIDES))
    assert len(found) == len(RADII) * len(SIDES)
    hole = (found - truth)[..., 48:80, 80:112].abs()
    assert hole.amin(0).max() < INTERVAL  # every pixel of it has a window that says the plane
    assert (found[-5] - truth).abs()[..., 48:80, 80:112].mean() < INTERVAL  # the largest window about it, all of it


def test_two_planes_that_meet_are_both_offered_up_to_the_edge() -> None:
    truth = sloping(128, 192)
    truth[..., 96:] = 0.8
    quarter = torch.nn.functional.avg_pool2d(truth, STEP)
    weight = torch.ones_like(quarter)
    weight[..., 22:26] = 0
    found = offered(window_planes(moments(quarter) * weight, SIDES))
    assert (found - truth).abs().amin(0)[..., 88:104].max() < INTERVAL


def test_planes_across_the_picture_go_on_behind_what_stands_before_them() -> None:
    truth = sloping(128, 192)
    quarter = torch.nn.functional.avg_pool2d(truth, STEP)
    building = torch.zeros_like(quarter)
    building[..., 16:48] = 1
    planes = picture_planes(moments(torch.where(building > 0, 0.9, quarter)), torch.cat([1 - building, building], 1))
    ground, facade = offered([plane.expand(-1, -1, *quarter.shape[2:]) for plane in planes])
    assert (ground - truth).abs().max() < INTERVAL
    assert (facade - 0.9).abs().max() < INTERVAL


def test_points_in_a_hole_tell_of_the_surface_there() -> None:
    truth = sloping(128, 192)
    near, far = 1.0, 20.0
    rows, columns = np.random.default_rng(0).integers(0, (128, 192), (200, 2)).T
    depth = 1 / (1 / near + truth[0, 0, rows, columns].numpy() * (1 / far - 1 / near))
    grid = torch.from_numpy(rasterise_points(
        np.column_stack([columns + 0.5, rows + 0.5, depth, np.zeros(200)]), near, far, (192, 128)))[None]
    found = offered(window_planes(moments(grid[:, :1]) * grid[:, POINT_KINDS : POINT_KINDS + 1], SIDES[:1]))
    assert (found[-1] - truth).abs().max() < 2 * INTERVAL
    assert not grid[:, POINT_KINDS + 1].any()  # the photo has matched none of them


def test_the_nearest_point_of_a_block_counts_and_none_from_outside() -> None:
    points = np.array([[9.0, 5.0, 4.0, 1.0], [10.5, 6.5, 2.0, 0.0], [33.0, 5.0, 2.0, 1.0], [9.0, -1.0, 2.0, 1.0],
                       [20.0, 5.0, 10.0, 1.0], [20.0, 5.0, 0.5, 1.0]])
    grid = rasterise_points(points, 1.0, 9.0, (32, 32))
    there = grid[POINT_KINDS:]
    assert there.sum() == 2 and (there[:, 1, 2] == 1).all()
    any_t, matched_t = grid[:POINT_KINDS, 1, 2]
    np.testing.assert_allclose([1 / (1 - t * 8 / 9) for t in (any_t, matched_t)], [2.0, 4.0], rtol=1e-5)


def proposed(refinement: Refinement, t: torch.Tensor) -> Proposal:
    points = torch.from_numpy(rasterise_points(np.array([[50.0, 30.0, 2.0, 1.0]]), 1.0, 9.0, (96, 64)))[None]
    found: Proposal = refinement(torch.rand(1, 3, 64, 96), t, torch.full((1, 3, 64, 96), 0.9), INTERVAL, points)
    return found


def test_a_new_one_keeps_the_estimate() -> None:
    t = sloping(64, 96)
    refined = plain_refined_depth(t, proposed(Refinement(8), t), INTERVAL)
    assert (refined.t - t).abs().max() < INTERVAL
    assert refined.probability.argmax(1).eq(0).all()
    torch.testing.assert_close(refined.probability.sum(1), torch.ones(1, 64, 96))


@pytest.mark.parametrize("listens", [True, False])
def test_what_lies_at_the_other_end_of_a_picture_tells_what_is_likely_here(listens: bool) -> None:
    torch.manual_seed(0)
    refinement = Refinement(8)
    torch.nn.init.normal_(refinement.leave.weight)
    for parameter in refinement.surroundings.parameters() if listens else ():
        torch.nn.init.normal_(parameter, std=0.06)
    picture, sure = torch.rand(1, 3, 64, 960), torch.full((1, 3, 64, 960), 0.9)
    nothing = torch.zeros(1, 2 * POINT_KINDS, 16, 240)
    far = picture.clone()
    far[..., :64] = 0.0
    with torch.inference_mode():
        here, there = (refinement(colours, sloping(64, 960), sure, INTERVAL, nothing).logits[..., -8:]
                       for colours in (picture, far))
    assert here.isfinite().all()
    assert (not torch.allclose(here, there, rtol=0, atol=1e-6)) == listens


@pytest.mark.parametrize("decided", [0.3, 3.0])
def test_the_fused_choice_is_the_plain_one(decided: float) -> None:
    torch.manual_seed(0)
    refinement = Refinement(8)
    torch.nn.init.normal_(refinement.leave.weight, std=decided)
    t = sloping(64, 96) + 0.02 * torch.randn(1, 1, 64, 96)
    with torch.inference_mode():
        proposal = proposed(refinement, t)
        plain = plain_refined_depth(t, proposal, INTERVAL)
        fused_t, fused_confidence = refined_depth(t, proposal, INTERVAL)
    torn = plain.probability.amax(1) < 0.5
    assert 0.02 < torn.float().mean() < 0.98  # both ways of choosing are there
    # Where a candidate lies just within reach of another, or just not, a last bit may decide.
    assert ((fused_t - plain.t).abs() < 1e-5).float().mean() > 0.999
    torch.testing.assert_close(fused_confidence, plain.confidence_logit)


def test_what_training_samples_is_the_choice_at_those_pixels() -> None:
    torch.manual_seed(0)
    refinement = Refinement(8)
    torch.nn.init.normal_(refinement.leave.weight, std=0.3)
    t = sloping(64, 96) + 0.02 * torch.randn(1, 1, 64, 96)
    with torch.inference_mode():
        proposal = proposed(refinement, t)
        whole = plain_refined_depth(t, proposal, INTERVAL)
        for column, row in ((0, 0), (1, 0), (0, 1), (1, 1)):
            sampled = sampled_refined_depth(t, proposal, INTERVAL, (column, row))
            same = (sampled.t - whole.t[..., row::2, column::2]).abs() < 1e-5
            assert same.float().mean() > 0.999  # where two candidates are as likely, a last bit may decide
            for name in ("candidates", "probability", "confidence_logit"):
                torch.testing.assert_close(getattr(sampled, name), getattr(whole, name)[..., row::2, column::2],
                                           rtol=0, atol=1e-5)
