# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that a stranger made to do harm: each is refused with one error that names it and the remedy.

What is fuzzed for long by `python -m tests.fuzz` is fuzzed here for a moment, with seeds that never change.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import pickle
import struct
import sys
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from PIL import Image

from curecon_blender.core.base import images, messages
from curecon_blender.core.base.errors import CuReconError, PhotoError, SparseError, WeightsError, WorkspaceError
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.cloud import edits as cloud_edits
from curecon_blender.core.cloud.ply import point_count, read_cloud
from curecon_blender.core.network import weights
from curecon_blender.core.photos import capture
from curecon_blender.core.photos.check import check_photos
from curecon_blender.core.photos.metadata import read_metadata
from curecon_blender.core.photos.record import read_photos, write_photos
from curecon_blender.core.run.workspace import Workspace
from curecon_blender.core.site import adjustment as alignment
from curecon_blender.core.sparse import models as colmap_model
from curecon_blender.core.sparse.record import read_frame
from curecon_blender.core.surface.mesh import read_mesh
from curecon_blender.core.views import record as components
from tests.fuzz import runner, targets

OUTSIDE = ("../x", "/etc/x", "C:\\x", "C:x", "\\\\host\\share\\x", "a/../../x", "..", "", "nul", "a\nb", "a\0b")


def refused(kind: type[CuReconError], path: Path, read: Callable[[], object]) -> CuReconError:
    """The reader raises `kind`, which names the file and says what to do, and asks for little memory and time."""
    started = time.process_time()
    with pytest.raises(kind) as caught:
        read()
    assert path.name in str(caught.value) and caught.value.remedy
    assert time.process_time() - started < 5
    return caught.value


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    targets._make_workspace(tmp_path)
    return tmp_path


def change(path: Path, *keys: Any, value: Any) -> None:
    """Give one place in a JSON file another value."""
    content = json.loads(path.read_text())
    holder = content
    for key in keys[:-1]:
        holder = holder[key]
    holder[keys[-1]] = value
    path.write_text(json.dumps(content))


# ---- JSON

RECORDS: dict[str, Callable[[Path], object]] = {
    "views.json": components.read,
    "sparse/0/frame.json": lambda folder: read_frame(folder / "sparse" / "0"),
    "sparse/0/adjustment.json": lambda folder: alignment.read(folder / "sparse" / "0"),
    "photos.json": read_photos,
    "workspace.json": lambda folder: Workspace(folder).__enter__(),
}


@pytest.mark.parametrize("name", RECORDS)
@pytest.mark.parametrize("text", [
    "", "null", "[]", '"x"', "1", "{}", "[" * 200_000, '{"a":' * 200_000, '{"format": NaN}', '{"format": 1e999}',
    '{"format": ' + "9" * 10_000 + "}", '{"format": "1"}', '{"format": true}', '{"format": 1, "components": [null]}',
    "\ufeff{}", "\x00",
], ids=lambda text: text[:12])
def test_json_of_any_kind(workspace: Path, name: str, text: str) -> None:
    if name == "workspace.json" and "components" in text:
        return  # of which it asks for no more
    (workspace / name).write_text(text)
    refused(WorkspaceError, workspace / name, lambda: RECORDS[name](workspace))


def test_json_beyond_its_bound_is_not_read(workspace: Path) -> None:
    path = workspace / "views.json"
    with open(path, "r+b") as file:
        file.truncate(1 << 40)  # a hole: it takes no room on the disk
    refused(WorkspaceError, path, lambda: components.read(workspace))


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("keys", [("sparse",), ("cloud",), ("views", 0, "image"), ("views", 0, "name")], ids=str)
def test_no_path_of_a_workspace_leads_out_of_it(workspace: Path, keys: tuple[Any, ...], name: str) -> None:
    change(workspace / "views.json", "components", 0, *keys, value=name)
    refused(WorkspaceError, workspace / "views.json", lambda: components.read(workspace))


@pytest.mark.parametrize("name", [*OUTSIDE, "a/b"])
def test_no_photo_is_named_with_a_path(workspace: Path, name: str) -> None:
    change(workspace / "photos.json", "photos", 0, "name", value=name)
    refused(WorkspaceError, workspace / "photos.json", lambda: RECORDS["photos.json"](workspace))


