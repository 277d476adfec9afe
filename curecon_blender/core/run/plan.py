# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `plan`: a flight for a building that is drawn, described or already in a workspace's cloud."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import PlanError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.records import Component, GeoPosition
from ..cloud.ply import read_cloud
from ..plan import coverage, site
from ..plan.drones import DRONES, Drone
from ..plan.mission import plan
from ..plan.records import Building
from ..plan.wishes import Wishes
from ..plan.write import facts, write_plan
from ..site import adjustment
from ..views import record as views_record

MOST_POINTS = 2_000_000  # of a cloud that obstacles are taken from


def run_plan(given: argparse.Namespace, reporter: Reporter) -> dict[str, Any]:
    """Plan and write the files; returns what was planned. Raises PlanError, WorkspaceError."""
    reporter.begin({"plan": 1.0})
    reporter.stage("plan")
    wishes = Wishes(pixel=given.pixel, forward=given.forward / 100, side=given.side / 100, clearance=given.clearance,
                    ceiling=given.ceiling, takeoff=tuple(given.takeoff), above=given.above)
    made = plan(given.kind, _building(given), _drone(given), wishes)
    seen = coverage.of_plan(made, coverage.parts_of(made.building))
    folder = given.folder.absolute()
    written = write_plan(folder, made, seen, given.name or folder.name)
    if made.building.origin is None:
        reporter.warning("The position is not known: the page for flying by hand was written, and no mission files. "
                         "Give --position for those.")
    for note in made.notes:
        reporter.warning(note)
    reporter.progress(1, 1, fresh=False)
    return {"plan": {**facts(made, seen), "files": written}, "warnings": reporter.warnings}


def _building(given: argparse.Namespace) -> Building:
    origin = None
    if given.position is not None:
        latitude, longitude = given.position
        if not (abs(latitude) <= 90 and abs(longitude) <= 180):
            raise PlanError(Text("{:g}, {:g} is no position on Earth.", latitude, longitude),
                            remedy="Give latitude, then longitude, in degrees.")
        origin = GeoPosition(latitude=latitude, longitude=longitude, altitude=None)
    if given.workspace is not None:
        return _of_workspace(given, origin)
    if given.height is None:
        raise PlanError("The building's height is not known.", remedy="Give its highest part in metres (--height).")
    if given.outline is not None:
        return site.of_file(given.outline, given.height, eaves=given.eaves)
    if given.ring is not None:
        outer, inner = given.ring
        return site.of_ring(outer, inner, given.height, eaves=given.eaves, origin=origin)
    width, depth = given.size
    return site.of_size(width, depth, given.height, turn=given.turn, eaves=given.eaves, origin=origin)


def _of_workspace(given: argparse.Namespace, origin: GeoPosition | None) -> Building:
    ground = read_ground(given.workspace)
    return site.of_points(ground.points, height=given.height, eaves=given.eaves, origin=ground.origin or origin)


@dataclass(frozen=True)
class Ground:
    """A workspace's largest part as flights are planned for it: points (N,3) in metres, in the frame as the user put it
    right by `matrix` (4,4), whose y is `north` and whose origin is known where that is."""

    component: Component
    points: np.ndarray
    matrix: np.ndarray
    north: bool
    origin: GeoPosition | None


def read_ground(workspace: Path) -> Ground:
    """Raises PlanError where the scale is not known, WorkspaceError."""
    component = views_record.with_clouds(workspace, views_record.read(workspace)[:1])[0]
    measured = adjustment.read(workspace / component.sparse)
    frame = adjustment.adjusted_frame(component.frame, measured)
    if frame.scale != "metres":
        raise PlanError("This workspace's scale is not known, so no flight can be planned in metres.",
                        remedy="Give a distance or control points first, or draw the outline.", path=workspace)
    points = read_cloud(workspace / component.cloud).points.astype(float)
    points = moved(points[:: max(len(points) // MOST_POINTS, 1)], measured.matrix)
    return Ground(component, points, measured.matrix, frame.north, frame.origin if frame.north else None)


def moved(places: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Places (N,3) by a matrix (4,4)."""
    result: np.ndarray = places @ matrix[:3, :3].T + matrix[:3, 3]
    return result


def _drone(given: argparse.Namespace) -> Drone:
    drone = DRONES[given.drone]
    if given.camera is not None:
        width, height, focal, across, down = given.camera
        drone = replace(drone, name="Own camera", sensor=(width, height), focal=focal, picture=(int(across), int(down)))
    if given.minutes is not None:
        drone = replace(drone, minutes=given.minutes)
    if given.waypoints is not None:
        drone = replace(drone, waypoints=given.waypoints)
    return drone
