# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Another program's cloud beside ours, coloured by how far it lies from the reference."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..core.base.errors import WorkspaceError
from ..core.base.language import Text
from ..core.base.ply import read_ply
from ..core.cloud.ply import read_cloud
from . import points
from .workspace import clouds_of

DISTANCE, PHOTO = "distance", "photo"
_MATERIAL = "CU-Recon Comparison"
_OWN = "own_colour"  # the attribute that keeps a cloud's own colours
_NEAR_TO_FAR = np.array([[44, 123, 182], [171, 217, 233], [255, 255, 191], [253, 174, 97], [215, 25, 28]], float)
_LOST_TO_CAME = np.array([[178, 24, 43], [244, 165, 130], [225, 225, 225], [146, 197, 222], [33, 102, 172]], float)
_UNKNOWN, _ALIKE = (128, 128, 128), (225, 225, 225)
_BARS = 8  # of the histogram
_HISTOGRAM = "curecon_histogram"  # on the cloud: the least and the greatest distance, and the share in each bar


@dataclass(frozen=True)
class Compared:
    """A cloud as its object stores it; `distance` (N,) float32 from the reference, signed where a change was measured,
    NaN where it could not be; `limit` (N,) the least that is significant, 0 where no change was measured."""

    arrays: points.CloudArrays
    distance: np.ndarray
    limit: np.ndarray


def read(path: Path) -> Compared:
    """A file that `compare` wrote. No bpy: it may run on any thread. Raises WorkspaceError."""
    cloud = read_cloud(path)
    try:
        rows = read_ply(path, ["vertex"])[1]["vertex"]
        distance, limit = rows["distance"].astype(np.float32), rows["limit"].astype(np.float32)
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("{} is not a comparison that CU-Recon wrote.", path), path=path,
                             remedy="Choose one of the files whose names end in .compared.ply.") from error
    order = points.file_order(len(cloud))
    return Compared(points.arrays(cloud), distance[order], limit[order])


def build(content: Compared, name: str, scene: bpy.types.Scene) -> Generator[str, None, bpy.types.Object]:
    """Link the cloud into the scene, where our largest one stands, coloured by distance."""
    stands = clouds_of(scene)
    item = yield from points.build(content.arrays, name, scene.collection)
    del item.data[points.CLOUD_KEY]  # nothing may be taken out of it, or exported as ours
    item.data.materials.clear()
    item.data.materials.append(points.colour_material(_MATERIAL))  # the other one shows what the Cloud panel says
    item.data[points.COMPARED_KEY] = len(content.distance)
    yield from points.fill(item.data, "Making the point cloud", (
        (DISTANCE, "FLOAT", "POINT", "value", content.distance), ("limit", "FLOAT", "POINT", "value", content.limit),
        (_OWN, "FLOAT_COLOR", "POINT", "color", content.arrays.colours),
    ))
    if stands:
        item.matrix_world = stands[0].matrix_world
    colour(item, DISTANCE, farthest(content.distance))
    return item


def is_compared(item: bpy.types.Object | None) -> bool:
    return item is not None and item.type == "POINTCLOUD" and points.COMPARED_KEY in item.data


def farthest(distance: np.ndarray) -> float:
    """A round distance below which nearly all of them (N,) lie."""
    known = np.abs(distance[np.isfinite(distance)])
    if not len(known) or not known.max() > 0:
        return 1.0
    return float(f"{np.percentile(known, 95):.1g}") or float(known.max())


@dataclass(frozen=True)
class Bar:
    """The share of a cloud's points whose distances lie from `low` to `high`; what lies beyond counts at the ends."""

    low: float
    high: float
    share: float


def histogram(item: bpy.types.Object) -> list[Bar]:
    """Of a compared cloud's distances, up to what its last colour stands for."""
    low, high, *shares = item.data[_HISTOGRAM]
    edges = np.linspace(low, high, len(shares) + 1).tolist()
    return [Bar(*bar) for bar in zip(edges[:-1], edges[1:], shares, strict=True)]


def _counted(distance: np.ndarray, limit: np.ndarray, most: float) -> list[float]:
    """As it is kept on the cloud."""
    low, known = (-most if _is_change(limit) else 0.0), distance[np.isfinite(distance)]
    bars = np.histogram(np.clip(known, low, most), _BARS, (low, most))[0]
    return [low, most, *(bars / max(len(known), 1)).tolist()]


def _is_change(limit: np.ndarray) -> bool:
    return bool(np.nan_to_num(limit).any())


def colour(item: bpy.types.Object, by: str, most: float) -> None:
    """Give a compared cloud its own colours, or those of its distances up to `most`, by which they are counted, too."""
    data = item.data
    count = len(data.points)
    shown = np.empty(count * 4, np.float32)
    if by == PHOTO:
        data.attributes[_OWN].data.foreach_get("color", shown)
    else:
        distance, limit = np.empty(count, np.float32), np.empty(count, np.float32)
        data.attributes[DISTANCE].data.foreach_get("value", distance)
        data.attributes["limit"].data.foreach_get("value", limit)
        shown = points.linear_colours(colours_of(distance, limit, most)).ravel()
        data[_HISTOGRAM] = _counted(distance, limit, most)
    data.attributes[points.COLOUR].data.foreach_set("color", shown)
    data.update_tag()


def colours_of(distance: np.ndarray, limit: np.ndarray, most: float) -> np.ndarray:
    """sRGB (N,3) uint8: from near to far; or, where a change was measured, from lost by red to come by blue, pale where
    it is not significant. Grey is not known."""
    change = _is_change(limit)
    place = (distance / most + 1) / 2 if change else np.abs(distance) / most
    ramp = _LOST_TO_CAME if change else _NEAR_TO_FAR
    at = np.clip(np.nan_to_num(place), 0, 1) * (len(ramp) - 1)
    shades = np.stack([np.interp(at, np.arange(len(ramp)), ramp[:, channel]) for channel in range(3)], axis=1)
    with np.errstate(invalid="ignore"):
        shades[change & (np.abs(distance) <= limit)] = _ALIKE
    shades[~np.isfinite(distance)] = _UNKNOWN
    return np.rint(shades).astype(np.uint8)
