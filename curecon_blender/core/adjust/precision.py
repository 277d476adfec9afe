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
from .bundle import Bundle
from .bundle_cpu import LENS, POSE
from .precision_record import Precision

OUTLIER = 4.0  # sigmas of a residual from where on an observation tells nothing
EFFICIENCY = 0.915  # of the adjustment's estimator where errors are normal: Cauchy's of two coordinates
LEFT_OPEN = 0.3  # of what is known of a lens parameter: the photos tell it better, or not
_ROUNDS = 3
FAR = 30.0  # times the flight's extent
SIMILARITY = 7  # shift, turn, scale


def precision(bundle: Bundle, lens_sigmas: np.ndarray | None = None) -> Precision:
    """The precision of a bundle that is adjusted: its residuals tell how good its observations are.

    `lens_sigmas` (L,9) are those of what is known of the lenses, where the adjustment held some of it fast: that is as
    far off as they say, or as the photos leave open, and takes with it what was fitted to it.

    Positions are taken to err by an offset that all photos share, as large as each one's sigma, and by what changes
    from photo to photo as slowly as their residuals show: the mean of many is hardly better than one.
    """
    weights = _weights(bundle)
    told = np.zeros(len(weights), bool) if bundle.observation_sigmas is None else ~np.isnan(bundle.observation_sigmas)
    # What features have in common does not grow less with their number, but is no error of a single point's own rays.
    together = np.where(told, 1.0, bundle.together**-2)
    system, inverses, coupling = _system(bundle, weights * together)
    alone = np.ones(len(bundle.points))
    np.minimum.at(alone, bundle.point, together)
    own = inverses * alone[:, None, None]
    held = bool(np.isfinite(bundle.position_sigmas).any() or len(bundle.control) >= 3)
    middle, photos = bundle.points.mean(axis=0), len(bundle.centres)
    moves = _similarities(bundle, middle)
    if not held:
        system += _gauge(moves, system)
    cameras = _inverse(_with_lenses(system, bundle.lens_sigmas))
    if held:
        cameras += cameras @ _shared(bundle) @ cameras
    if lens_sigmas is not None:
        cameras += _of_held_lenses(system, cameras, bundle.lens_sigmas, lens_sigmas)
    of_points = _similarity_of(bundle.points - middle)
    towards = bundle_cpu.shape_response(
        bundle.photo, bundle.lens_of, bundle.starts, photos, inverses, coupling, of_points, len(system)
    )
    normal = np.einsum("pij,pik->jk", of_points, of_points)
    responses = np.linalg.solve(normal, towards)  # (7,D): the similarity by which the points follow the cameras
    through, datum = cameras @ responses.T, responses @ cameras @ responses.T
    points, shapes = bundle_cpu.point_covariances(
        bundle.photo, bundle.lens_of, bundle.starts, photos, inverses, coupling, of_points, cameras, through, datum, own
    )
    if not held:
        free = moves @ responses  # a camera's move that is the points'
        shape = np.eye(len(system)) - free
        cameras = shape @ cameras @ shape.T
        points, datum = shapes, np.zeros_like(datum)
    poses = np.diag(cameras)[: POSE * photos].reshape(photos, POSE)
    at = POSE * np.arange(photos)[:, None, None] + 3
    return Precision(
        places=bundle.points, points=points, shapes=shapes, own=own,
        rays=np.maximum(np.bincount(bundle.point[weights > 0], minlength=len(points)), 1), middle=middle, datum=datum,
        held=held,
        centres=cameras[at + np.arange(3)[:, None], at + np.arange(3)],
        turns=np.sqrt(poses[:, :3]), lenses=np.sqrt(np.diag(cameras)[POSE * photos :].reshape(-1, LENS)),
        sigma=float(np.median(1 / np.sqrt(weights[weights > 0]))) if (weights > 0).any() else np.inf,
    )


def _weights(bundle: Bundle) -> np.ndarray:
    """(M,) information of a coordinate of each observation, 0 for an outlier.

    Of observations whose sigma is not told, it comes from what their residuals leave after all that was fitted to them:
    two rays that meet have a single residual, so that a median of all would take them for better than they are.
    """
    off, sigmas = np.linalg.norm(bundle.residuals(), axis=1), bundle.sigmas()
    told = np.zeros(len(sigmas), bool) if bundle.observation_sigmas is None else ~np.isnan(bundle.observation_sigmas)
    for _ in range(_ROUNDS):
        counted = (off < OUTLIER * sigmas) & ~told
        rays = np.bincount(bundle.point[counted], minlength=len(bundle.points))
        counted &= rays[bundle.point] > 1
        freedom = 2 * rays[rays > 1].sum() - 3 * (rays > 1).sum() - POSE * len(bundle.centres)
        if freedom > 0:
            sigmas[~told] = np.sqrt((off[counted] ** 2).sum() / freedom / EFFICIENCY)
    return np.where(off < OUTLIER * sigmas, 1 / sigmas**2, 0.0)


