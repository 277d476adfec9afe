# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The command `gaps`: what of a finished site too few photos saw, and the few further photos that would close it."""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..base.files import disk_errors
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import GAPS_FILE, GAPS_FOLDER
from ..base.records import Component, View
from ..cloud.ply import Cloud, read_cloud
from ..plan import site
from ..plan.candidates import candidates, seeing
from ..plan.coverage import SPACING, Eyes, Parts, axes, parts_of, seen, sightings
from ..plan.drones import DRONES, Drone
from ..plan.gaps import advise, in_order, sentence
from ..plan.mission import of_legs
from ..plan.patches import ABSENT, FILLED, Judged, Patches, absent, judge, patches_of, with_absent, write_patches
from ..plan.records import Building, Leg
from ..plan.solid import Solid
from ..plan.wishes import Wishes
from ..plan.write import write_plan
from ..surface.mesh import mesh_file, read_mesh
from ..surface.sight import Sight, looked_through
from ..surface.triangles import face_normals, triangle_areas
from .plan import Ground, moved, read_ground
from .workspace import Workspace, require_workspace

CUBE = 0.3  # metres: side of the cubes that rays are cast through
_AROUND = 5.0  # metres about the building's outline that are looked at, too
_MOST_PATCHES = 6000
_SEEN_THROUGH = 0.05  # of the depth that a photo must see farther, for nothing to be there
_USUAL_DISTANCE = 30.0  # metres, where no photo sees any patch
_MINUTES = 25.0  # of a battery, where the drone is not named


def run_gaps(given: argparse.Namespace, reporter: Reporter) -> dict[str, Any]:
    """Find the gaps and write patches and mission into the workspace's folder `gaps`; returns what was found.

    Raises PlanError, WorkspaceError, Cancelled.
    """
    require_workspace(given.workspace)
    reporter.begin({"gaps": 1.0})
    with Workspace(given.workspace) as workspace:
        reporter.stage("gaps")
        root = workspace.root
        found = look(root, reporter)
        ground, level, building, taken = found.ground, found.level, found.building, found.taken
        patches, solid = found.patches, found.solid
        reporter.progress(1, 4)
        judged = judge(patches, taken, solid)
        first = replace(judged, rays=judged.rays.copy(), short=judged.short.copy())
        reporter.progress(2, 4)
        wishes = Wishes(clearance=given.clearance, ceiling=given.ceiling, takeoff=tuple(given.takeoff))
        drone = found.drone if given.drone is None else DRONES[given.drone]
        leg = candidates(building, drone, wishes, found.distance)
        chosen = advise(judged, taken, seeing(leg, drone), solid, given.photos)
        reporter.progress(3, 4)
        leg = _taken_in_order(leg, chosen, building, wishes, north=ground.north)
        told = _told(first, judged, leg, ground, level)
        folder = root / GAPS_FOLDER
        with disk_errors(folder):
            folder.mkdir(exist_ok=True)
        back = np.linalg.inv(ground.matrix)
        places = moved(patches.parts.places + level, back)
        turned = patches.parts.normals @ back[:3, :3].T
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        write_patches(folder / GAPS_FILE, first, Parts(places, turned))
        files = [GAPS_FILE]
        if len(leg):
            made = of_legs("gaps", [leg], building, drone, wishes, [])
            after = _joined(taken, seeing(leg, drone))
            files += write_plan(folder, made, seen(patches.parts, after, sightings(patches.parts, after, solid)),
                                root.name)
            for note in made.notes:
                reporter.warning(note)
        reporter.progress(4, 4, fresh=False)
    return {"gaps": {**told, "folder": str(folder), "files": files}, "warnings": reporter.warnings}


