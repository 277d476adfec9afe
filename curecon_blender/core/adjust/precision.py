# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""How precisely an adjustment knows its cameras, lenses and points: covariances, by propagation of errors.

Everything is free at once: a point's covariance holds what the cameras, the lenses and the datum contribute to it, not
only its own observations (Förstner and Wrobel 2016, Photogrammetric Computer Vision, 15.3).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from . import bundle_cpu
from .bundle import CAUCHY, Bundle
from .bundle_cpu import LENS, POSE
from .precision_record import Precision

OUTLIER = 4.0  # sigmas of a residual from where on an observation tells nothing
LEFT_OPEN = 0.3  # of what is known of a lens parameter: the photos tell it better, or not
# Metres, along x, y and z, by which a receiver that states no accuracy errs in all photos of a flight alike: under an
# open sky, one frequency, without corrections. Residuals do not show it. One that states its accuracy errs by that.
OFFSET = 1.5, 1.5, 3.0
PARTS, LENS_PARTS = 4, 8  # of a photo's width and height, over which features' errors are summed
_ROUNDS = 3
FAR = 30.0  # times the flight's extent
FEEBLE = 10.0  # times the median sigma of a point from where on it tells nothing of the site as a whole
SIMILARITY = 7  # shift, turn, scale


def precision(bundle: Bundle, lens_sigmas: np.ndarray | None = None) -> Precision:
    """The precision of a bundle that is adjusted: its residuals tell how good its observations are.

    `lens_sigmas` (L,9) are those of what is known of the lenses, where the adjustment held some of it fast: that is as
    far off as they say, or as the photos leave open, and takes with it what was fitted to it.

    Positions are taken to err by an offset that all photos of a receiver share (see OFFSET), and by what changes from
    photo to photo as slowly as their residuals show: the mean of many is hardly better than one. Features err together
    by as much as their residuals show. The adjustment may have counted both otherwise: that makes it less exact, but
    no other errors than these come into it.
    """
    weights, worst = _weights(bundle)
    told = np.zeros(len(weights), bool) if bundle.observation_sigmas is None else ~np.isnan(bundle.observation_sigmas)
    # What features have in common does not grow less with their number, but is no error of a single point's own rays.
    together = np.where(told, 1.0, bundle.together**-2)
    system, inverses, coupling = _system(bundle, weights * together)
    marks = _system(bundle, np.where(told, weights, 0.0))[0] if told.any() else 0.0
    excess = (_alike(bundle, np.where(told, 0.0, weights)) * bundle.together**-2 - 1) * (system - marks)
    places, known = _places(bundle)
    system[np.ix_(places, places)] += known
    at = np.arange(POSE * len(bundle.centres))
    system[at, at] += _attitudes(bundle)
    alone = np.ones(len(bundle.points))
    np.minimum.at(alone, bundle.point, together)
    rays = np.maximum(np.bincount(bundle.point[weights > 0], minlength=len(bundle.points)), 1)
    # An error that its point takes up is seen in no residual, and counts in full: the fewer rays, the more of it.
    unseen = np.where(np.isin(np.arange(len(rays)), bundle.control), 0.0, 3 / (2 * rays))
    own = inverses * (alone * (1 + (worst - 1) * unseen))[:, None, None]
    held = bool(np.isfinite(bundle.position_sigmas).any() or len(bundle.control) >= 3)
    middle, photos = bundle.points.mean(axis=0), len(bundle.centres)
    moves = _similarities(bundle, middle)
    if not held:
        system += _gauge(moves, system)
    inverse = _inverse(_with_lenses(system, bundle.lens_sigmas))
    errors = _errors_of_places(bundle, known, inverse[np.ix_(places, places)])
    excess[np.ix_(places, places)] += known @ errors @ known - known
    cameras = inverse + inverse @ excess @ inverse
    if lens_sigmas is not None:
        cameras += _of_held_lenses(system, inverse, bundle.lens_sigmas, lens_sigmas)
    of_points = similarity_of(bundle.points - middle)
    responses = _whole(bundle, inverses, coupling, of_points, own, len(system))
    through, datum = cameras @ responses.T, responses @ cameras @ responses.T
    points, shapes = bundle_cpu.point_covariances(
        bundle.photo, bundle.lens_of, bundle.starts, photos, inverses, coupling, of_points, cameras, through, datum, own
    )
    if not held:
        shape = np.eye(len(system)) - moves @ responses  # without a camera's move that is the points'
        cameras = shape @ cameras @ shape.T
        points, datum = shapes, np.zeros_like(datum)
    poses = np.diag(cameras)[: POSE * photos].reshape(photos, POSE)
    at = POSE * np.arange(photos)[:, None, None] + 3
    return Precision(
        places=bundle.points, points=points, shapes=shapes, own=own, rays=rays, middle=middle, datum=datum, held=held,
        centres=cameras[at + np.arange(3)[:, None], at + np.arange(3)],
        turns=np.sqrt(poses[:, :3]), lenses=np.sqrt(np.diag(cameras)[POSE * photos :].reshape(-1, LENS)),
        sigma=float(np.median(np.sqrt(worst / weights[weights > 0]))) if (weights > 0).any() else np.inf,
    )


