# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Sheets that measure right, stills and a film that plays, and a scene left as it was. Argument: a folder."""

from __future__ import annotations

import json
import re
import struct
import sys
import zlib
from dataclasses import asdict
from pathlib import Path

import bpy
import numpy as np
import surface_scene
import workspace_scene
from pictures import pixels_of

import curecon_blender
from curecon_blender.core.adjust import record
from curecon_blender.core.photos import capture
from curecon_blender.operators import rendering
from curecon_blender.scene import elevations, render_scene

FOLDER, OUT = Path(sys.argv[1]), Path(sys.argv[1]) / "out"


def coloured(pixels: np.ndarray) -> np.ndarray:
    """Where (H,W) there is colour: ink and paper are grey."""
    return np.ptp(pixels, axis=2) > 0.2


def extent(found: np.ndarray) -> tuple[int, int]:
    """Width and height in pixels of what is marked (H,W)."""
    rows, columns = np.flatnonzero(found.any(axis=1)), np.flatnonzero(found.any(axis=0))
    return int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1


def pixels_a_metre(path: Path) -> int:
    """What the PNG itself says, in its pHYs."""
    content = path.read_bytes()
    start = content.index(b"pHYs") + 4
    across, along, unit = struct.unpack(">IIB", content[start : start + 9])
    assert across == along and unit == 1
    return across


def pages_of(path: Path) -> list[tuple[tuple[float, float], float, np.ndarray]]:
    """Of each page of our PDF: its size in mm, and its drawing's mm a pixel with the pixels (H,W,3)."""
    content = path.read_bytes()
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)
    images = [
        (int(width), int(height), zlib.decompress(content[match_end : match_end + int(length)]))
        for width, height, length, match_end in (
            (m[1], m[2], m[3], m.end()) for m in
            re.finditer(rb"/Width (\d+) /Height (\d+).*?/Length (\d+) >>\nstream\n", content)
        )
    ]
    drawn = []
    for match in re.finditer(rb"<< /Filter /FlateDecode /Length (\d+) >>\nstream\n", content):
        page = zlib.decompress(content[match.end() : match.end() + int(match[1])])
        drawn.append(float(re.search(rb"q ([\d.]+) 0 0 ([\d.]+)", page)[1]))
    pages = []
    for (across, along), (width, height, data), shown in zip(boxes, images, drawn, strict=True):
        rows = np.frombuffer(data, np.uint8).reshape(height, -1)[:, 1:]
        picture = np.cumsum(rows, axis=0, dtype=np.uint8).reshape(height, width, 3) / 255
        pages.append(((float(across) / 72 * 25.4, float(along) / 72 * 25.4), shown / width, picture))
    return pages


