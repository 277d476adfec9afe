# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The loops of the bundle adjustment that a CPU runs as machine code: projections and the reduced camera system."""

from __future__ import annotations

import numpy as np
from numba import njit

POSE, LENS = 6, 9  # parameters of a photo (turn, centre) and of a lens (see bundle.LENS_PARAMETERS)


@njit(nogil=True, error_model="numpy")
def project(
    rotation: np.ndarray, centre: np.ndarray, lens: np.ndarray, point: np.ndarray, pixel: np.ndarray,
    by_pose: np.ndarray, by_lens: np.ndarray, by_point: np.ndarray,
) -> bool:
    """Fill the pixel (2,) of a point and its derivatives (2,6), (2,9), (2,3); False for a point behind the camera.

    A photo's turn is a small rotation of camera coordinates, x -> x + turn x x; its centre is in the world.
    """
    offset = point - centre
    x, y, z = rotation @ offset
    if z <= 1e-9:
        return False
    f, a, cx, cy, k1, k2, p1, p2, k3 = lens
    u, v = x / z, y / z
    r2 = u * u + v * v
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of radial by r2
    du = u * radial + 2 * p1 * u * v + p2 * (r2 + 2 * u * u)
    dv = v * radial + p1 * (r2 + 2 * v * v) + 2 * p2 * u * v
    pixel[0], pixel[1] = f * du + cx, f * a * dv + cy
    # of (du, dv) by (u, v)
    uu = radial + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u
    uv = 2 * u * v * slope + 2 * p1 * u + 2 * p2 * v
    vv = radial + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u
    for row in range(2):
        scale = f if row == 0 else f * a
        by_u, by_v = (uu, uv) if row == 0 else (uv, vv)
        jx, jy = scale * by_u / z, scale * by_v / z
        jz = -(jx * u + jy * v)
        by_pose[row, 0] = jz * y - jy * z
        by_pose[row, 1] = jx * z - jz * x
        by_pose[row, 2] = jy * x - jx * y
        for axis in range(3):
            by_point[row, axis] = jx * rotation[0, axis] + jy * rotation[1, axis] + jz * rotation[2, axis]
            by_pose[row, 3 + axis] = -by_point[row, axis]
    by_lens[:] = 0
    by_lens[0, 0], by_lens[1, 0] = du, a * dv
    by_lens[1, 1] = f * dv
    by_lens[0, 2] = by_lens[1, 3] = 1
    for row in range(2):
        scale, w = (f, u) if row == 0 else (f * a, v)
        by_lens[row, 4], by_lens[row, 5], by_lens[row, 8] = scale * w * r2, scale * w * r2 * r2, scale * w * r2**3
    by_lens[0, 6], by_lens[0, 7] = 2 * f * u * v, f * (r2 + 2 * u * u)
    by_lens[1, 6], by_lens[1, 7] = f * a * (r2 + 2 * v * v), 2 * f * a * u * v
    return True


@njit(nogil=True, error_model="numpy")
def residuals(
    rotations: np.ndarray, centres: np.ndarray, lenses: np.ndarray, lens_of: np.ndarray, points: np.ndarray,
    photo: np.ndarray, point: np.ndarray, pixels: np.ndarray,
) -> np.ndarray:
    """(M,2) pixels from each observation to where its point falls; infinite where it lies behind the camera."""
    result = np.full(pixels.shape, np.inf)
    at, by_pose, by_lens, by_point = np.empty(2), np.empty((2, POSE)), np.empty((2, LENS)), np.empty((2, 3))
    for i in range(len(photo)):
        n = photo[i]
        if project(rotations[n], centres[n], lenses[lens_of[n]], points[point[i]], at, by_pose, by_lens, by_point):
            result[i] = at - pixels[i]
    return result


@njit(nogil=True, error_model="numpy")
def _inverse3(m: np.ndarray, out: np.ndarray) -> None:
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * A + b * B + c * C
    out[0, 0], out[0, 1], out[0, 2] = A / det, B / det, C / det
    out[1, 0], out[1, 1], out[1, 2] = B / det, (a * f - c * c) / det, (b * c - a * e) / det
    out[2, 0], out[2, 1], out[2, 2] = C / det, (b * c - a * e) / det, (a * d - b * b) / det


