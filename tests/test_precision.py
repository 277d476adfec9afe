# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The precision that an adjustment tells of itself, against what really comes of many adjustments with other noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from curecon_blender.core.adjust.bundle import adjust
from curecon_blender.core.adjust.precision import precision
from evaluation.precision import DATUMS, noisy, ratios, run, site, within


@pytest.mark.parametrize("datum", DATUMS)
def test_told_precision_is_the_spread_of_many_adjustments(datum: str) -> None:
    trials = run(runs=12, photos=9, points=60, datum=datum)
    assert ratios(trials.shape_errors, trials.shape_covariances) == pytest.approx(1, abs=0.15)
    assert 0.62 < within(trials.shape_errors, trials.shape_covariances) < 0.74
    if datum != "free":  # all points share the datum, so that twelve runs tell little more than its order of size
        assert ratios(trials.errors, trials.covariances) == pytest.approx(1, abs=0.5)


def test_many_photos_do_not_average_away_what_their_receiver_errs_by_as_a_whole() -> None:
    truth = site(25, 60, "gps")
    told = precision(adjust(noisy(truth, np.random.default_rng(1))))
    assert told.held
    assert np.sqrt(np.diag(told.datum)[:3]) == pytest.approx(truth.position_sigmas[0], rel=0.5)
    within_site, in_all = (np.sqrt(np.trace(c, axis1=1, axis2=2)).mean() for c in (told.shapes, told.points))
    assert within_site < 0.2 * in_all


def test_a_receiver_that_states_no_accuracy_errs_by_metres_as_a_whole_but_not_where_control_holds() -> None:
    adjusted = adjust(noisy(site(9, 60, "both"), np.random.default_rng(1)))
    ordinary = replace(adjusted, receivers=np.zeros(9, int))
    alone = replace(ordinary, control=np.zeros(0, int), control_positions=np.zeros((0, 3)),
                    control_sigmas=np.zeros((0, 3)), apart=False)
    shift = {name: precision(bundle).datum_sigmas[:3] for name, bundle in (
        ("control", replace(ordinary, position_sigmas=np.full((9, 3), np.inf))), ("both", ordinary), ("gps", alone))}
    assert (shift["gps"] > [1.5, 1.5, 3.0]).all()
    assert (shift["both"] < 1.02 * shift["control"]).all() and (shift["control"] < 0.1).all()


def test_points_that_one_photo_sees_do_not_blur_the_others() -> None:
    adjusted = replace(adjust(noisy(site(16, 80, "gps"), np.random.default_rng(1))), receivers=np.zeros(16, int))
    alone = (adjusted.point < 8) & (np.arange(len(adjusted.point)) != adjusted.starts[adjusted.point])
    told, sound = precision(adjusted.without(alone)), precision(adjusted)
    sigmas, before = (np.sqrt(np.trace(p.shapes[8:], axis1=1, axis2=2)) for p in (told, sound))
    assert np.median(sigmas / before) == pytest.approx(1, abs=0.1)
    assert told.datum_sigmas == pytest.approx(sound.datum_sigmas, rel=0.1)


def test_a_network_that_nothing_holds_says_so_and_tells_its_shape_alone() -> None:
    truth = site(9, 60, "free")
    told = precision(adjust(noisy(truth, np.random.default_rng(1))))
    assert not told.held and (told.points == told.shapes).all() and not told.datum.any()
    assert np.isfinite(told.centres).all() and (np.diagonal(told.centres, axis1=1, axis2=2) > 0).all()


def test_an_outlier_adds_nothing_to_what_is_known_of_its_point() -> None:
    truth = site(9, 60, "gps")
    adjusted = adjust(noisy(truth, np.random.default_rng(1)))
    of_first = np.flatnonzero(adjusted.point == 0)
    wrong = adjusted.pixels.copy()
    wrong[of_first[2:]] += 80.0
    sigma = {name: np.sqrt(np.trace(precision(bundle).shapes[0])) for name, bundle in
             (("sound", adjusted), ("spoilt", replace(adjusted, pixels=wrong)))}
    assert sigma["spoilt"] > 1.2 * sigma["sound"]
