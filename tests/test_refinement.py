# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The refinement: planes go on where nothing is known, and a new one leaves the cascade's estimate alone."""

from __future__ import annotations

import torch

from curecon_blender.core.refinement import CANDIDATES, STEP, Refinement, plane_candidates

INTERVAL = 1 / 400


def sloping(height: int, width: int) -> torch.Tensor:
    """A plane's t (1,1,H,W), as it stands at the centres of the pixels."""
    rows, columns = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    return (0.3 + 0.001 * columns - 0.0005 * rows)[None, None]


def test_a_plane_goes_on_across_what_nobody_knows() -> None:
    truth = sloping(128, 192)
    quarter = torch.nn.functional.avg_pool2d(truth, STEP)
    weight = torch.ones_like(quarter)
    weight[..., 12:20, 20:28] = 0  # 32 pixels of the photo
    quarter = torch.where(weight > 0, quarter, 0.9)
    found = torch.stack(plane_candidates(quarter, weight))
    assert len(found) == CANDIDATES - 1
    hole = (found - truth)[..., 48:80, 80:112].abs()
    assert hole.amin(0).max() < INTERVAL  # every pixel of it has a window that says the plane
    assert (found[-5] - truth).abs()[..., 48:80, 80:112].mean() < INTERVAL  # the largest window about it, all of it


def test_two_planes_that_meet_are_both_offered_up_to_the_edge() -> None:
    truth = sloping(128, 192)
    truth[..., 96:] = 0.8
    quarter = torch.nn.functional.avg_pool2d(truth, STEP)
    weight = torch.ones_like(quarter)
    weight[..., 22:26] = 0
    found = torch.stack(plane_candidates(quarter, weight))
    assert (found - truth).abs().amin(0)[..., 88:104].max() < INTERVAL


def test_a_new_one_keeps_the_estimate() -> None:
    t, image = sloping(64, 96), torch.rand(1, 3, 64, 96)
    refined = Refinement(8)(image, t, torch.full((1, 3, 64, 96), 0.9), INTERVAL)
    assert (refined.t - t).abs().max() < INTERVAL
    assert refined.probability.argmax(1).eq(0).all()
    torch.testing.assert_close(refined.probability.sum(1), torch.ones(1, 64, 96))