@dataclass(frozen=True)
class Looked:
    """A site as gaps are looked for in it, in metres: `level` (3,) is its ground, which all heights count from, in the
    frame of `ground`; the patches that should be there, what hides them, the photos' cameras, their usual `distance`
    from the patches, and a `drone` that carries one like them."""

    ground: Ground
    level: np.ndarray
    building: Building
    taken: Eyes
    patches: Patches
    solid: Solid
    drone: Drone

    @property
    def distance(self) -> float:
        """Metres from which the photos show the site: the median of each patch's nearest."""
        n, _, depth = sightings(self.patches.parts, self.taken, self.solid)
        nearest = np.full(len(self.patches), np.inf)
        np.minimum.at(nearest, n, depth)
        known = nearest[np.isfinite(nearest)]
        return float(np.median(known)) if len(known) else _USUAL_DISTANCE


def look(root: Path, reporter: Reporter) -> Looked:
    """A workspace's largest part, looked at. Raises PlanError, WorkspaceError, Cancelled."""
    ground = read_ground(root)
    level = np.array([0.0, 0.0, site.ground_of(ground.points)])
    building = site.of_points(ground.points, origin=ground.origin)
    patches, solid = _surface(root, ground, building, level, reporter)
    views = ground.component.views
    return Looked(ground, level, building, _taken(views, ground.matrix, level), patches, solid, _drone(views))


def _told(before: Judged, after: Judged, leg: Leg, ground: Ground, level: np.ndarray) -> dict[str, Any]:
    """The figures, and each photo's sentence with its place, heading and pitch in the frame as reconstructed."""
    areas, kinds = before.patches.areas, before.patches.kinds
    back = np.linalg.inv(ground.matrix)
    scale = float(np.cbrt(np.linalg.det(back[:3, :3])))
    poses = []
    for place, turn in zip(leg.places, np.stack(axes(leg.headings, leg.pitches), axis=1), strict=True):
        pose = np.eye(4)
        pose[:3, :3] = back[:3, :3] / scale @ turn.T
        pose[:3, 3] = moved((place + level)[None], back)[0]
        poses.append(pose[:3].round(6).tolist())
    total = float(areas.sum())
    return {
        "patches": len(areas), "square_metres": round(total, 1),
        "lacking": round(before.share, 4), "lacking_after": round(after.share, 4),
        "filled": round(float(areas[kinds == FILLED].sum()) / total, 4),
        "absent": round(float(areas[kinds == ABSENT].sum()) / total, 4),
        "pixel_mm": round(before.seen.usual_pixel, 1),
        "photos": [{"says": str(words), "cam_to_world": pose}
                   for words, pose in zip(leg.words, poses, strict=True)],
    }


def _surface(root: Path, ground: Ground, building: Building, level: np.ndarray,
             reporter: Reporter) -> tuple[Patches, Solid]:
    """The site's patches on and about the building, of its mesh where there is one, and all of it as what hides."""
    component = ground.component
    mesh = root / mesh_file(component.index)
    if mesh.is_file():
        places, normals, areas, filled, dense = _of_mesh(mesh, ground.matrix)
    else:
        places, normals, areas, filled, dense = _of_cloud(read_cloud(root / component.cloud), ground.matrix)
    places, dense = places - level, dense - level
    low, high = building.outline.min(axis=0) - _AROUND, building.outline.max(axis=0) + _AROUND
    near = ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1)
    places, normals, areas, filled = places[near], normals[near], areas[near], filled[near]
    side = max(0.5 * SPACING, float(np.sqrt(areas.sum() / _MOST_PATCHES)))
    patches = patches_of(places, normals, areas, filled, side)
    missing = absent(parts_of(building), patches)
    if len(missing.places):
        missing = _not_seen_through(missing, root, component, ground.matrix, level, reporter)
    return with_absent(patches, missing, SPACING**2), Solid(dense, CUBE)


def _of_mesh(path: Path, matrix: np.ndarray) -> tuple[np.ndarray, ...]:
    """Middles, normals, areas and marks of a mesh's faces, and places all over it, in metres."""
    mesh = read_mesh(path)
    corners = moved(mesh.vertices.astype(float), matrix)
    middles = corners[mesh.faces].mean(axis=1)
    areas = np.maximum(triangle_areas(corners[mesh.faces]), 1e-12)
    normals = face_normals(corners, mesh.faces) / (2 * areas[:, None])
    edges = [corners[mesh.faces[:, [n, n - 1]]].mean(axis=1) for n in range(3)]
    marked = mesh.filled if mesh.weak is None else mesh.filled | mesh.weak
    return middles, normals, areas, marked, np.concatenate([corners, middles, *edges])


