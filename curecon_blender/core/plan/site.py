# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The building that a flight is planned for: from a drawn outline, from plain sizes, or from a finished cloud."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from ..base.errors import PlanError
from ..base.geodesy import geodetic_to_enu
from ..base.language import Text
from ..base.reading import parse_json, read_bytes
from ..base.records import GeoPosition
from . import obstacles
from .outlines import area, hull
from .records import Building

MOST_FILE = 5_000_000  # bytes of a drawn outline
MOST_CORNERS = 5_000
MOST_ACROSS = 3_000.0  # metres; a site larger than that is a wrong system or a wrong corner
COLUMN = 1.0  # metres of the columns in which a cloud's building is looked for
_GROUND_SHARE, _HEIGHT_SHARE = 0.05, 0.995
_LOW = 0.35  # of the height: what is lower is no part of the building


def of_size(width: float, depth: float, height: float, *, turn: float = 0.0, eaves: float | None = None,
            origin: GeoPosition | None = None) -> Building:
    """A block, its depth along the heading `turn` in degrees; metres."""
    x, y = width / 2, depth / 2
    corners = np.array([[-x, -y], [x, -y], [x, y], [-x, y]])
    angle = -np.radians(turn)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return _building(corners @ rotation.T, None, height, eaves, origin)


def of_ring(outer: float, inner: float, height: float, *, eaves: float | None = None,
            origin: GeoPosition | None = None) -> Building:
    """A round building with a round court; diameters and heights in metres.

    Raises PlanError where the court is no smaller than the building.
    """
    if inner >= outer:
        raise PlanError(Text("The court's diameter of {:g} m is not smaller than the building's, {:g} m.", inner,
                             outer),
                        remedy="Give the outer diameter first.")
    angles = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return _building(circle * outer / 2, circle * inner / 2, height, eaves, origin)


def of_file(path: Path, height: float, *, eaves: float | None = None) -> Building:
    """A polygon drawn on a map, as GeoJSON or KML; its hole, if it has one, is the court. The origin is its middle.

    Raises PlanError where the file holds no polygon, or one that can be no building.
    """
    try:
        text = read_bytes(path, MOST_FILE).decode("utf-8-sig")
        rings = _geojson(parse_json(text)) if text.lstrip().startswith("{") else _kml(text)
    except (OSError, ValueError, LookupError, TypeError, ElementTree.ParseError) as error:
        raise PlanError(Text("{} cannot be read as a polygon ({}).", path, Text(str(error))),
                        remedy="Draw the outline in a map program and save it as GeoJSON or KML.", path=path) from error
    if not rings:
        raise PlanError(Text("{} holds no polygon.", path),
                        remedy="Draw the outline as an area, not as a line or a point.",
                        path=path)
    if max(len(ring) for ring in rings) > MOST_CORNERS:
        raise PlanError(Text("The outline in {} has more than {} corners.", path,
                             MOST_CORNERS), remedy="Draw it simpler.",
                        path=path)
    places = np.concatenate(rings)
    if not np.isfinite(places).all() or np.abs(places[:, 1]).max() > 90 or np.abs(places[:, 0]).max() > 180:
        raise PlanError(Text("The outline in {} is not in longitude and latitude.", path),
                        remedy="Save it in WGS84 (EPSG:4326), in degrees, longitude first.", path=path)
    first = places[0, 0]
    longitudes = first + (places[:, 0] - first + 180) % 360 - 180  # an outline may lie on both sides of 180 degrees
    longitude = (float(longitudes[: len(rings[0])].mean()) + 180) % 360 - 180
    origin = GeoPosition(latitude=float(rings[0][:, 1].mean()), longitude=longitude, altitude=None)
    local = [geodetic_to_enu(np.c_[ring[:, 1], ring[:, 0], np.zeros(len(ring))], origin)[:, :2] for ring in rings]
    return _building(local[0], local[1] if len(local) > 1 else None, height, eaves, origin)


def of_points(points: np.ndarray, *, height: float | None = None, eaves: float | None = None,
              origin: GeoPosition | None = None) -> Building:
    """The building in the middle of a cloud (N,3) in metres, Z up; all points are obstacles.

    The ground is the cloud's low level. The building is what stands out of it, nearest to the middle and connected.
    Raises PlanError where nothing does.
    """
    above = points - [0, 0, ground_of(points)]
    low, high = np.quantile(above[:, :2], [0.01, 0.99], axis=0)
    above = above[((above[:, :2] >= low) & (above[:, :2] <= high)).all(axis=1)]
    columns = obstacles.of_points(above)
    top = float(np.quantile(columns.tops[columns.tops > 0.5], 0.9)) if (columns.tops > 0.5).any() else 0.0
    if top < 1.5:
        raise PlanError("Nothing stands out of the ground in this cloud.",
                        remedy="Draw the building's outline or give its size.")
    raised = columns.tops > _LOW * top
    chosen = _nearest_part(raised, columns)
    rows, cells = np.nonzero(chosen)
    corners = columns.corner + np.stack([cells, rows], axis=1) * columns.cell
    outline = hull(np.concatenate([corners, corners + columns.cell]))
    inside = columns.tops[chosen]
    found = float(np.quantile(inside, _HEIGHT_SHARE))
    building = _building(outline, _court(chosen, columns), height or found, eaves or float(np.quantile(inside, 0.3)),
                         origin)
    return Building(**{**vars(building), "obstacles": obstacles.joined(building.obstacles, columns)})


