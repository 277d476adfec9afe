# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A little finished workspace for the Blender scripts: a coloured slab seen by four unlike cameras."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np

from curecon_blender.core.base.records import Component, Frame, GeoPosition, Lens, Photo, PhotoSet, View
from curecon_blender.core.cloud.ply import Cloud, CloudWriter
from curecon_blender.core.photos.record import write_photos
from curecon_blender.core.views.record import write as write_components

POINTS = 2000
SIZE = (64, 48)  # pixels of the pictures
PHOTO_SIZE = (256, 192)  # of the photos themselves
LENS = Lens(f=240.0, aspect=0.99, cx=130.0, cy=94.0, k1=0.05, k2=-0.02, p1=0.001, p2=-0.002, k3=0.0)
PHOTOS = ("DJI_0001.JPG", "with space.png", "照片 3.jpg", "quote'd.jpg")


def cloud() -> Cloud:
    """A slab of 10 x 10 x 1 m whose red rises with x, green with y; confidence rises with z; views from 3 to 6."""
    unit = np.random.default_rng(5).random((POINTS, 3), dtype=np.float32)
    colours = np.column_stack([unit[:, 0] * 255, unit[:, 1] * 255, np.full(POINTS, 128)]).astype(np.uint8)
    return Cloud(
        points=unit * np.array([10, 10, 1], np.float32), colours=colours,
        normals=np.tile(np.array([0, 0, 1], np.float32), (POINTS, 1)), confidence=unit[:, 2].copy(),
        views=(3 + np.arange(POINTS) % 4).astype(np.uint8),
    )


def camera(index: int) -> tuple[np.ndarray, np.ndarray]:
    """K (3,3) with its principal point off the middle and unlike focal lengths, and cam_from_world (3,4)."""
    width, height = SIZE
    calibration = np.array([[60.0 + index, 0, width / 2 + 1.7], [0, 58.5, height / 2 - 2.3], [0, 0, 1]])
    centre = np.array([5 + 8 * np.cos(index * 1.4), 5 + 8 * np.sin(index * 1.4), 7.0 + index])
    forward = np.array([5, 5, 0.5]) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return calibration, np.column_stack([rotation, -rotation @ centre])


def tell_times(folder: Path, times: dict[str, str]) -> None:
    """Write a record of photos taken at `times`, by their names."""
    width, height = SIZE
    write_photos(folder, PhotoSet(photos=tuple(
        Photo(name=name, path=folder / name, width=width, height=height, camera="DJI", focal_px=None, time=time)
        for name, time in times.items()
    )))


def write(folder: Path, *, parts: int = 1, scale: str = "metres", placed: bool = True) -> None:
    """Write the workspace with `parts` components, each with the same cameras and cloud; not `placed`, nobody knows
    where it stands and where north is."""
    (folder / "undistorted").mkdir(parents=True)
    picture = bpy.data.images.new("picture", *SIZE)
    for name in PHOTOS:
        picture.filepath_raw = str(folder / "undistorted" / f"{name}.png")
        picture.file_format = "PNG"
        picture.save()
    bpy.data.images.remove(picture)
    origin = GeoPosition(latitude=24.5, longitude=117.25, altitude=310.0, altitude_datum="sea level")
    made = []
    for part in range(parts):
        (folder / "sparse" / str(part)).mkdir(parents=True)
        views = []
        for index, name in enumerate(PHOTOS):
            calibration, cam_from_world = camera(index)
            views.append(View(
                name=name, image=f"undistorted/{name}.png", width=SIZE[0], height=SIZE[1], K=calibration,
                cam_from_world=cam_from_world, near=4.0, far=20.0, sources=(), lens=LENS, photo_size=PHOTO_SIZE,
                original=str(folder / "photos" / name),
            ))
        made.append(Component(
            index=part, sparse=f"sparse/{part}", cloud="cloud.ply" if part == 0 else f"cloud_{part}.ply",
            frame=Frame(scale=scale, up="gps", north=placed, origin=origin if placed else None, note="A slab."),
            views=tuple(views),
        ))
        with CloudWriter(folder / made[-1].cloud) as writer:
            writer.write(cloud())
    write_components(folder, made)


def imported(folder: Path) -> None:
    """A finished workspace, written and brought into the scene."""
    write(folder)
    (folder / "workspace.json").write_text(json.dumps({"format": 1}), encoding="utf-8")
    bpy.ops.curecon.import_workspace(directory=str(folder))