def _of_cloud(cloud: Cloud, matrix: np.ndarray) -> tuple[np.ndarray, ...]:
    """The same of a cloud: each cube with points stands for one of its faces."""
    points = moved(cloud.points.astype(float), matrix)
    normals = cloud.normals @ matrix[:3, :3].T
    length = np.linalg.norm(normals, axis=1)
    known = length > 0
    cube = np.floor((points - points.min(axis=0)) / CUBE).astype(np.int64)
    _, group, count = np.unique(cube, axis=0, return_inverse=True, return_counts=True)
    areas = CUBE**2 / count[group.ravel()]
    return (points[known], normals[known] / length[known, None], areas[known], np.zeros(int(known.sum()), bool), points)


def _not_seen_through(missing: Parts, root: Path, component: Component, matrix: np.ndarray, level: np.ndarray,
                      reporter: Reporter) -> Parts:
    """Those of a block's parts that no depth map looks through: where one does, there is nothing to record."""
    places = moved(missing.places + level, np.linalg.inv(matrix))
    through = looked_through(places, Sight(component, root, reporter), _SEEN_THROUGH) > 0
    return Parts(missing.places[~through], missing.normals[~through])


def _taken(views: tuple[View, ...], matrix: np.ndarray, level: np.ndarray) -> Eyes:
    """The photos' cameras, in pixels of the photos themselves, in metres above the ground."""
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    turn = matrix[:3, :3] / scale
    enlarged = np.array([_enlarged(view) for view in views])
    return Eyes(
        moved(np.array([view.centre for view in views]), matrix) - level,
        np.array([view.cam_from_world[:, :3] @ turn.T for view in views]),
        np.array([view.K[0, 0] for view in views]) * enlarged,
        np.array([view.K[:2, 2] for view in views]) * enlarged[:, None],
        np.array([(view.width, view.height) for view in views], float) * enlarged[:, None],
    )


def _enlarged(view: View) -> float:
    """How many times as large the photo is as its undistorted picture."""
    return max(view.photo_size) / max(view.width, view.height) if view.photo_size else 1.0


def _joined(first: Eyes, second: Eyes) -> Eyes:
    return Eyes(*(np.concatenate([one, other]) for one, other in
                  zip(vars(first).values(), vars(second).values(), strict=True)))


def _drone(views: tuple[View, ...]) -> Drone:
    """The camera that most photos were taken with, carried by a drone like any."""
    size = Counter((view.width, view.height) for view in views if view.width >= view.height)
    width, height = size.most_common(1)[0][0] if size else (views[0].width, views[0].height)
    view = next(view for view in views if (view.width, view.height) == (width, height))
    times = _enlarged(view)
    return Drone(name=Text("The photos' camera"), sensor=(36.0, 36.0 * height / width),
                 focal=float(view.K[0, 0]) / width * 36.0,
                 picture=(round(width * times), round(height * times)), minutes=_MINUTES)


def _taken_in_order(leg: Leg, chosen: np.ndarray, building: Building, wishes: Wishes, *, north: bool) -> Leg:
    """The chosen photos of a leg in the order in which they are flown, with their sentences."""
    picked = replace(leg, places=leg.places[chosen], headings=leg.headings[chosen], pitches=leg.pitches[chosen])
    order = in_order(picked, np.array(wishes.takeoff))
    picked = replace(picked, places=picked.places[order], headings=picked.headings[order],
                     pitches=picked.pitches[order])
    words = tuple(sentence(place, float(heading), float(pitch), building, north=north)
                  for place, heading, pitch in zip(picked.places, picked.headings, picked.pitches, strict=True))
    return replace(picked, words=words)