def _weights(bundle: Bundle) -> tuple[np.ndarray, float]:
    """(M,) information of a coordinate of each observation, 0 for an outlier; and how much larger the variance of one
    whose sigma is not told is where the adjustment cannot see its error, and count it less.

    Of observations whose sigma is not told, it comes from what their residuals leave after all that was fitted to them:
    two rays that meet have a single residual, so that a median of all would take them for better than they are. What
    errors of this kind make of the adjustment's estimator is the mean square of its influence over that of its slope
    (Huber 1981, Robust Statistics, 3.2).
    """
    off, sigmas = np.linalg.norm(bundle.residuals(), axis=1), bundle.sigmas()
    told = np.zeros(len(sigmas), bool) if bundle.observation_sigmas is None else ~np.isnan(bundle.observation_sigmas)
    pulls, worst = 1 / (1 + (off / (CAUCHY * sigmas)) ** 2), 1.0
    for _ in range(_ROUNDS):
        counted = (off < OUTLIER * sigmas) & ~told
        rays = np.bincount(bundle.point[counted], minlength=len(bundle.points))
        counted &= rays[bundle.point] > 1
        freedom = 2 * rays[rays > 1].sum() - 3 * (rays > 1).sum() - POSE * len(bundle.centres)
        if freedom > 0:
            influence, slope = (pulls[counted] * off[counted]) ** 2, float((pulls[counted] ** 2).mean())
            sigmas[~told] = np.sqrt(influence.sum() / freedom) / slope
            worst = max(float((off[counted] ** 2).sum()) / freedom / float(sigmas[~told][0]) ** 2, 1.0)
    return np.where(off < OUTLIER * sigmas, 1 / sigmas**2, 0.0), worst