def ground_of(points: np.ndarray) -> float:
    """Height of the ground under a cloud (N,3), that heights of its building count from."""
    return float(np.quantile(points[:, 2], _GROUND_SHARE))


def of_outline(outline: np.ndarray, height: float, *, court: np.ndarray | None = None,
               origin: GeoPosition | None = None) -> Building:
    """A block on the hull of places (N,2) that somebody drew, in metres; with the hull of others as its court.

    Raises PlanError where the court is not inside.
    """
    corners = hull(outline)
    inner = None if court is None else hull(court)
    if inner is not None and not obstacles.inside(inner, corners).all():
        raise PlanError("The court does not lie inside of the building.", remedy="Move it inside or make it smaller.")
    return _building(corners, inner, height, None, origin)


def _building(outline: np.ndarray, court: np.ndarray | None, height: float, eaves: float | None,
              origin: GeoPosition | None) -> Building:
    outline = outline if area(outline) > 0 else outline[::-1]
    across = float(np.ptp(outline, axis=0).max())
    if not np.isfinite(across) or across > MOST_ACROSS:
        raise PlanError(Text("The outline is {:.0f} m across.", across),
                        remedy="Check its corners and its units: metres.")
    if court is not None:
        court = court if area(court) > 0 else court[::-1]
    return Building(outline=outline, height=height, eaves=min(eaves or 0.85 * height, height), court=court,
                    origin=origin, obstacles=obstacles.of_outline(outline, height, court))


def _geojson(value: dict[str, Any]) -> list[np.ndarray]:
    """The outer ring of the first polygon and its first hole, if it has one."""
    features = value.get("features", [value])
    for candidate in features if isinstance(features, list) else []:
        shape = candidate.get("geometry", candidate) if isinstance(candidate, dict) else None
        if isinstance(shape, dict) and shape.get("type") in ("Polygon", "MultiPolygon"):
            rings = shape["coordinates"] if shape["type"] == "Polygon" else shape["coordinates"][0]
            return [_ring(ring) for ring in rings[:2]]
    return []


def _kml(text: str) -> list[np.ndarray]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it declares entities")
    for polygon in ElementTree.fromstring(text).iter("{http://www.opengis.net/kml/2.2}Polygon"):
        rings = [element.text or "" for kind in ("outer", "inner")
                 for element in polygon.iterfind(f".//{{*}}{kind}BoundaryIs//{{*}}coordinates")]
        return [_ring([[float(part) for part in place.split(",")] for place in re.split(r"\s+", ring.strip())])
                for ring in rings[:2]]
    return []


def _ring(places: list[list[float]]) -> np.ndarray:
    ring = np.array([place[:2] for place in places], float)
    if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
        raise ValueError("a ring has three corners or more, of two numbers each")
    return ring[:-1] if len(ring) > 1 and (ring[0] == ring[-1]).all() else ring


def _nearest_part(raised: np.ndarray, columns: obstacles.Heights) -> np.ndarray:
    """Of the connected parts of a picture (H,W), the one with the most cells for its distance from the middle."""
    labels = _labels(raised)
    best, chosen = 0.0, raised
    centre = np.array(raised.shape) / 2
    for label in np.unique(labels[labels > 0]):
        part = labels == label
        away = np.linalg.norm(np.argwhere(part).mean(axis=0) - centre) * columns.cell
        worth = part.sum() / (10.0 + away)
        if worth > best:
            best, chosen = worth, part
    return chosen


def _court(chosen: np.ndarray, columns: obstacles.Heights) -> np.ndarray | None:
    """The outline of the largest hole in a part, if it is as large as a court."""
    free = _labels(~np.pad(chosen, 1))
    holes = [label for label in np.unique(free[free > 0]) if label != free[0, 0]]
    if not holes:
        return None
    largest = max(holes, key=lambda label: int((free == label).sum()))
    rows, cells = np.nonzero((free == largest)[1:-1, 1:-1])
    if len(rows) * columns.cell**2 < 25:
        return None
    corners = columns.corner + np.stack([cells, rows], axis=1) * columns.cell
    return hull(np.concatenate([corners, corners + columns.cell]))


def _labels(picture: np.ndarray) -> np.ndarray:
    """Connected parts of a picture (H,W) by their edges: numbers from 1 on, 0 where it is False."""
    labels = np.where(picture, np.arange(1, picture.size + 1).reshape(picture.shape), 0)
    while True:
        spread = labels.copy()
        for axis in (0, 1):
            for step in (1, -1):
                moved = np.roll(spread, step, axis=axis)
                edge: list[Any] = [slice(None), slice(None)]
                edge[axis] = 0 if step == 1 else -1
                moved[tuple(edge)] = 0
                spread = np.where(picture, np.maximum(spread, moved), 0)
        # A label is a cell's number: following it to that cell's own label halves the way each time.
        flat = np.concatenate([[0], spread.ravel()])
        spread = flat[spread]
        if (spread == labels).all():
            return labels
        labels = spread
