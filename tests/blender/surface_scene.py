# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A little surface for the Blender scripts: a tent of 10 x 10 x 1 m with a colour a quarter, the first one weak and the
last one filled."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from curecon_blender.core.surface.mesh import Mesh, write_mesh

SIDE = 21  # vertices
PAGE_PIXELS = 64
# sRGB bytes by quarter: low x low y, high x low y, low x high y, and high x high y, which is filled.
QUARTERS = np.array([(200, 40, 30), (40, 180, 60), (50, 70, 200), (220, 200, 60)], np.uint8)
FILLED, WEAK = 3, 0


def mesh(*, pages: int = 0) -> Mesh:
    """The tent; with `pages`, its UVs are x and y over 10 m, and quarters take the pages in turn."""
    x, y = np.meshgrid(np.linspace(0, 10, SIDE), np.linspace(0, 10, SIDE))
    z = 1 - np.abs(x - 5) / 5
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    faces = np.concatenate([
        np.stack([corner, corner + 1, corner + SIDE], axis=1),
        np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], axis=1),
    ]).astype(np.int32)
    quarter = quarter_of(vertices[faces].mean(axis=1))
    filled = quarter == FILLED
    distance = np.where(quarter_of(vertices) == FILLED, 0.5, 0.01).astype(np.float32)
    made = Mesh(
        vertices=vertices, faces=faces, colours=QUARTERS[quarter_of(vertices)], distance=distance,
        views=np.where(distance > 0.1, 0, 5).astype(np.uint8), filled=filled,
        weak=quarter == WEAK,
    )
    if not pages:
        return made
    uv = (vertices[faces][..., :2] / 10).astype(np.float32)
    names = tuple(f"texture_{page}.png" for page in range(pages))
    return made.with_texture(uv, (quarter % pages).astype(np.int32), names)


def quarter_of(points: np.ndarray) -> np.ndarray:
    return (points[:, 0] > 5).astype(int) + 2 * (points[:, 1] > 5)


def write(folder: Path, *, textured: bool, pages: int = 1, part: int = 0) -> None:
    """Write the surface into a workspace, as the worker leaves it."""
    suffix = f"_{part}" if part else ""
    write_mesh(folder / f"mesh{suffix}.ply", mesh())
    if not textured:
        return
    target = folder / f"textured{suffix}"
    write_mesh(target / "mesh.ply", made := mesh(pages=pages))
    half = PAGE_PIXELS // 2
    colours = np.ones((PAGE_PIXELS, PAGE_PIXELS, 4), np.float32)
    for quarter, colour in enumerate(QUARTERS):  # Blender's rows go upwards, as v does
        rows, columns = slice(quarter // 2 * half, None), slice(quarter % 2 * half, None)
        colours[rows, columns, :3] = colour / 255
    for name in made.pages:
        picture = bpy.data.images.new("page", PAGE_PIXELS, PAGE_PIXELS)
        picture.pixels.foreach_set(colours.ravel())
        picture.filepath_raw, picture.file_format = str(target / name), "PNG"
        picture.save()
        bpy.data.images.remove(picture)


def render(pixels: int = 40) -> np.ndarray:
    """The scene from above, in Cycles with colours as they are: (4,3) sRGB bytes, the middle of each quarter."""
    scene = bpy.context.scene
    camera = bpy.data.objects.get("Above")
    if camera is None:
        camera = bpy.data.objects.new("Above", bpy.data.cameras.new("Above"))
        camera.data.type, camera.data.ortho_scale = "ORTHO", 10
        camera.location = (5, 5, 20)
        scene.collection.objects.link(camera)
    scene.camera = camera
    settings = scene.render
    settings.engine, settings.resolution_x, settings.resolution_y = "CYCLES", pixels, pixels
    settings.resolution_percentage, settings.pixel_aspect_x, settings.pixel_aspect_y = 100, 1, 1
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 8, False
    scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
    settings.image_settings.file_format = "PNG"
    settings.filepath = str(Path(bpy.app.tempdir) / "above.png")
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(settings.filepath)
    values = np.empty(pixels * pixels * 4, np.float32)
    picture.pixels.foreach_get(values)
    bpy.data.images.remove(picture)
    values = values.reshape(pixels, pixels, 4)[..., :3] * 255
    places = [(pixels * (1 + 2 * (q // 2)) // 4, pixels * (1 + 2 * (q % 2)) // 4) for q in range(4)]
    return np.array([values[row, column] for row, column in places])