def _system(bundle: Bundle, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The reduced system (D,D) of observations with these weights; the points' inverse blocks and each observation's
    coupling, as bundle_cpu.reduce gives them."""
    size = POSE * len(bundle.centres) + bundle.lenses.size
    system = np.zeros((size, size))
    # No point is known to less than FAR: a ray alone, or two side by side, would leave a block without an inverse.
    known = np.full_like(bundle.points, (FAR * np.ptp(bundle.centres, axis=0).max(initial=1e-6)) ** -2)
    known[bundle.control] += 1 / bundle.control_sigmas**2
    inverses, _, coupling = bundle_cpu.reduce(
        bundle.rotations, bundle.centres, bundle.lenses, bundle.lens_of, bundle.points, bundle.photo, bundle.starts,
        bundle.pixels, weights, 0.0, known, np.zeros_like(known), system, np.zeros(size),
    )
    return np.tril(system) + np.tril(system, -1).T, inverses, coupling


def _with_lenses(system: np.ndarray, lens_sigmas: np.ndarray) -> np.ndarray:
    """The system with what is known of the lenses, by sigmas (L,9)."""
    result, at = system.copy(), np.arange(len(system) - lens_sigmas.size, len(system))
    result[at, at] += 1 / lens_sigmas.ravel() ** 2
    return result


def _of_held_lenses(system: np.ndarray, inverse: np.ndarray, held: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(D,D) what parameters of lenses that were held fast, with sigmas (L,9) smaller than what is `known` of them, add
    to the covariance of cameras (Schmidt 1966). `inverse` (D,D) is that of the system as it was solved."""
    first = len(system) - held.size
    at = first + np.flatnonzero((held < known).ravel())
    open_ = np.sqrt(np.diag(_inverse(_with_lenses(system, known)))[at])
    sigmas = known.ravel()[at - first]
    # What the photos hardly know was left at what is known of it, and is off by as much.
    off = np.where(open_ > LEFT_OPEN * sigmas, sigmas, open_)
    follows = -inverse @ system[:, at]
    follows[at] = np.eye(len(at))
    return np.asarray((follows * off**2) @ follows.T)


def _inverse(system: np.ndarray) -> np.ndarray:
    units = 1 / np.sqrt(np.maximum(np.diag(system), 1e-30))  # what is held fast weighs 1e18 times what is not
    factor = cho_factor(system * np.outer(units, units), overwrite_a=True)
    return np.asarray(cho_solve(factor, np.diag(units)) * units[:, None])


def similarity_of(offsets: np.ndarray) -> np.ndarray:
    """(P,3,7) how places at offsets (P,3) from the middle follow a shift, a small turn, a relative change of scale."""
    x, y, z = offsets.T
    o, one = np.zeros_like(x), np.ones_like(x)
    rows = [[one, o, o, o, z, -y, x], [o, one, o, -z, o, x, y], [o, o, one, y, -x, o, z]]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def _whole(
    bundle: Bundle, inverses: np.ndarray, coupling: np.ndarray, of_points: np.ndarray, own: np.ndarray, size: int
) -> np.ndarray:
    """(7,D) the similarity by which the points follow photos and lenses as a whole: those that are known well, since a
    ray alone leaves its point where it is."""
    open_ = np.trace(own, axis1=1, axis2=2)
    counted = of_points * (open_ < FEEBLE**2 * np.median(open_))[:, None, None]
    towards = bundle_cpu.shape_response(
        bundle.photo, bundle.lens_of, bundle.starts, len(bundle.centres), inverses, coupling, counted, size
    )
    return np.asarray(np.linalg.solve(np.einsum("pij,pik->jk", counted, counted), towards))


def _similarities(bundle: Bundle, middle: np.ndarray) -> np.ndarray:
    """(D,7) how the cameras follow the same."""
    photos = len(bundle.centres)
    moves = np.zeros((POSE * photos + bundle.lenses.size, SIMILARITY))
    poses = moves[: POSE * photos].reshape(photos, POSE, SIMILARITY)
    poses[:, :3, 3:6] = -bundle.rotations
    poses[:, 3:] = similarity_of(bundle.centres - middle)
    return moves


def _gauge(moves: np.ndarray, system: np.ndarray) -> np.ndarray:
    """What holds the datum of a free network, without a word on its shape."""
    basis = np.linalg.qr(moves)[0]
    return np.asarray(basis @ basis.T * np.median(np.diag(system)))


def _attitudes(bundle: Bundle) -> np.ndarray:
    """(6 N,) the information of attitudes, on the diagonal of the photos' part of the system."""
    information = np.zeros((len(bundle.centres), POSE))
    information[:, :3] = bundle.attitude_sigmas[:, None] ** -2.0
    return information.ravel()


def _places(bundle: Bundle) -> tuple[np.ndarray, np.ndarray]:
    """The numbers (3 N,) of the photos' places in the system, and the information (3 N,3 N) by which the adjustment
    takes what is known of them. Where that tells `apart` only, what they have in common has none."""
    photos = len(bundle.centres)
    off = np.linalg.norm(bundle.positions_off / bundle.position_sigmas, axis=1)[:, None]
    weights = np.where(off < OUTLIER, bundle.position_sigmas**-2.0 / (1 + (off / CAUCHY) ** 2), 0.0)
    information = np.diag(weights.ravel())
    for axis in range(3):
        total = weights[:, axis].sum()
        if bundle.apart and total > 0:
            information[axis::3, axis::3] -= np.outer(weights[:, axis], weights[:, axis]) / total
    return (POSE * np.arange(photos)[:, None] + [3, 4, 5]).ravel(), information


def _errors_of_places(bundle: Bundle, information: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """(3 N,3 N) the covariance of what is known of places: what changes from photo to photo, as slowly and as much as
    the residuals show that it does, plans apart from heights; and an offset that all photos of a receiver share.
    `inverse` (3 N,3 N) is how the photos' places follow a pull."""
    photos = len(bundle.centres)
    counted = (np.diag(information) > 0).reshape(photos, 3)
    sigmas = np.where(counted, bundle.position_sigmas, 0.0)
    off = np.where(counted, bundle.positions_off, 0.0)
    kept = _kept((off / np.where(counted, sigmas, 1.0))[counted.any(axis=1)])
    kinds = np.ones(photos, int) if bundle.receivers is None else bundle.receivers
    alike = kept ** np.abs(np.arange(photos)[:, None] - np.arange(photos)[None])
    drift, offset = np.zeros_like(information), np.zeros_like(information)
    for axis in range(3):
        mine = sigmas[:, axis]
        common = np.where(counted[:, axis] & (kinds == 0), np.maximum(mine, OFFSET[axis]), mine)
        drift[axis::3, axis::3] = np.outer(mine, mine) * alike
        offset[axis::3, axis::3] = np.outer(common, common) * (kinds[:, None] == kinds[None])
    # What of the errors is left in the residuals: the cameras follow some of it, and what is common is taken out.
    left = np.eye(3 * photos) - inverse @ information
    if bundle.apart:
        for axis in range(3):
            weights = np.diag(information)[axis::3] * counted[:, axis]
            left[axis::3] -= weights @ left[axis::3] / max(weights.sum(), 1e-300)
    expected = np.einsum("ij,jk,ik->i", left, drift, left, optimize=True).reshape(photos, 3)
    factors = np.zeros((photos, 3))
    for kind in np.unique(kinds):
        for axes in ([0, 1], [2]):
            which = np.zeros((photos, 3), bool)
            which[:, axes] = counted[:, axes] & (kinds == kind)[:, None]
            if which.any():
                found = float((off[which] ** 2).sum() / max(expected[which].sum(), 1e-300))
                factors[which] = np.sqrt(found if kind == 0 else max(found, 1.0))  # no less than is stated
    return np.asarray(drift * np.outer(factors, factors) + offset)


def _alike(bundle: Bundle, weights: np.ndarray) -> float:
    """How much larger the variance of a sum of features' errors is than their number makes it, 1 where each errs for
    itself: from residuals with weights (M,), 0 for what does not count, summed over parts of a photo, and over parts of
    all the photos of a lens."""
    counted = np.flatnonzero(weights)
    if not len(counted):
        return 1.0
    photo = bundle.photo[counted]
    lens, pixels = bundle.lens_of[photo], bundle.pixels[counted]
    off = bundle.residuals()[counted] * np.sqrt(weights[counted])[:, None]
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    inflated = [1.0]
    for of, cells, taken in ((photo, PARTS, POSE), (lens, LENS_PARTS, LENS)):
        column, row = np.minimum((pixels - low) / (high - low) * cells, cells - 1).astype(int).T
        part = (of * cells + row) * cells + column
        sums = float(sum((np.bincount(part, off[:, axis]) ** 2).sum() for axis in range(2)))
        free = 1 - taken / (2 * cells**2)  # poses and lenses have been fitted to the sums
        inflated.append(sums / float((off**2).sum()) / free)
    return max(inflated)


def _kept(off: np.ndarray) -> float:
    """The share of a position's error that the next photo's keeps, from residuals (N,3) in sigmas in the order of the
    photos; mended for what the adjustment has taken from them (Kendall 1954)."""
    off = np.clip(off, -3, 3)
    count = len(off)
    if count < 8:
        return 0.0
    found = float((off[1:] * off[:-1]).sum() / max((off**2).sum(), 1e-12))
    return float(np.clip((count * found + 1) / (count - 4), 0.0, 0.98))