def ink_by_quarter(plan: np.ndarray) -> np.ndarray:
    """Shares (4,) of ink on the quarters of a plan, away from their edges: south-west, south-east, north-west,
    north-east."""
    ink, middle = (plan < 0.12).all(axis=2), plan.shape[0] // 2
    low, high = slice(middle // 5, middle - middle // 10), slice(middle + middle // 10, 2 * middle - middle // 5)
    return np.array([ink[rows, columns].mean() for rows in (high, low) for columns in (low, high)])


def load(scale: str) -> bpy.types.Scene:
    folder = FOLDER / scale
    workspace_scene.write(folder, scale=scale)
    surface_scene.write(folder, textured=False)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.curecon.import_workspace(directory=str(folder))
    scene = bpy.context.scene
    scene.curecon.present.folder = str(OUT)
    scene.curecon.present.title = "Tent 土楼"
    return scene


def shader_nodes() -> list[str]:
    return sorted(node.name for material in bpy.data.materials for node in material.node_tree.nodes)


def kept(scene: bpy.types.Scene) -> tuple[object, ...]:
    """What the user set, and how much there is in the file."""
    render = scene.render
    counts = (len(bpy.data.scenes), len(bpy.data.objects), len(bpy.data.cameras), len(bpy.data.actions),
              len(bpy.data.curves), len(bpy.data.meshes),
              len([image for image in bpy.data.images if image.type != "RENDER_RESULT"]))
    return (render.engine, render.resolution_x, render.filepath, render.image_settings.file_format, scene.camera,
            scene.frame_end, scene.view_settings.view_transform, shader_nodes(), *counts)


curecon_blender.register()
try:
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not bpy.ops.curecon.render_elevations.poll() and not bpy.ops.curecon.render_showreel.poll()
    try:
        bpy.ops.curecon.open_presentation()
        raise AssertionError("there is no folder yet")
    except RuntimeError as error:
        assert "not there yet" in str(error)

    scene = load("metres")
    before = kept(scene)
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}
    assert kept(scene) == before, (kept(scene), before)
    names = sorted(path.name for path in OUT.iterdir())
    assert names == ["1_south_elevation.png", "2_east_elevation.png", "3_north_elevation.png", "4_west_elevation.png",
                     "5_roof_plan.png", "elevations.pdf"], names
    # The tent is 10 x 10 x 1 m: at 1:100 that is 100 x 100 x 10 mm.
    for name, size in (("5_roof_plan.png", (10, 10)), ("2_east_elevation.png", (10, 1))):
        path = OUT / name
        metres = np.array(extent(coloured(pixels_of(path)))) / pixels_a_metre(path) * 100
        assert np.abs(metres - size).max() < 0.06, (name, metres)  # a pixel is 25 mm
    pages = pages_of(OUT / "elevations.pdf")
    assert len(pages) == 5
    for number, size in ((4, (10, 10)), (1, (10, 1))):
        paper, mm, picture = pages[number]
        assert np.allclose(paper, (297, 210), atol=0.01), paper
        metres = np.array(extent(coloured(picture))) * mm / 1000 * 100
        assert np.abs(metres - size).max() < 0.06, metres
    # Seen from the east, the tent's south is on the left: green, and yellow to the north, hatched, for that was filled.
    east = pages[1][2][pages[1][2].shape[0] // 2]
    assert np.allclose(east[20], surface_scene.QUARTERS[1] / 255, atol=0.02), east[20]
    assert min(np.abs(east[-40:-10] - surface_scene.QUARTERS[3] / 255).max(axis=1)) < 0.02, east[-40:-10]
    # Ink lies over that quarter alone.
    shares = ink_by_quarter(pages[4][2])
    assert max(shares[:3]) < 0.005 and 0.06 < shares[3] < 0.15, shares

    # A sheet says when its photos were taken, by whom, under which licence, in which axes, and how exact it is.
    workspace_scene.tell_times(
        FOLDER / "metres", {"DJI_0001.JPG": "2024-09-28T10:48:00", "b.jpg": "2024-09-29T09:00:00"})
    scene.curecon.credit, scene.curecon.licence = "Wang Li\nand Co", "CC BY 4.0"
    noted = elevations.notes(scene, capture.read_times(FOLDER / "metres"))
    assert noted == ("Photos of 2024-09-28 to 2024-09-29  ·  Surveyed by Wang Li and Co  ·  CC BY 4.0  ·  "
                     "Axes of the site: Y north, Z up  ·  Scale from the given model"), noted
    off = record.PointResidual(name="c1", off=(0.012, 0.0, -0.03), marks=5, pixels=0.4)
    accuracy = record.Accuracy(adjusted=True, reprojection_error=0.5, check=(off,))
    (FOLDER / "metres" / "sparse" / "0" / record.ACCURACY_FILE).write_text(json.dumps(asdict(accuracy)))
    assert "1 check point: 12 mm in plan and 30 mm in height" in elevations.notes(scene, {})

    # What ends half-way leaves no file behind that was only made to be read.
    (OUT / "3_north_elevation.png").unlink()
    (OUT / "3_north_elevation.png").mkdir()
    try:
        bpy.ops.curecon.render_elevations()
        raise AssertionError("a folder stands in the place of a sheet")
    except RuntimeError:
        pass
    assert (OUT / "1_south_elevation.png").is_file() and not list(OUT.glob("*.exr"))
    (OUT / "3_north_elevation.png").rmdir()

    # A quarter turn swaps the sides; a larger scale wants a larger paper; too large a one is an error in words. In a
    # dark scene, too, sheets are drawn in the photos' light, and the surface takes the scene's again.
    # Edges are drawn when asked for: the outline alone, since the ridge is as blunt as a roof's. A ground that was laid
    # for pictures is no part of sheets.
    count = len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials)
    for _ in range(2):
        assert bpy.ops.curecon.lay_ground() == {"FINISHED"}
    plain = bpy.data.objects["CU-Recon Ground"]
    assert plain.dimensions.x > 30 and min(vertex.co.z for vertex in plain.data.vertices) > -0.5
    stage = render_scene.create(scene)
    assert any(item.data == plain.data for item in stage.objects)
    render_scene.remove(stage)
    scene.curecon.present.sheet_lines = True
    scene.curecon.surface_light, scene.world = "SCENE", None
    scene.curecon.present.facade_turn = np.pi / 2
    scene.curecon.present.sheet_scale = "50"
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}
    assert (OUT / "1_east_elevation.png").is_file()
    for material in bpy.data.objects["metres Surface"].data.materials:
        assert material.node_tree.nodes["Light"].inputs[0].default_value == 0
    scene.curecon.surface_light = "PHOTO"
    paper, mm, picture = pages_of(OUT / "elevations.pdf")[4]
    assert np.allclose(paper, (420, 297), atol=0.01), paper  # 20 cm of drawing
    assert abs(extent(coloured(picture))[0] * mm / 1000 * 50 - 10) < 0.03
    rows, columns = np.nonzero(coloured(picture))
    ink = (picture < 0.12).all(axis=2)[rows.min() - 2 : rows.max() + 3, columns.min() - 2 : columns.max() + 3]
    sides = ink[:4].any(axis=0), ink[-4:].any(axis=0), ink[:, :4].any(axis=1), ink[:, -4:].any(axis=1)
    assert min(side.mean() for side in sides) > 0.9 and sorted(ink_by_quarter(picture))[2] < 0.005
    assert bpy.ops.curecon.remove_ground() == {"FINISHED"}
    assert (len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.materials)) == count
    scene.curecon.present.sheet_lines = False
    scene.curecon.region = bpy.data.objects.new("Region", bpy.data.meshes.new("Region"))
    scene.curecon.region.data.from_pydata([(0, 0, 0), (75, 75, 1)], [], [])
    try:
        bpy.ops.curecon.render_elevations()
        raise AssertionError("1.5 m do not fit A0")
    except RuntimeError as error:
        assert "no paper up to A0" in str(error)
    assert len(bpy.data.scenes) == 1 and not rendering.progress.running

    # A side that no photo shows is empty, and is not the other side seen from within: the tent from below.
    scene.curecon.region = None
    scene.curecon.present.sheet_scale, scene.curecon.present.facade_turn = "500", 0
    bpy.data.objects["metres Surface"].rotation_euler.x = np.pi
    bpy.context.view_layer.update()
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}
    assert coloured(pages_of(OUT / "elevations.pdf")[4][2]).mean() < 0.01

    scene = load("unknown")
    for path in OUT.iterdir():
        path.unlink()
    assert bpy.ops.curecon.render_elevations() == {"FINISHED"}
    pages = pages_of(OUT / "elevations.pdf")  # at one scale, whatever it is, the largest as large as A3 takes
    assert np.allclose(pages[4][0], (420, 297), atol=0.01)
    widths = [extent(coloured(pages[number][2]))[0] * pages[number][1] for number in (4, 1)]
    assert abs(widths[0] - widths[1]) < 0.6 and widths[0] > 220, widths

    # Stills, film and contact sheet.
    scene.curecon.present.seconds = 1
    scene.render.fps = 3
    bpy.ops.curecon.move_camera(kind="CRANE")
    before = kept(scene)
    assert bpy.ops.curecon.render_showreel() == {"FINISHED"}
    assert kept(scene) == before, (kept(scene), before)
    for number in range(1, 6):
        still = pixels_of(OUT / f"still_{number}.png")
        assert still.shape[:2] == (540, 960) and 0.03 < coloured(still).mean() < 0.9, number
    assert coloured(pixels_of(OUT / "contact_sheet.png")).mean() > 0.02
    assert (OUT / "contact_sheet.pdf").is_file()
    film = bpy.data.movieclips.load(str(OUT / "film.mp4"))
    assert (film.frame_duration, tuple(film.size), round(film.fps)) == (3, (960, 540), 3)
finally:
    curecon_blender.unregister()
print("CHECKED")