@pytest.mark.parametrize(("keys", "value"), [
    (("K",), [[0, 0, 0], [0, 0, 0], [0, 0, 1]]), (("K",), [[6, 0, 2]]), (("K",), [[1e200, 0, 0], [0, 1, 0], [0, 0, 1]]),
    (("cam_from_world",), [[0, 0, 0, 0]] * 3), (("cam_from_world",), [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]),
    (("near",), 0), (("near",), 10), (("far",), -1), (("width",), 0), (("width",), 1 << 70), (("width",), 2.5),
    (("sources",), [["nobody.jpg", 1]]), (("overlaps",), ["nobody.jpg"]), (("sources", 0), [1]), (("extra",), 1),
    (("name",), "2.jpg"),
], ids=str)
def test_a_camera_that_is_none(workspace: Path, keys: tuple[Any, ...], value: Any) -> None:
    change(workspace / "views.json", "components", 0, "views", 0, *keys, value=value)
    refused(WorkspaceError, workspace / "views.json", lambda: components.read(workspace))


@pytest.mark.parametrize(("key", "value"), [
    ("scale", 0), ("scale", -1), ("scale", 1e300), ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]), ("rotation", []),
    ("measured", [{"kind": "other"}]), ("measured", 1),
])
def test_an_adjustment_that_is_no_similarity(workspace: Path, key: str, value: Any) -> None:
    path = workspace / "sparse" / "0" / "adjustment.json"
    change(path, key, value=value)
    refused(WorkspaceError, path, lambda: alignment.read(path.parent))


@pytest.mark.parametrize("place", [{"latitude": 91, "longitude": 0, "altitude": 0}, {"latitude": "1"}, [], 5])
def test_a_place_that_is_not_on_earth(workspace: Path, place: Any) -> None:
    path = workspace / "sparse" / "0" / "frame.json"
    change(path, "origin", value=place)
    refused(WorkspaceError, path, lambda: read_frame(path.parent))


@pytest.mark.parametrize("when", ["0001-01-01T00:00:00", "9999-12-31T23:59:59-23:59", "now", 5])
def test_a_time_that_no_photo_has(workspace: Path, when: Any) -> None:
    change(workspace / "photos.json", "photos", 0, "time", value=when)
    refused(WorkspaceError, workspace / "photos.json", lambda: capture.read_times(workspace))


@pytest.mark.parametrize("text", ["", "[" * 100_000, '{"key": 1}', '{"key": "k", "seconds": "x", "peak_gib": 1}'],
                         ids=lambda text: text[:12])
def test_a_done_marker_that_says_nothing_means_that_the_stage_runs_again(workspace: Path, text: str) -> None:
    (workspace / "stages" / "depth.json").write_text(text)
    with Workspace(workspace) as opened:
        assert opened.record("depth") is None


@pytest.mark.parametrize("line", [
    "", "{}", "[" * 100_000, '{"type": []}', '{"type": "progress", "stage": 1}', '{"type": "log", "text": null}',
    '{"type": "progress", "stage": "depth", "done": 1, "total": 2, "overall": "x", "eta": null}',
], ids=lambda line: line[:20])
def test_a_line_that_is_no_message(line: str) -> None:
    with pytest.raises(ValueError, match="not a worker message"):
        messages.decode(line)