# Long: one loop over the points; its small products are written out, since a call for each takes longer than it.
@njit(nogil=True, error_model="numpy")
def reduce(
    rotations: np.ndarray, centres: np.ndarray, lenses: np.ndarray, lens_of: np.ndarray, points: np.ndarray,
    photo: np.ndarray, starts: np.ndarray, pixels: np.ndarray, weights: np.ndarray, damping: float,
    known: np.ndarray, off: np.ndarray, system: np.ndarray, gradient: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add the observations to the reduced system of photos and lenses, the points eliminated (Schur complement).

    Observations are sorted by point: those of point p are `starts[p]` to `starts[p + 1]`. `weights` (M,) are inverse
    variances. `known` (P,3) are those of the points' own coordinates, which lie `off` (P,3) from the points. `system`
    (D,D), its lower triangle, and `gradient` (D,) are filled in place, D = 6 photos + 9 lenses. Returns the points'
    inverse blocks (P,3,3), their gradients (P,3), and each observation's coupling of photo and lens with its point
    (M,15,3).
    """
    count, first_lens, kinds = len(points), POSE * len(rotations), len(lenses)
    inverses, pulls = np.zeros((count, 3, 3)), np.zeros((count, 3))
    coupling = np.zeros((len(photo), POSE + LENS, 3))
    at, by_pose, by_lens, by_point = np.empty(2), np.empty((2, POSE)), np.empty((2, LENS)), np.empty((2, 3))
    both, left, lens_left = np.empty((2, POSE + LENS)), np.empty((POSE, 3)), np.empty((LENS, 3))
    of_lens, touched = np.zeros((kinds, LENS, 3)), np.zeros(kinds, np.bool_)
    block, force = np.zeros((3, 3)), np.zeros(3)
    for p in range(count):
        block[:], force[:] = 0, 0
        for i in range(starts[p], starts[p + 1]):
            n = photo[i]
            k = lens_of[n]
            weight = weights[i]
            if weight == 0 or not project(rotations[n], centres[n], lenses[k], points[p], at, by_pose, by_lens,
                                          by_point):
                continue
            touched[k] = True
            a, m = POSE * n, first_lens + LENS * k
            for row in range(2):
                for c in range(POSE):
                    both[row, c] = by_pose[row, c]
                for c in range(LENS):
                    both[row, POSE + c] = by_lens[row, c]
            ex, ey = at[0] - pixels[i, 0], at[1] - pixels[i, 1]
            for r in range(3):
                for c in range(3):
                    block[r, c] += weight * (by_point[0, r] * by_point[0, c] + by_point[1, r] * by_point[1, c])
                force[r] -= weight * (by_point[0, r] * ex + by_point[1, r] * ey)
            for r in range(POSE + LENS):
                jx, jy = weight * both[0, r], weight * both[1, r]
                for c in range(3):
                    coupling[i, r, c] = jx * by_point[0, c] + jy * by_point[1, c]
                row = a + r if r < POSE else m + r - POSE
                gradient[row] -= jx * ex + jy * ey
                for c in range(r + 1):
                    column = a + c if c < POSE else m + c - POSE
                    system[row, column] += jx * both[0, c] + jy * both[1, c]
            for r in range(LENS):
                for c in range(3):
                    of_lens[k, r, c] += coupling[i, POSE + r, c]
        for axis in range(3):
            block[axis, axis] = (block[axis, axis] + known[p, axis]) * (1 + damping) + 1e-12
            force[axis] += known[p, axis] * off[p, axis]
            pulls[p, axis] = force[axis]
        inverse = inverses[p]
        _inverse3(block, inverse)
        for i in range(starts[p], starts[p + 1]):
            a = POSE * photo[i]
            for r in range(POSE):
                for c in range(3):
                    left[r, c] = (coupling[i, r, 0] * inverse[0, c] + coupling[i, r, 1] * inverse[1, c]
                                  + coupling[i, r, 2] * inverse[2, c])
                gradient[a + r] -= left[r, 0] * force[0] + left[r, 1] * force[1] + left[r, 2] * force[2]
            for j in range(starts[p], starts[p + 1]):
                b = POSE * photo[j]
                if b > a:
                    continue
                for r in range(POSE):
                    for c in range(POSE):
                        system[a + r, b + c] -= (left[r, 0] * coupling[j, c, 0] + left[r, 1] * coupling[j, c, 1]
                                                 + left[r, 2] * coupling[j, c, 2])
            for k in range(kinds):
                if touched[k]:
                    m = first_lens + LENS * k
                    for c in range(LENS):
                        for r in range(POSE):
                            system[m + c, a + r] -= (left[r, 0] * of_lens[k, c, 0] + left[r, 1] * of_lens[k, c, 1]
                                                     + left[r, 2] * of_lens[k, c, 2])
        for k in range(kinds):
            if not touched[k]:
                continue
            m = first_lens + LENS * k
            for r in range(LENS):
                for c in range(3):
                    lens_left[r, c] = (of_lens[k, r, 0] * inverse[0, c] + of_lens[k, r, 1] * inverse[1, c]
                                       + of_lens[k, r, 2] * inverse[2, c])
                gradient[m + r] -= lens_left[r, 0] * force[0] + lens_left[r, 1] * force[1] + lens_left[r, 2] * force[2]
            for q in range(k + 1):
                if touched[q]:
                    for r in range(LENS):
                        for c in range(LENS):
                            system[m + r, first_lens + LENS * q + c] -= (
                                lens_left[r, 0] * of_lens[q, c, 0] + lens_left[r, 1] * of_lens[q, c, 1]
                                + lens_left[r, 2] * of_lens[q, c, 2])
        for k in range(kinds):
            if touched[k]:
                touched[k] = False
                of_lens[k] = 0
    return inverses, pulls, coupling


@njit(nogil=True, error_model="numpy")
def move_points(
    photo: np.ndarray, lens_of: np.ndarray, starts: np.ndarray, photos: int, inverses: np.ndarray, pulls: np.ndarray,
    coupling: np.ndarray, step: np.ndarray,
) -> np.ndarray:
    """(P,3) how far the points move when photos and lenses take their step (D,)."""
    moved, force = np.empty((len(inverses), 3)), np.empty(3)
    for p in range(len(inverses)):
        force[:] = pulls[p]
        for i in range(starts[p], starts[p + 1]):
            a, m = POSE * photo[i], POSE * photos + LENS * lens_of[photo[i]]
            for r in range(POSE + LENS):
                along = step[a + r] if r < POSE else step[m + r - POSE]
                for c in range(3):
                    force[c] -= coupling[i, r, c] * along
        for c in range(3):
            moved[p, c] = inverses[p, c, 0] * force[0] + inverses[p, c, 1] * force[1] + inverses[p, c, 2] * force[2]
    return moved


@njit(nogil=True, error_model="numpy")
def _followed(
    p: int, photo: np.ndarray, lens_of: np.ndarray, starts: np.ndarray, photos: int, inverse: np.ndarray,
    coupling: np.ndarray, at: np.ndarray, follows: np.ndarray,
) -> int:
    """Fill, for the photos and lenses that see point p, the numbers `at` of their parameters in the system and how the
    point follows each of them, `follows` (n,3); n."""
    first_lens, n = POSE * photos, 0
    for i in range(starts[p], starts[p + 1]):
        m = first_lens + LENS * lens_of[photo[i]]
        for r in range(POSE + LENS):
            if r < POSE:
                row, slot = POSE * photo[i] + r, n + r
            elif r == POSE:
                n += POSE
                row, slot = m, 0
                while slot < n and at[slot] != m:
                    slot += 1
                if slot == n:
                    n += LENS
                    follows[slot:n] = 0
            else:
                row, slot = row + 1, slot + 1
            if r < POSE:
                follows[slot] = 0
            at[slot] = row
            for axis in range(3):
                follows[slot, axis] -= (inverse[axis, 0] * coupling[i, r, 0] + inverse[axis, 1] * coupling[i, r, 1]
                                        + inverse[axis, 2] * coupling[i, r, 2])
    return n


@njit(nogil=True, error_model="numpy")
def shape_response(
    photo: np.ndarray, lens_of: np.ndarray, starts: np.ndarray, photos: int, inverses: np.ndarray,
    coupling: np.ndarray, of_points: np.ndarray, size: int,
) -> np.ndarray:
    """(7,D) the sum over points of their similarity's (P,3,7) transpose times how they follow photos and lenses."""
    result = np.zeros((of_points.shape[2], size))
    longest = (POSE + LENS) * np.max(starts[1:] - starts[:-1])
    at, follows = np.empty(longest, np.int64), np.empty((longest, 3))
    for p in range(len(inverses)):
        n = _followed(p, photo, lens_of, starts, photos, inverses[p], coupling, at, follows)
        for i in range(n):
            for k in range(len(result)):
                for axis in range(3):
                    result[k, at[i]] += of_points[p, axis, k] * follows[i, axis]
    return result


@njit(nogil=True, error_model="numpy")
def point_covariances(
    photo: np.ndarray, lens_of: np.ndarray, starts: np.ndarray, photos: int, inverses: np.ndarray,
    coupling: np.ndarray, of_points: np.ndarray, cameras: np.ndarray, through: np.ndarray, datum: np.ndarray,
    by_rays: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """(P,3,3) of the points, and of what is left after the similarity (7) of the points is taken off.

    `cameras` (D,D) is the covariance of photos and lenses, `through` (D,7) theirs with the similarity, `datum` (7,7)
    the similarity's own; `by_rays` (P,3,3) is what the points' own observations contribute.
    """
    count, kinds = len(inverses), datum.shape[0]
    points, shapes = np.empty((count, 3, 3)), np.empty((count, 3, 3))
    longest = (POSE + LENS) * np.max(starts[1:] - starts[:-1])
    at, follows = np.empty(longest, np.int64), np.empty((longest, 3))
    own, cross, with_similarity = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, kinds))
    for p in range(count):
        n = _followed(p, photo, lens_of, starts, photos, inverses[p], coupling, at, follows)
        own[:], with_similarity[:] = by_rays[p], 0
        for i in range(n):
            for k in range(kinds):
                for axis in range(3):
                    with_similarity[axis, k] += follows[i, axis] * through[at[i], k]
            for j in range(n):
                value = cameras[at[i], at[j]]
                for r in range(3):
                    for c in range(3):
                        own[r, c] += follows[i, r] * value * follows[j, c]
        cross[:] = with_similarity @ of_points[p].T
        points[p] = own
        shapes[p] = own - cross - cross.T + of_points[p] @ datum @ of_points[p].T
    return points, shapes
