# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a depth map's error lies: what few sources see, the rims of skies and photos, depth edges, outside of the
sweep. Each pixel belongs to the first class that takes it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from .depth_metrics import DepthRange

CLASSES = ("seen by no source", "seen by one source", "within 8 px of sky or photo edge", "depth edges",
           "outside of the sweep", "everything else")
RIM = 8  # pixels
EDGE = 0.04  # relative difference of depth between neighbours two pixels apart
EDGE_RIM = 4  # pixels on either side of a depth edge
FAR_OFF = 10.0  # intervals


@dataclass(frozen=True, kw_only=True)
class Shares:
    """By class, in CLASSES' order: percent of the `pixels`, its part of the `epe`, and of that the part that comes from
    errors beyond FAR_OFF intervals (`far_off`). `sky`: median confidence where there is no surface (NaN: nowhere)."""

    pixels: np.ndarray
    epe: np.ndarray
    far_off: np.ndarray
    sky: float


def classes(truth: np.ndarray, seen: np.ndarray, near: float, far: float) -> np.ndarray:
    """(H,W) index into CLASSES, from the true z-depth (0: no surface), how many sources see each pixel's surface, and
    where the sweep begins and ends."""
    surface = truth > 0
    inside = np.pad(surface.astype(np.uint8), 1)
    from_hole = cv2.distanceTransform(inside, cv2.DIST_L2, 5)[1:-1, 1:-1]
    logarithm = np.log(np.where(surface, truth, 1.0)).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    jump = cv2.dilate(logarithm, kernel) - cv2.erode(logarithm, kernel) > EDGE
    edge = cv2.dilate(jump.astype(np.uint8), np.ones((2 * EDGE_RIM - 1,) * 2, np.uint8)) > 0
    return np.select([seen == 0, seen == 1, from_hole <= RIM, edge, (truth < near) | (truth > far)],
                     list(range(len(CLASSES) - 1)), len(CLASSES) - 1)


def shares(
    depth: np.ndarray, confidence: np.ndarray, truth: np.ndarray, true_range: DepthRange, of: np.ndarray
) -> Shares:
    """The shares of one map (H,W) with the `classes` of its pixels, over those that it fills."""
    counted = (truth >= true_range.near) & (truth <= true_range.far) & (depth > 0)
    error = np.abs(depth - truth)[counted] / true_range.interval
    of, count = of[counted], len(CLASSES)
    sky = confidence[truth == 0]
    return Shares(pixels=100 * np.bincount(of, minlength=count) / len(of),
                  epe=np.bincount(of, error, count) / len(of),
                  far_off=np.bincount(of, error * (error > FAR_OFF), count) / len(of),
                  sky=float(np.median(sky)) if len(sky) else float("nan"))


def mean_shares(maps: list[Shares]) -> Shares:
    skies = [m.sky for m in maps if not np.isnan(m.sky)]
    return Shares(pixels=np.mean([m.pixels for m in maps], 0), epe=np.mean([m.epe for m in maps], 0),
                  far_off=np.mean([m.far_off for m in maps], 0), sky=float(np.mean(skies)) if skies else float("nan"))


def table(found: Shares) -> str:
    """Lines to print: the classes with their shares."""
    lines = [f"{'':36}{'pixels %':>9}{'of EPE':>9}{f'beyond {FAR_OFF:g}':>11}"]
    lines += [f"  {name:34}{pixels:9.1f}{epe:9.3f}{far:11.3f}"
              for name, pixels, epe, far in zip(CLASSES, found.pixels, found.epe, found.far_off, strict=True)]
    lines.append(f"  {'all':34}{found.pixels.sum():9.1f}{found.epe.sum():9.3f}{found.far_off.sum():11.3f}")
    return "\n".join([*lines, f"  median confidence in skies: {found.sky:.3f}"])
