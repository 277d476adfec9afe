# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundle adjustment with all that is known: observations, positions, attitudes and lenses, each with its sigma.

Gauss-Newton with Levenberg-Marquardt damping on the system reduced to photos and lenses (Triggs et al. 2000). COLMAP's
adjustment knows positions only, and no prior of a lens.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from . import bundle_cpu
from .bundle_cpu import LENS, POSE

# f in pixels, fy / fx, cx, cy in pixels, and OpenCV's distortion.
LENS_PARAMETERS = ("f", "aspect", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TOGETHER = 3.0  # features of one flight err in common: by the lens's formula, the shutter, the matching
MOST_STEPS = 60
CONVERGED = 1e-5  # relative change of the cost
_LEAST_SIGMA = 0.25  # pixels; no feature is found more exactly
CAUCHY = 2.0  # sigmas of a residual from where on it counts less and less
_EASE = 5.0  # by which control's sigmas fall from step to step until they are as stated
_SETTLING = 5  # steps of the similarity
_LEAST_DAMPING, _MOST_DAMPING = 1e-12, 1e6


@dataclass(frozen=True, kw_only=True)
class Bundle:
    """Cameras and points with their observations, and what is known beforehand. World in metres, pixel centres at .5.

    `rotations` (N,3,3) cam_from_world and `centres` (N,3) of the photos, `lens_of` (N,) the lens of each; `lenses`
    (L,9) by LENS_PARAMETERS; `points` (P,3). Observations are sorted by point: `photo`, `point` (M,), `pixels` (M,2).

    Known with its sigma, infinite where it is not: `positions` (N,3), of receivers that state their accuracy, or of the
    kinds `receivers` (N,), 0 where it is not stated;
    with `apart` they tell only how photos lie to each other, since all may be off by another datum or a receiver's
    error; `attitudes` (N,3,3) cam_from_world with one sigma (N,) in radians; `known_lenses` (L,9). Control: `control`
    (C,) are the numbers of points whose place is known, `control_positions` and `control_sigmas` (C,3); their marks are
    observations like others. `observation_sigmas` (M,) in pixels are of one coordinate; nan, or the field None, where
    the residuals tell, and then `together` is by how much they are too small for what all of them tell together.
    """

    rotations: np.ndarray
    centres: np.ndarray
    lens_of: np.ndarray
    lenses: np.ndarray
    points: np.ndarray
    photo: np.ndarray
    point: np.ndarray
    pixels: np.ndarray
    positions: np.ndarray
    position_sigmas: np.ndarray
    attitudes: np.ndarray
    attitude_sigmas: np.ndarray
    known_lenses: np.ndarray
    lens_sigmas: np.ndarray
    control: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    control_positions: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    control_sigmas: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    observation_sigmas: np.ndarray | None = None
    receivers: np.ndarray | None = None
    apart: bool = False
    together: float = TOGETHER

    @property
    def starts(self) -> np.ndarray:
        """(P+1,) where each point's observations begin."""
        return np.searchsorted(self.point, np.arange(len(self.points) + 1))

    @property
    def positions_off(self) -> np.ndarray:
        """(N,3) metres from each photo to its known position, without what all are off where they tell `apart` only."""
        off = np.asarray(self.positions - self.centres)
        if not self.apart:
            return off
        for axis in range(3):
            known = np.isfinite(self.position_sigmas[:, axis])
            if known.any():
                mine, sigmas = off[known, axis], self.position_sigmas[known, axis]
                common = float(np.median(mine))
                for _ in range(5):
                    common = float(np.average(mine, weights=_weights((mine - common) / sigmas) / sigmas**2))
                off[:, axis] -= common
        return off

    @property
    def control_off(self) -> np.ndarray:
        """(C,3) metres from each control point to where it is known to lie."""
        return self.control_positions - self.points[self.control]

    def without(self, observations: np.ndarray) -> Bundle:
        """The bundle without some of its observations (M,)."""
        told = None if self.observation_sigmas is None else self.observation_sigmas[~observations]
        return replace(self, photo=self.photo[~observations], point=self.point[~observations],
                       pixels=self.pixels[~observations], observation_sigmas=told)

    def observing(self, other: Bundle) -> Bundle:
        """The bundle with the observations of another."""
        return replace(self, photo=other.photo, point=other.point, pixels=other.pixels,
                       observation_sigmas=other.observation_sigmas)

    def sigmas(self) -> np.ndarray:
        """(M,) of one coordinate of each observation, pixels."""
        told = np.full(len(self.photo), np.nan) if self.observation_sigmas is None else self.observation_sigmas
        return np.where(np.isnan(told), robust_sigma(self), told)

    def residuals(self) -> np.ndarray:
        """(M,2) pixels from each observation to where its point falls; infinite behind a camera."""
        return np.asarray(bundle_cpu.residuals(
            self.rotations, self.centres, self.lenses, self.lens_of, self.points, self.photo, self.point, self.pixels
        ))


def adjust(
    bundle: Bundle, progress: Callable[[], None] = lambda: None, converged: float = CONVERGED
) -> Bundle:
    """Adjust everything in a bundle until a step gains less than the share `converged` of the cost. `progress` is
    called at each step, and may raise to end it.

    Observations and positions count less the farther they are off (Cauchy), so that outliers do not pull; and no
    position's sigma is taken for less than the residuals show it to be. Control pulls harder from step to step, or its
    points would go alone and leave their marks behind. Without positions the damping keeps the datum where it is.
    """
    damping, steps = 1e-6, 0
    stated, ease = bundle, float(np.abs(bundle.control_off).max(initial=0.0))
    bundle, sigmas = settled(_weighed(bundle, stated, ease)), bundle.sigmas()
    cost = _cost(bundle, sigmas)
    while steps < MOST_STEPS and damping < _MOST_DAMPING:
        progress()
        steps += 1
        system, gradient, blocks = _normal_equations(bundle, sigmas, damping)
        try:
            step = _solve(system, gradient, damping)
        except LinAlgError:  # not positive definite by rounding: more damping mends it
            damping *= 10
            continue
        moved = _stepped(bundle, step, blocks)
        new_cost = _cost(moved, sigmas)
        if not new_cost < cost:
            damping *= 10
            continue
        gain, bundle, damping = (cost - new_cost) / cost, moved, max(damping / 10, _LEAST_DAMPING)
        if gain < converged and not (ease > stated.control_sigmas).any():
            break
        ease /= _EASE
        bundle, sigmas = settled(_weighed(bundle, stated, ease)), bundle.sigmas()
        cost = _cost(bundle, sigmas)
    return bundle


def fit_points(bundle: Bundle) -> Bundle:
    """The bundle with its points where their observations meet best, seen by the cameras as they are."""
    still = np.zeros(POSE * len(bundle.centres) + LENS * len(bundle.lenses))
    for _ in range(5):
        _, _, blocks = _normal_equations(bundle, bundle.sigmas(), 1e-6)
        bundle = _stepped(bundle, still, blocks)
    return bundle


def _weighed(bundle: Bundle, stated: Bundle, ease: float) -> Bundle:
    """The bundle with its positions' sigmas no smaller than the residuals show them to be, heights apart from plan, and
    those of its control no smaller than `ease` metres."""
    bundle = replace(bundle, control_sigmas=np.maximum(stated.control_sigmas, ease))
    known, least = np.isfinite(stated.position_sigmas), np.zeros_like(stated.position_sigmas)
    off = np.abs(bundle.positions_off)
    # A similarity of the whole takes up some of them where they are few.
    taken = np.sqrt(known.sum() / max(known.sum() - 7, 1))
    receivers = np.zeros(len(known), int) if bundle.receivers is None else bundle.receivers
    for kind in np.unique(receivers):
        plan, height = (known[:, axis] & (receivers == kind) for axis in (0, 2))
        if plan.any():
            least[plan, :2] = taken * np.median(np.hypot(off[plan, 0], off[plan, 1])) / 1.1774
        if height.any():
            least[height, 2] = taken * np.median(off[height, 2]) / 0.6745
    return replace(bundle, position_sigmas=np.maximum(stated.position_sigmas, least))


def posterior_sigmas(bundle: Bundle) -> np.ndarray:
    """(L,9) what the adjustment leaves open of each lens parameter, from the inverse of the reduced system."""
    system, *_ = _normal_equations(bundle, bundle.sigmas(), 1e-9)  # with 0, a point as good as at infinity spoils it
    units = 1 / np.sqrt(np.maximum(np.diag(system), 1e-30))
    scaled = system * np.outer(units, units)
    scaled[np.diag_indices(len(system))] = 1 + 1e-10  # the datum, where nothing is known of it
    lenses = np.arange(POSE * len(bundle.centres), len(system))
    columns = np.zeros((len(system), len(lenses)))
    columns[lenses, np.arange(len(lenses))] = 1
    inverse = cho_solve(cho_factor(scaled), columns)[lenses, np.arange(len(lenses))]
    return np.asarray((units[lenses] * np.sqrt(np.maximum(inverse, 0))).reshape(bundle.lenses.shape))


def robust_sigma(bundle: Bundle) -> float:
    """Of one coordinate of an observation whose sigma is not told, in pixels: from the median, since outliers are among
    them."""
    off = np.abs(bundle.residuals())
    if bundle.observation_sigmas is not None:
        off = off[np.isnan(bundle.observation_sigmas)]
    # Points take up residuals: of an observation's two coordinates, those that are free remain.
    free = 1 - 3 * len(bundle.points) / (2 * max(len(off), 1))
    return max(1.4826 * float(np.median(off)) / np.sqrt(max(free, 0.1)), _LEAST_SIGMA)


def _weights(off: np.ndarray) -> np.ndarray:
    """Cauchy weights of distances (n,) in sigmas; 0 where infinite."""
    return 1 / (1 + (off / CAUCHY) ** 2)


def _counted(bundle: Bundle) -> np.ndarray:
    """(M,) of how much each observation counts: less than its sigma says, where it is one of the many that err together
    by what the lens's formula, the shutter and the matching have in common."""
    if bundle.observation_sigmas is None:
        return np.full(len(bundle.photo), bundle.together**-2)
    return np.where(np.isnan(bundle.observation_sigmas), bundle.together**-2, 1.0)


def _loss(off: np.ndarray, counted: np.ndarray | float = 1.0) -> float:
    """Cauchy's loss of distances (n,) in sigmas; a point behind a camera costs what one very far off does."""
    return float(np.sum(counted * CAUCHY**2 * np.log1p((np.minimum(off, 1e6) / CAUCHY) ** 2)))


def _cost(bundle: Bundle, sigmas: np.ndarray) -> float:
    observed = _loss(np.linalg.norm(bundle.residuals(), axis=1) / sigmas, _counted(bundle))
    lenses = float(np.sum(((bundle.lenses - bundle.known_lenses) / bundle.lens_sigmas) ** 2))
    return observed + lenses + _cost_of_datum(bundle)


def _cost_of_datum(bundle: Bundle) -> float:
    positions = _loss(np.linalg.norm(bundle.positions_off / bundle.position_sigmas, axis=1))
    attitudes = _loss(np.linalg.norm(_turns(bundle), axis=1) / bundle.attitude_sigmas)
    return positions + attitudes + float(np.sum((bundle.control_off / bundle.control_sigmas) ** 2))


def settled(bundle: Bundle) -> Bundle:
    """The bundle moved as a whole, by the similarity that fits best to positions, control and attitudes.

    It changes no residual of an observation, but is no straight line in the photos' turns and places: left to the
    common steps, these would have to be short.
    """
    known = np.isfinite(bundle.position_sigmas[:, 0])
    if known.sum() + len(bundle.control) < 3:
        return bundle
    for _ in range(_SETTLING):
        middle = bundle.centres.mean(axis=0)
        off = bundle.positions_off[known]
        weights = _weights(np.linalg.norm(off / bundle.position_sigmas[known], axis=1))
        places = np.concatenate([bundle.centres[known], bundle.points[bundle.control]]) - middle
        off = np.concatenate([off, bundle.control_off])
        weights = np.concatenate([weights[:, None] / bundle.position_sigmas[known] ** 2, bundle.control_sigmas**-2.0])
        # By a turn, a shift and the logarithm of the scale; a turn moves a place by turn x place.
        x, y, z = places.T
        nought = np.zeros_like(x)
        cross = np.stack([nought, z, -y, -z, nought, x, y, -x, nought], axis=1).reshape(-1, 3, 3)
        slopes = np.concatenate([cross, np.broadcast_to(np.eye(3), cross.shape), places[:, :, None]], axis=2)
        if bundle.apart:
            gps, own = slopes[: known.sum()], weights[: known.sum()]
            slopes = np.concatenate([gps - _common(gps, own), slopes[known.sum() :]])
        system = np.einsum("nia,ni,nib->ab", slopes, weights, slopes)
        gradient = np.einsum("nia,ni,ni->a", slopes, weights, off)
        turns = _turns(bundle)
        weights = _weights(np.linalg.norm(turns, axis=1) / bundle.attitude_sigmas) / bundle.attitude_sigmas**2
        system[:3, :3] += np.einsum("nai,n,nib->ab", bundle.rotations.transpose(0, 2, 1), weights, bundle.rotations)
        gradient[:3] += np.einsum("nia,n,ni->a", bundle.rotations, weights, turns)
        units = 1 / np.sqrt(np.maximum(np.diag(system), 1e-30))
        damped = system * np.outer(units, units) + 1e-9 * np.eye(7)
        step = units * np.linalg.solve(damped, units * gradient)
        turn, scale = Rotation.from_rotvec(step[:3]).as_matrix(), np.exp(step[6])
        moved = replace(
            bundle, rotations=bundle.rotations @ turn.T,
            centres=scale * (bundle.centres - middle) @ turn.T + middle + step[3:6],
            points=scale * (bundle.points - middle) @ turn.T + middle + step[3:6],
        )
        if not _cost_of_datum(moved) < _cost_of_datum(bundle):
            break
        bundle = moved
    return bundle


def _common(slopes: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(3,A) the weighted mean of slopes (N,3,A) by axis, weights (N,3)."""
    return np.asarray(np.einsum("nia,ni->ia", slopes, weights) / np.maximum(weights.sum(axis=0), 1e-300)[:, None])


def _turns(bundle: Bundle) -> np.ndarray:
    """(N,3) the small rotation of camera coordinates from each known attitude to the photo's own, radians."""
    return np.asarray(Rotation.from_matrix(bundle.rotations @ bundle.attitudes.transpose(0, 2, 1)).as_rotvec())


def _normal_equations(
    bundle: Bundle, sigmas: np.ndarray, damping: float
) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The reduced system (D,D), its gradient (D,), and what moving the points needs."""
    photos, size = len(bundle.centres), POSE * len(bundle.centres) + LENS * len(bundle.lenses)
    system, gradient = np.zeros((size, size)), np.zeros(size)
    off = np.linalg.norm(bundle.residuals(), axis=1) / sigmas
    weights = np.where(np.isfinite(off), _counted(bundle) * _weights(off) / sigmas**2, 0.0)
    known, toward = np.zeros_like(bundle.points), np.zeros_like(bundle.points)
    known[bundle.control], toward[bundle.control] = 1 / bundle.control_sigmas**2, bundle.control_off
    blocks = bundle_cpu.reduce(
        bundle.rotations, bundle.centres, bundle.lenses, bundle.lens_of, bundle.points, bundle.photo, bundle.starts,
        bundle.pixels, weights, damping, known, toward, system, gradient,
    )
    diagonal = np.zeros(size)
    off = bundle.positions_off
    known = _weights(np.linalg.norm(off / bundle.position_sigmas, axis=1))[:, None] / bundle.position_sigmas**2
    at = POSE * np.arange(photos)[:, None]
    diagonal[at + [3, 4, 5]] += known
    gradient[at + [3, 4, 5]] += known * off
    positions, off_positions = known, off
    turns = _turns(bundle)
    known = _weights(np.linalg.norm(turns, axis=1) / bundle.attitude_sigmas) / bundle.attitude_sigmas**2
    diagonal[at + [0, 1, 2]] += known[:, None]
    gradient[at + [0, 1, 2]] -= known[:, None] * turns
    known = 1 / bundle.lens_sigmas**2
    diagonal[POSE * photos :] += known.ravel()
    gradient[POSE * photos :] += (known * (bundle.known_lenses - bundle.lenses)).ravel()
    system = np.tril(system) + np.tril(system, -1).T
    system[np.diag_indices(size)] += diagonal
    if bundle.apart:  # their common offset is one more unknown, which is reduced
        for axis in range(3):
            rows, own = POSE * np.arange(photos) + 3 + axis, positions[:, axis]
            if own.any():
                system[np.ix_(rows, rows)] -= np.outer(own, own) / own.sum()
                gradient[rows] -= own * (own * off_positions[:, axis]).sum() / own.sum()
    return system, gradient, blocks


def _solve(system: np.ndarray, gradient: np.ndarray, damping: float) -> np.ndarray:
    # In units in which the diagonal is one: what is held fast weighs 1e18 times what is not. The damping also holds
    # what nothing determines, such as the datum where no position is known.
    units = 1 / np.sqrt(np.maximum(np.diag(system), 1e-30))
    damped = system * np.outer(units, units)
    damped[np.diag_indices(len(system))] = 1 + damping
    return np.asarray(units * cho_solve(cho_factor(damped, overwrite_a=True), units * gradient))


def _stepped(bundle: Bundle, step: np.ndarray, blocks: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Bundle:
    photos = len(bundle.centres)
    poses, lenses = step[: POSE * photos].reshape(-1, POSE), step[POSE * photos :].reshape(-1, LENS)
    moved = bundle_cpu.move_points(bundle.photo, bundle.lens_of, bundle.starts, photos, *blocks, step)
    return replace(
        bundle, rotations=Rotation.from_rotvec(poses[:, :3]).as_matrix() @ bundle.rotations,
        centres=bundle.centres + poses[:, 3:], lenses=bundle.lenses + lenses, points=bundle.points + moved,
    )