def _system(bundle: Bundle, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The reduced system (D,D) with all that is known of positions and attitudes; the points' inverse blocks and each
    observation's coupling, as bundle_cpu.reduce gives them."""
    size = POSE * len(bundle.centres) + bundle.lenses.size
    system = np.zeros((size, size))
    # No point is known to less than FAR: a ray alone, or two side by side, would leave a block without an inverse.
    known = np.full_like(bundle.points, (FAR * np.ptp(bundle.centres, axis=0).max(initial=1e-6)) ** -2)
    known[bundle.control] += 1 / bundle.control_sigmas**2
    inverses, _, coupling = bundle_cpu.reduce(
        bundle.rotations, bundle.centres, bundle.lenses, bundle.lens_of, bundle.points, bundle.photo, bundle.starts,
        bundle.pixels, weights, 0.0, known, np.zeros_like(known), system, np.zeros(size),
    )
    system = np.tril(system) + np.tril(system, -1).T
    poses = np.column_stack([np.repeat(bundle.attitude_sigmas[:, None], 3, axis=1), bundle.position_sigmas])
    system[np.diag_indices(poses.size)] += 1 / poses.ravel() ** 2
    return system, inverses, coupling


def _with_lenses(system: np.ndarray, lens_sigmas: np.ndarray) -> np.ndarray:
    """The system with what is known of the lenses, by sigmas (L,9)."""
    result, at = system.copy(), np.arange(len(system) - lens_sigmas.size, len(system))
    result[at, at] += 1 / lens_sigmas.ravel() ** 2
    return result


def _of_held_lenses(system: np.ndarray, cameras: np.ndarray, held: np.ndarray, known: np.ndarray) -> np.ndarray:
    """(D,D) what parameters of lenses that were held fast, with sigmas (L,9) smaller than what is `known` of them, add
    to the covariance of cameras (Schmidt 1966)."""
    first = len(system) - held.size
    at = first + np.flatnonzero((held < known).ravel())
    open_ = np.sqrt(np.diag(_inverse(_with_lenses(system, known)))[at])
    sigmas = known.ravel()[at - first]
    # What the photos hardly know was left at what is known of it, and is off by as much.
    off = np.where(open_ > LEFT_OPEN * sigmas, sigmas, open_)
    follows = -cameras @ system[:, at]
    follows[at] = np.eye(len(at))
    return np.asarray((follows * off**2) @ follows.T)


def _inverse(system: np.ndarray) -> np.ndarray:
    units = 1 / np.sqrt(np.maximum(np.diag(system), 1e-30))  # what is held fast weighs 1e18 times what is not
    factor = cho_factor(system * np.outer(units, units), overwrite_a=True)
    return np.asarray(cho_solve(factor, np.diag(units)) * units[:, None])


def _similarity_of(offsets: np.ndarray) -> np.ndarray:
    """(P,3,7) how places at offsets (P,3) from the middle follow a shift, a small turn, a relative change of scale."""
    x, y, z = offsets.T
    o, one = np.zeros_like(x), np.ones_like(x)
    rows = [[one, o, o, o, z, -y, x], [o, one, o, -z, o, x, y], [o, o, one, y, -x, o, z]]
    return np.ascontiguousarray(np.array(rows).transpose(2, 0, 1))


def _similarities(bundle: Bundle, middle: np.ndarray) -> np.ndarray:
    """(D,7) how the cameras follow the same."""
    photos = len(bundle.centres)
    moves = np.zeros((POSE * photos + bundle.lenses.size, SIMILARITY))
    poses = moves[: POSE * photos].reshape(photos, POSE, SIMILARITY)
    poses[:, :3, 3:6] = -bundle.rotations
    poses[:, 3:] = _similarity_of(bundle.centres - middle)
    return moves


def _gauge(moves: np.ndarray, system: np.ndarray) -> np.ndarray:
    """What holds the datum of a free network, without a word on its shape."""
    basis = np.linalg.qr(moves)[0]
    return np.asarray(basis @ basis.T * np.median(np.diag(system)))


def _shared(bundle: Bundle) -> np.ndarray:
    """(D,D) what positions that err alike add to the variance of their gradient, which is their information."""
    photos = len(bundle.centres)
    result = np.zeros((POSE * photos + bundle.lenses.size,) * 2)
    told = np.isfinite(bundle.position_sigmas)
    off = np.where(told, -bundle.positions_off / bundle.position_sigmas, 0.0)
    kept = _kept(off[told.any(axis=1)])
    for axis in range(3):
        photo = np.flatnonzero(told[:, axis])
        sigma, at = bundle.position_sigmas[photo, axis], POSE * photo + 3 + axis
        alike = kept ** np.abs(photo[:, None] - photo[None])
        result[np.ix_(at, at)] = (alike + 1 - np.eye(len(photo))) / np.outer(sigma, sigma)
    return result


def _kept(off: np.ndarray) -> float:
    """The share of a position's error that the next photo's keeps, from residuals (N,3) in sigmas in the order of the
    photos; mended for what the adjustment has taken from them (Kendall 1954)."""
    off = np.clip(off, -3, 3)
    count = len(off)
    if count < 8:
        return 0.0
    found = float((off[1:] * off[:-1]).sum() / max((off**2).sum(), 1e-12))
    return float(np.clip((count * found + 1) / (count - 4), 0.0, 0.98))
