# SPDX-License-Identifier: GPL-3.0-or-later
"""Eight coded targets (ArUco, DICT_4X4_50, numbers 0 to 7) on the ground, their coordinates and exact marks.

A target is a level white board of 2 m with a black marker of 1.5 m; its point is the marker's centre.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import cv2
import numpy as np
import pycolmap
from mathutils import Vector
from nadir_flight import HEIGHT, LENS, WIDTH
from site_flight import Shot, geodetic

BOARD, CELL = 2.0, 0.25
# x, y in metres, and how far the marker is turned (degrees anticlockwise): about the building, one in the courtyard.
PLACES = [
    (-31.0, -20.0, 10), (-37.0, -1.0, 80), (-24.0, 30.0, -35), (4.0, 30.5, 20),
    (31.0, 18.0, 140), (30.0, -12.0, 60), (24.0, -27.0, -20), (2.6, -4.7, 25),
]


def add_targets(scene: bpy.types.Scene) -> np.ndarray:
    """Lay the targets on what lies below them; their points (8, 3), in the site frame. Run before the first render."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    spread = np.array([(a, b) for a in np.linspace(-1, 1, 9) for b in np.linspace(-1, 1, 9)]) * BOARD / 2
    black, white = _material("black", 0.02), _material("white", 0.75)
    points = []
    for number, (x, y, turn) in enumerate(PLACES):
        heights = [scene.ray_cast(depsgraph, Vector((x + a, y + b, 60.0)), Vector((0, 0, -1)))[1].z for a, b in spread]
        points.append([x, y, max(heights) + 0.03])
        thing = bpy.data.objects.new(f"target_{number}", _board(number, black, white))
        thing.location, thing.rotation_euler = points[-1], (0, 0, np.radians(turn))
        scene.collection.objects.link(thing)
        bpy.context.view_layer.update()
        print(f"target {number}: {np.ptp(heights):.2f} m of relief below it", flush=True)
    return np.array(points)


def _material(name: str, brightness: float) -> bpy.types.Material:
    material = bpy.data.materials.new(f"target_{name}")
    material.use_nodes = True
    shader = material.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (brightness,) * 3 + (1.0,)
    shader.inputs["Roughness"].default_value = 0.9
    return material


def _board(number: int, black: bpy.types.Material, white: bpy.types.Material) -> bpy.types.Mesh:
    """A mesh of 8 x 8 level squares: the marker's 6 x 6 within a white margin."""
    marker = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), number, 6)
    cells = np.pad(marker > 127, 1, constant_values=True)  # row 0 is the marker's top, towards +y
    lines = np.arange(9) * CELL - BOARD / 2
    vertices = [(x, -y, 0.0) for y in lines for x in lines]
    faces = [(9 * r + 9 + c, 9 * r + 10 + c, 9 * r + 1 + c, 9 * r + c) for r in range(8) for c in range(8)]
    mesh = bpy.data.meshes.new(f"target_{number}")
    mesh.from_pydata(vertices, [], faces)
    mesh.materials.append(black)
    mesh.materials.append(white)
    mesh.polygons.foreach_set("material_index", cells.ravel().astype(np.int32))
    return mesh


def marks(scene: bpy.types.Scene, points: np.ndarray, shots: list[Shot]) -> list[tuple[int, str, float, float]]:
    """Number of the target, photo and pixel of each target that a photo shows whole and nothing hides."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    found = []
    for shot in shots:
        rotation, translation = shot.cam_from_world[:3, :3], shot.cam_from_world[:3, 3]
        eye = -rotation.T @ translation
        for number, point in enumerate(points):
            a = np.radians(PLACES[number][2])
            across, up = np.array([np.cos(a), np.sin(a), 0]), np.array([-np.sin(a), np.cos(a), 0])
            corners = [0.49 * BOARD * (i * across + j * up) for i in (-1, 1) for j in (-1, 1)]
            around = point + np.array([np.zeros(3), *corners])
            camera = around @ rotation.T + translation
            pixels = LENS.distort(camera[:, :2] / camera[:, 2:])
            if not ((pixels > 0) & (pixels < [WIDTH, HEIGHT])).all():
                continue
            sights = around - eye
            hits = [scene.ray_cast(depsgraph, Vector(eye), Vector(sight).normalized()) for sight in sights]
            if all((np.asarray(hit[1]) - eye) @ sight > sight @ sight * (1 - 0.1 / np.linalg.norm(sight))
                   for hit, sight in zip(hits, sights, strict=True)):
                found.append((number, shot.name, *pixels[0].tolist()))
    return found


def write_targets(points: np.ndarray, found: list[tuple[int, str, float, float]], folder: Path) -> None:
    """targets.csv (degrees, metres above the ellipsoid), targets_site.csv (site frame) and ODM's gcp_list.txt (UTM)."""
    folder.mkdir(parents=True, exist_ok=True)
    places = geodetic(points)
    utm, zone = pycolmap.GPSTransform().ellipsoid_to_utm(places)
    names = [f"T{number}" for number in range(len(points))]
    lines = [f"{n},{a:.10f},{b:.10f},{h:.4f}" for n, (a, b, h) in zip(names, places, strict=True)]
    (folder / "targets.csv").write_text("\n".join(["name,latitude,longitude,altitude", *lines]) + "\n")
    lines = [f"{n},{x:.4f},{y:.4f},{z:.4f}" for n, (x, y, z) in zip(names, points, strict=True)]
    (folder / "targets_site.csv").write_text("\n".join(["name,x,y,z", *lines]) + "\n")
    lines = [
        f"{utm[n, 0]:.4f} {utm[n, 1]:.4f} {utm[n, 2]:.4f} {x:.3f} {y:.3f} {photo} {names[n]}"
        for n, photo, x, y in sorted(found)
    ]
    (folder / "gcp_list.txt").write_text("\n".join([f"WGS84 UTM {zone}N", *lines]) + "\n")


def shrink_targets(folder: Path, out: Path, scale: float) -> None:
    """Copy the targets' files; the marks are those of photos `scale` as large."""
    out.mkdir(parents=True, exist_ok=True)
    for name in ("targets.csv", "targets_site.csv"):
        (out / name).write_text((folder / name).read_text())
    system, *lines = (folder / "gcp_list.txt").read_text().splitlines()
    shrunk = []
    for line in lines:
        x, y, z, column, row, *names = line.split()
        shrunk.append(" ".join([x, y, z, f"{float(column) * scale:.3f}", f"{float(row) * scale:.3f}", *names]))
    (out / "gcp_list.txt").write_text("\n".join([system, *shrunk]) + "\n")