def test_speeds_that_are_none_are_learned_again(tmp_path: Path) -> None:
    from curecon_blender.core.run import cost

    path = tmp_path / "speeds.json"
    for text in ('{"sparse": ["x"]}', '{"sparse": [NaN]}', '{"sparse": [-1]}', '{"sparse": 1}', "[" * 100_000):
        path.write_text(text)
        assert set(cost.slowness_here("cpu", path)) >= {"sparse"}


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
@pytest.mark.parametrize("name", ["depth", "sparse/0", "views.json", ".cloud.ply.partial", "sparse/features.db"])
def test_nothing_is_written_through_a_link(
    workspace: Path, tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    outside = tmp_path_factory.mktemp("outside") / "mine"
    if name != "depth":
        outside.write_text("mine")
    link = workspace / name
    if link.is_dir():
        for file in link.iterdir():
            file.unlink()
        link.rmdir()
    link.unlink(missing_ok=True)
    link.symlink_to(outside)
    refused(WorkspaceError, link, lambda: Workspace(workspace).__enter__())
    assert name == "depth" or outside.read_text() == "mine"


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_photos_may_be_links(workspace: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("card")
    (workspace / "DJI_0001.JPG").symlink_to(outside / "DJI_0001.JPG")
    (workspace / "DCIM").symlink_to(outside)
    with Workspace(workspace):
        pass


# ---- clouds and meshes

def ply(*lines: str, body: bytes = b"") -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode() + body


XYZ = ("property float x", "property float y", "property float z")


@pytest.mark.parametrize("content", [
    b"", b"ply\n", b"ply\nformat\n", b"ply\n" + b"comment x\n" * 100_000, b"ply\n" + b"x" * 10_000_000,
    ply("element vertex 999999999999", *XYZ), ply("element vertex " + "9" * 5000, *XYZ),
    ply("element vertex -1", *XYZ), ply("element vertex \u00b2", *XYZ), ply("element vertex", *XYZ),
    ply("element vertex x", *XYZ), ply("element", *XYZ),
    ply("element vertex 1", "property", *XYZ), ply("element vertex 1", *XYZ, XYZ[0], body=bytes(16)),
    ply("element vertex 1", *XYZ, "property list uchar int x2", body=bytes(12)), ply("element face 1", *XYZ),
    ply("element vertex 1", *XYZ, body=struct.pack("<3f", 0, float("nan"), 0)),
    ply("element vertex 1", *XYZ, body=struct.pack("<3f", 0, 0, float("inf"))),
    ply("element vertex 1", *[line.replace("float", "double") for line in XYZ], body=struct.pack("<3d", 0, 0, 1e300)),
    ply("element vertex 1", "element vertex 2", *XYZ, body=bytes(24)),
], ids=range(20))
def test_a_cloud_that_promises_or_holds_what_cannot_be(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "cloud.ply"
    path.write_bytes(content)
    refused(WorkspaceError, path, lambda: read_cloud(path))


def test_a_header_cut_short_has_no_points_to_count(tmp_path: Path) -> None:
    (tmp_path / "cloud.ply").write_bytes(b"ply\nelement vertex\n")
    refused(WorkspaceError, tmp_path / "cloud.ply", lambda: point_count(tmp_path / "cloud.ply"))


@pytest.mark.parametrize(("old", "new"), [
    (b"vertex 4", b"vertex 999999999999"), (b"face 2", b"face 999999999999"), (b"vertex 4", b"vertex " + b"9" * 100),
    (b"texture_0.png", b"../../x.png"), (b"texture_0.png", b"/etc/passwd"), (b"texture_0.png", b"C:\\x.png"),
    (b"texture_0.png", b"\\\\host\\x.png"), (struct.pack("<3f", 1, 0, 0), struct.pack("<3f", 1, float("nan"), 0)),
])
def test_a_mesh_that_promises_or_names_what_it_must_not(tmp_path: Path, old: bytes, new: bytes) -> None:
    targets._make_mesh(tmp_path)
    path = tmp_path / "mesh.ply"
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    refused(WorkspaceError, path, lambda: read_mesh(path))


# ---- arrays

class _Harm:
    """What a pickle would run."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("harmed",)


def npz(**members: bytes) -> bytes:
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return made.getvalue()


def npy(kind: str, shape: str, content: bytes = b"") -> bytes:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + content


@pytest.mark.parametrize("bits", [
    npy("|O", "(1,)", pickle.dumps([_Harm()])), npy("|u1", "(1099511627776,)"), npy("|u1", "(2,)", b"\0"),
    npy("|u1", "(2, -1)"), npy("<U999999999", "()"), npy("<f8", "(2,)", bytes(16)), b"", b"\x93NUMPY\x01\x00\xff\xff{",
    npy("|u1", "(300000000,)", bytes(300_000_000)),  # 300 kB in the archive
    npy("|u1", "(2,"), npy("|u1", "(" * 5000),  # found by fuzzing: NumPy reads the header as if it were Python
], ids=range(11))
def test_arrays_that_promise_or_hold_something_else(
    tmp_path: Path, bits: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    targets._make_cloud(tmp_path)
    cloud, path = tmp_path / "cloud.ply", tmp_path / "removed.npz"
    monkeypatch.chdir(tmp_path)
    path.write_bytes(npz(bits=bits, cloud=npy("<U64", "()", cloud_edits.digest(cloud).encode("utf-32-le"))))
    refused(WorkspaceError, path, lambda: cloud_edits.read_edited_cloud(cloud))
    assert not (tmp_path / "harmed").exists()


@pytest.mark.parametrize("damage", ["object", "huge", "cut"])
def test_depth_maps_that_promise_or_hold_something_else(tmp_path: Path, damage: str) -> None:
    from curecon_blender.core.depth.maps import read_depth

    targets._make_depth(tmp_path)
    view = targets._view()
    path = tmp_path / "depth" / f"{view.name}.npz"
    with zipfile.ZipFile(path) as archive:
        members = {name.removesuffix(".npy"): archive.read(name) for name in archive.namelist()}
    members["depth"] = {"object": npy("|O", "(4, 5)", pickle.dumps([_Harm()])), "huge": npy("<f4", "(99999, 99999)"),
                        "cut": members["depth"][:-1]}[damage]
    path.write_bytes(npz(**members))
    refused(WorkspaceError, path, lambda: read_depth(tmp_path, view))


# ---- COLMAP models

@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("model")
    targets._make_model(folder)
    return folder


def spoiled(model: Path, tmp_path: Path, name: str, place: int, content: bytes) -> Path:
    """A copy of the binary model with some bytes of a file replaced."""
    folder = tmp_path / "given"
    folder.mkdir()
    for file in (model / "bin").iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    data = bytearray((folder / name).read_bytes())
    data[place : place + len(content)] = content
    (folder / name).write_bytes(data)
    return folder


HUGE = struct.pack("<Q", 1 << 40)
NAN = struct.pack("<d", float("nan"))


@pytest.mark.parametrize(("name", "place", "content"), [
    ("cameras.bin", 0, HUGE), ("images.bin", 0, HUGE), ("points3D.bin", 0, HUGE), ("rigs.bin", 0, HUGE),
    ("frames.bin", 0, HUGE), ("cameras.bin", 12, b"\xff\xff\xff\x7f"), ("cameras.bin", 16, bytes(8)),
    ("cameras.bin", 16, b"\xff" * 8), ("cameras.bin", 32, NAN), ("cameras.bin", 32, bytes(8)),
    ("cameras.bin", 8, b"\x63"), ("points3D.bin", 16, NAN), ("points3D.bin", 59, b"\xff\xff"),
    ("points3D.bin", 63, b"\xff\xff"), ("points3D.bin", 51, HUGE), ("points3D.bin", 8, b"\xfe"),
    ("images.bin", 8, b"\x63"), ("frames.bin", 12, b"\x63"), ("rigs.bin", 12, b"\xff\xff\xff\xff"),
])
def test_a_binary_model_that_promises_or_names_what_is_not_there(
    model: Path, tmp_path: Path, name: str, place: int, content: bytes
) -> None:
    folder = spoiled(model, tmp_path, name, place, content)
    refused(SparseError, folder, lambda: colmap_model.read_model(folder))


@pytest.mark.parametrize(("name", "old", "new"), [
    ("cameras.txt", "SIMPLE_RADIAL", "NONE"), ("cameras.txt", "1024", "-5"), ("cameras.txt", "1280", "nan"),
    ("points3D.txt", "\n1 ", "\n1 nan "), ("images.txt", "\n1 ", "\n99999999999999999999 "),
])
def test_a_text_model_with_what_is_no_number(model: Path, tmp_path: Path, name: str, old: str, new: str) -> None:
    folder = tmp_path / "given"
    folder.mkdir()
    for file in (model / "txt").iterdir():
        (folder / file.name).write_text(file.read_text())
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))
    refused(SparseError, folder, lambda: colmap_model.read_model(folder))


# ---- pictures

def png(width: int, height: int) -> bytes:
    """A black picture of one bit a pixel, packed as tightly as it goes."""
    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    rows = bytes((1 + -(-width // 8)) * height)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", width, height, 1, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


@pytest.mark.parametrize(("width", "height"), [(20_000, 20_000), (2_000_000, 100), (1_000_000_000, 1_000_000_000)])
def test_a_picture_that_unpacks_to_gigabytes(tmp_path: Path, width: int, height: int) -> None:
    path = tmp_path / "bomb.png"
    path.write_bytes(png(width, min(height, 20_000)) if width < 1e9 else png(8, 8).replace(
        struct.pack(">2I", 8, 8), struct.pack(">2I", width, height)))
    refused(PhotoError, path, lambda: images.read_rgb(path))


def test_a_jpeg_of_endless_scans(tmp_path: Path) -> None:
    path = tmp_path / "scans.jpg"
    Image.new("RGB", (3000, 2000)).save(path, progressive=True)
    content = path.read_bytes()
    last = content.rindex(b"\xff\xda")
    path.write_bytes(content[:last] + content[last:-2] * 5000 + content[-2:])
    refused(PhotoError, path, lambda: images.read_rgb(path))


def jpeg(path: Path, *, exif: bytes = b"", xmp: bytes = b"") -> Path:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8)).save(path)
    content = path.read_bytes()
    for block in ((b"Exif\0\0" + exif if exif else b""), (b"http://ns.adobe.com/xap/1.0/\0" + xmp if xmp else b"")):
        if block:
            content = targets._with_block(content, 0xE1, block)
    path.write_bytes(content)
    return path


def tiff(*directories: list[tuple[int, int, int, int]], following: int = 0) -> bytes:
    """Directories of entries (tag, type, count, value); each is followed by the one at `following`."""
    block = b"II*\0\x08\0\0\0"
    for entries in directories:
        block += struct.pack("<H", len(entries)) + b"".join(struct.pack("<HHII", *entry) for entry in entries)
        block += struct.pack("<I", following)
    return block


@pytest.mark.parametrize("exif", [
    tiff([(0x8769, 4, 1, 8), (0x8825, 4, 1, 8)], following=8),  # directories in a circle
    tiff([(0x8825, 4, 1, 0xFFFFFFF0)]), tiff([(0x010F, 2, 0xFFFFFFFF, 8)]), b"II*\0\x08\0\0\0\xff\xff",
    b"MM", b"II*\0" * 9,
    tiff([(0x920A, 5, 1, 8), (0xA405, 3, 1, 0)]), tiff([(0x0112, 3, 1, 60_000)]),
    tiff([(0x8825, 4, 1, 26)], [(1, 2, 2, ord("N")), (2, 5, 3, 200), (3, 2, 2, ord("E")), (4, 5, 3, 200)]),
], ids=range(9))
def test_exif_that_leads_nowhere_loses_only_itself(tmp_path: Path, exif: bytes) -> None:
    told = read_metadata(jpeg(tmp_path / "x.jpg", exif=exif))
    assert told.gps is None and told.focal_px is None
    assert images.read_rgb(tmp_path / "x.jpg").size == 240 * 320 * 3


LAUGHS = ('<!DOCTYPE x [<!ENTITY a "ha">' + "".join(
    f'<!ENTITY {chr(98 + i)} "{f"&{chr(97 + i)};" * 10}">' for i in range(9)) + "]>")


@pytest.mark.parametrize("spoil", [
    lambda text: text.replace("<x:xmpmeta", LAUGHS + "<x:xmpmeta").replace("+349.58", "&j;"),
    lambda text: LAUGHS + text.replace("x:xmpmeta", "y").replace("+349.58", "&j;"),
    lambda text: '<!DOCTYPE y [<!ENTITY j SYSTEM "file:///etc/passwd">]>' + text.replace("x:xmpmeta", "y"),
    lambda text: "<a>" * 20_000, lambda text: text.replace("+349.58", "1e999").replace("+44.47", "nan"),
    lambda text: text.replace("45.03", "-1e308").replace("349", "9" * 60),
])
def test_xmp_that_expands_or_counts_beyond_reach_tells_nothing(tmp_path: Path, spoil: Callable[[str], str]) -> None:
    started = time.process_time()
    told = read_metadata(jpeg(tmp_path / "x.jpg", xmp=spoil(targets.XMP).encode()))
    assert told.gps is None and (told.relative_altitude is None or told.relative_altitude == 44.47)
    assert time.process_time() - started < 5


@pytest.mark.parametrize(("tag", "value"), [(0x9011, "+99:99"), (0x9003, "0001:01:01 00:00:00")])
def test_a_cameras_clock_that_was_never_set(tmp_path: Path, tag: int, value: str) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769).update({0x9003: "2026:01:26 13:50:17", tag: value})
    Image.new("RGB", (320, 240)).save(tmp_path / "x.jpg", exif=exif)
    told = read_metadata(tmp_path / "x.jpg")
    assert told.time == (None if tag == 0x9003 else "2026-01-26T13:50:17")


def test_a_camera_named_in_control_characters(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.update({0x010F: "D\x1b[2J\x07JI" + "x" * 10_000})
    Image.new("RGB", (320, 240)).save(tmp_path / "x.jpg", exif=exif)
    camera = read_metadata(tmp_path / "x.jpg").camera
    assert camera.startswith("D[2JJIxx") and len(camera) == 100


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has names that are no text")
def test_a_photo_whose_name_is_no_text_is_left_out(tmp_path: Path) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        pixels = np.random.default_rng(number).integers(0, 255, (240, 320, 3), np.uint8)
        Image.fromarray(pixels).save(folder / f"{number}.jpg")
    os.rename(os.fsencode(folder) + b"/2.jpg", os.fsencode(folder) + b"/\xff\xfe.jpg")
    (folder / "3.jpg").write_bytes((folder / "0.jpg").read_bytes() + b"x")
    pixels = np.random.default_rng(9).integers(0, 255, (240, 320, 3), np.uint8)
    Image.fromarray(pixels).save(folder / "4.jpg")
    Image.fromarray(pixels[::-1]).save(folder / "5.jpg")
    photo_set = check_photos(folder, Reporter())
    assert len(photo_set.photos) == 4
    assert any("no text" in skip.reason for skip in photo_set.skipped)
    write_photos(tmp_path, photo_set)
    assert read_photos(tmp_path) == photo_set


# ---- weights

@pytest.fixture
def own(tmp_path: Path) -> Path:
    targets._make_weights(tmp_path)
    return tmp_path / "own.safetensors"


def with_content(path: Path, content: bytes) -> None:
    """Other weights, with their checksum, as whoever made both would have it."""
    path.write_bytes(content)
    change(path.with_suffix(".json"), "sha256", value=hashlib.sha256(content).hexdigest())


def test_weights_bring_no_code(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.chdir(own.parent)
    made = io.BytesIO()
    torch.save({"x": _Harm()}, made)
    for content in (made.getvalue(), pickle.dumps(_Harm()), b"", HUGE, b"\xff" * 100):
        with_content(own, content)
        refused(WeightsError, own, lambda: weights.load_network(own))
    assert not (own.parent / "harmed").exists()


@pytest.mark.parametrize(("keys", "value"), [
    (("config", "channels"), [1 << 40] * 3), (("config", "channels"), [400, 400, 400]),
    (("config", "groups"), [0, 0, 0]), (("config", "hypotheses"), "many"), (("config", "regulariser_channels"), -1),
    (("config",), None), (("sha256",), 5), (("config", "hypothesis_step"), 1e-300),
    (("config", "representation"), "__class__"), (("config", "context"), 10**30),
], ids=str)
def test_a_network_beyond_reason(own: Path, keys: tuple[str, ...], value: Any) -> None:
    change(own.with_suffix(".json"), *keys, value=value)
    error = refused(WeightsError, Path("own"), lambda: weights.load_network(own))
    assert error.path is not None


def test_weights_of_a_terabyte_are_not_read(own: Path) -> None:
    with open(own, "r+b") as file:
        file.truncate(1 << 40)  # a hole
    refused(WeightsError, own, lambda: weights.load_network(own))


def test_no_more_memory_is_asked_for_than_a_file_has(own: Path) -> None:
    """Found by fuzzing: reading at most N bytes takes N bytes at once."""
    import tracemalloc

    tracemalloc.start()
    weights.load_network(own)
    weights.describe(own)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 32 << 20


def test_weights_that_are_no_numbers(own: Path) -> None:
    import safetensors.torch

    tensors = safetensors.torch.load(own.read_bytes())
    name = next(name for name, value in tensors.items() if value.is_floating_point())
    tensors[name] = tensors[name] * float("nan")
    with_content(own, safetensors.torch.save(tensors))
    refused(WeightsError, own, lambda: weights.load_network(own))


# ---- location privacy

def test_pictures_that_the_stages_make_carry_no_metadata(tmp_path: Path) -> None:
    tags = Image.Exif()
    tags.get_ifd(0x8825).update({1: "N", 2: (24.0, 39.0, 29.9), 3: "E", 4: (117.0, 3.0, 7.5)})
    photo, made = tmp_path / "photo.jpg", tmp_path / "made.jpg"
    Image.new("RGB", (320, 240)).save(photo, exif=tags, xmp=targets.XMP.encode())
    images.write_jpeg(made, images.read_rgb(photo))
    with Image.open(made) as image:
        assert not image.getexif() and not {"exif", "xmp", "comment", "icc_profile"} & set(image.info)


# ---- a moment of fuzzing

@pytest.mark.parametrize("name", targets.TARGETS)
def test_fuzzing_for_a_moment(tmp_path: Path, name: str) -> None:
    target = targets.TARGETS[name]
    sound, folder = tmp_path / "sound", tmp_path / "spoiled"
    for place in (sound, folder):
        place.mkdir()
        target.make(place)
    target.load(folder)

    @settings(max_examples=20, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
    @given(target.cases(sound))
    def run(case: tuple[str, bytes]) -> None:
        runner.try_case(target, sound, folder, *case)

    run()
