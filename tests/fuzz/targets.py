# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is fuzzed: for each reader, sound files to start from, how they are spoiled, and the reading itself."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from PIL import Image, PngImagePlugin

from curecon_blender.core.base.errors import CuReconError

from .mutations import archives, exif_blocks, spoiled_bytes, spoiled_json, spoiled_words

PHOTO = "DJI_0001.JPG"
XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" drone-dji:AbsoluteAltitude="+349.58" '
    'drone-dji:RelativeAltitude="+44.47" drone-dji:GpsLatitude="45.03" drone-dji:GpsLongitude="-7.62" '
    'drone-dji:GimbalRollDegree="+0.10" drone-dji:GimbalYawDegree="-106.80" drone-dji:GimbalPitchDegree="-89.90" '
    'drone-dji:CalibratedFocalLength="200" drone-dji:DewarpData="2022;197,195,-1,-1,-0.4,0.3,0,0,-0.2"/>'
    "</rdf:RDF></x:xmpmeta>"
)
TAGS = (0x010F, 0x0110, 0x0112, 0x0132, 0x8769, 0x8825, 0x9003, 0x9011, 0x920A, 0xA002, 0xA003, 0xA005, 0xA20E, 0xA210,
        0xA405, 0xA431, 0, 1, 2, 3, 4, 5, 6, 9, 0x02BC, 0x8773, 0x0100, 0x0101, 0x0111, 0x0117)


@dataclass(frozen=True)
class Target:
    """`make` writes a sound folder; `cases` draws (file in it, its new bytes); `read` reads the spoiled folder."""

    make: Callable[[Path], None]
    cases: Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]
    read: Callable[[Path], object]

    def load(self, folder: Path) -> None:
        """Read the sound file; the first time that also loads the libraries."""
        with suppress(CuReconError):
            self.read(folder)


# ---- pictures

def _exif() -> Image.Exif:
    tags = Image.Exif()
    tags.update({0x010F: "DJI", 0x0110: "FC6310", 0x0112: 1})
    tags.get_ifd(0x8769).update({0x9003: "2026:01:26 13:50:17", 0x9011: "+08:00", 0x920A: 8.8, 0xA405: 24})
    tags.get_ifd(0x8825).update({1: "S", 2: (33.0, 51.0, 21.6), 3: "W", 4: (70.0, 30.0, 9.0), 5: b"\0", 6: 349.5})
    return tags


def _picture(form: str) -> bytes:
    """A small photo with EXIF and XMP."""
    pixels = np.random.default_rng(0).integers(0, 255, (14, 16, 3), np.uint8)
    picture = Image.fromarray(pixels).resize((256, 224))
    made = io.BytesIO()
    if form == "PNG":
        text = PngImagePlugin.PngInfo()
        text.add_itxt("XML:com.adobe.xmp", XMP)
        picture.save(made, "PNG", exif=_exif(), pnginfo=text)
    elif form == "TIFF":
        picture.save(made, "TIFF", exif=_exif(), tiffinfo={700: XMP.encode()}, compression="tiff_adobe_deflate")
    else:
        picture.save(made, "JPEG", exif=_exif(), xmp=XMP.encode(), progressive=form == "progressive")
    return made.getvalue()


def _with_block(jpeg: bytes, kind: int, payload: bytes) -> bytes:
    """A JPEG with one more segment at its start."""
    payload = payload[:65533]
    return jpeg[:2] + b"\xff" + bytes([kind]) + struct.pack(">H", len(payload) + 2) + payload + jpeg[2:]


def _png_chunk(png: bytes, kind: bytes, payload: bytes) -> bytes:
    """A PNG with one more chunk behind its header, its checksum right."""
    chunk = struct.pack(">I", len(payload)) + kind + payload + struct.pack(">I", zlib.crc32(kind + payload))
    return png[:33] + chunk + png[33:]


def _picture_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    plain = io.BytesIO()
    Image.new("RGB", (256, 224), (90, 120, 30)).save(plain, "JPEG")
    png = _picture("PNG")
    exif = exif_blocks(TAGS)
    return st.tuples(st.just(PHOTO), st.one_of(
        *[spoiled_bytes(_picture(form)) for form in ("JPEG", "progressive", "PNG", "TIFF")],
        exif.map(lambda block: _with_block(plain.getvalue(), 0xE1, b"Exif\0\0" + block)),
        exif.map(lambda block: _png_chunk(png, b"eXIf", block)),
        exif,
        st.one_of(spoiled_words(XMP.encode()), spoiled_bytes(XMP.encode())).map(
            lambda text: _with_block(plain.getvalue(), 0xE1, b"http://ns.adobe.com/xap/1.0/\0" + text)),
        spoiled_bytes(png[16:29]).map(lambda header: png[:16] + header[:13] + struct.pack(
            ">I", zlib.crc32(png[12:16] + header[:13])) + png[33:]),
        st.binary(max_size=200),
    ))


def _make_picture(folder: Path) -> None:
    (folder / PHOTO).write_bytes(_picture("JPEG"))


def _read_picture(folder: Path) -> None:
    from curecon_blender.core.base.records import Photo, PhotoSet
    from curecon_blender.core.photos import check as photos
    from curecon_blender.core.photos.record import read_photos, write_photos

    photo = photos._examine(folder / PHOTO)
    if isinstance(photo, Photo):
        photo_set = PhotoSet(photos=tuple(replace(photo, name=f"{i}.jpg") for i in range(3)))
        json.dumps(photos.describe(photo_set), allow_nan=False)
        write_photos(folder, photo_set)
        assert read_photos(folder) == photo_set
        _read_times(folder)


# ---- clouds and meshes

def _make_cloud(folder: Path) -> None:
    from curecon_blender.core.cloud.edits import write_removed
    from curecon_blender.core.cloud.ply import Cloud, CloudWriter

    rng = np.random.default_rng(1)
    count = 9
    with CloudWriter(folder / "cloud.ply") as writer:
        writer.write(Cloud(
            points=rng.random((count, 3), np.float32), colours=rng.integers(0, 255, (count, 3), np.uint8),
            normals=rng.random((count, 3), np.float32), confidence=rng.random(count, np.float32),
            views=np.full(count, 3, np.uint8),
        ))
    write_removed(folder / "cloud.ply", np.arange(count) % 2 == 0)


def _header_of(content: bytes) -> int:
    return content.index(b"end_header\n") + len(b"end_header\n")


def _ply_cases(name: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        content = (folder / name).read_bytes()
        return st.tuples(st.just(name), st.one_of(
            spoiled_words(content, header=_header_of(content)), spoiled_bytes(content), st.binary(max_size=100),
        ))
    return cases


def _read_cloud(folder: Path) -> None:
    from curecon_blender.core.cloud.ply import point_count, read_cloud

    cloud = read_cloud(folder / "cloud.ply")
    assert np.isfinite(cloud.points).all() and np.isfinite(cloud.confidence).all()
    assert point_count(folder / "cloud.ply") == len(cloud)


def _make_mesh(folder: Path) -> None:
    from curecon_blender.core.surface.mesh import Mesh, write_mesh

    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    write_mesh(folder / "mesh.ply", Mesh(
        vertices=vertices, faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32), colours=np.zeros((4, 3), np.uint8),
        distance=np.zeros(4, np.float32), views=np.ones(4, np.uint8), filled=np.array([False, True]),
    ).with_texture(np.zeros((2, 3, 2), np.float32), np.zeros(2, np.int32), ("texture_0.png",)))


def _read_mesh(folder: Path) -> None:
    from curecon_blender.core.surface.mesh import filled_share, read_mesh

    mesh = read_mesh(folder / "mesh.ply")
    assert np.isfinite(filled_share([mesh]))
    assert all((folder / page).resolve().parent == folder.resolve() for page in mesh.pages)


def _removed_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    from curecon_blender.core.cloud.edits import digest

    named = digest(folder / "cloud.ply").encode("utf-32-le")
    seed = {"bits": ("|u1", (2,), b"\xaa\x80"), "cloud": ("<U64", (), named)}
    return st.tuples(st.just("removed.npz"), st.one_of(
        spoiled_bytes((folder / "removed.npz").read_bytes()), archives(seed),
    ))


def _read_removed(folder: Path) -> None:
    from curecon_blender.core.cloud.edits import edits_key, is_stale, read_edited_cloud

    read_edited_cloud(folder / "cloud.ply")
    is_stale(folder / "cloud.ply")
    edits_key(folder / "cloud.ply")


def _view() -> Any:
    from curecon_blender.core.base.records import View

    pose = np.array([[1.0, 0, 0, 0.5], [0, 1, 0, 0.25], [0, 0, 1, 2]])
    return View(
        name=PHOTO, image=f"undistorted/{PHOTO}.jpg", width=5, height=4, near=1.0, far=9.0, cam_from_world=pose,
        K=np.array([[6.0, 0, 2.5], [0, 6, 2], [0, 0, 1]]), sources=(("2.jpg", 1.5),), overlaps=("2.jpg",),
        original="/photos/1.jpg",
    )


def _make_depth(folder: Path) -> None:
    view = _view()
    (folder / "depth").mkdir()
    np.savez(folder / "depth" / f"{PHOTO}.npz", depth=np.ones((4, 5), np.float32), key=np.array("k"), K=view.K,
             confidence=np.ones((4, 5), np.float16), cam_from_world=view.cam_from_world)


def _depth_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    view, name = _view(), f"depth/{PHOTO}.npz"
    seed = {
        "depth": ("<f4", (4, 5), np.ones((4, 5), "<f4").tobytes()), "K": ("<f8", (3, 3), view.K.tobytes()),
        "confidence": ("<f2", (4, 5), np.ones((4, 5), "<f2").tobytes()), "key": ("<U1", (), "k".encode("utf-32-le")),
        "cam_from_world": ("<f8", (3, 4), view.cam_from_world.tobytes()),
    }
    return st.tuples(st.just(name), st.one_of(spoiled_bytes((folder / name).read_bytes()), archives(seed)))


def _read_depth(folder: Path) -> None:
    from curecon_blender.core.depth.maps import is_finished, read_depth

    view = _view()
    is_finished(folder, view, "k")
    depth, confidence = read_depth(folder, view)
    assert depth.shape == confidence.shape == (4, 5)


def _told() -> Any:
    return replace(_view(), points=2)


def _make_points(folder: Path) -> None:
    from curecon_blender.core.views import sparse_points

    sparse_points.write(folder, PHOTO, np.ones((2, 4), np.float32))


def _points_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    name = f"undistorted/{PHOTO}.points.npz"
    seed = {"points": ("<f4", (2, 4), np.ones((2, 4), "<f4").tobytes())}
    return st.tuples(st.just(name), st.one_of(spoiled_bytes((folder / name).read_bytes()), archives(seed)))


def _read_points(folder: Path) -> None:
    from curecon_blender.core.network import refinement
    from curecon_blender.core.views import sparse_points

    found = sparse_points.read(folder, _told())
    assert found.shape == (2, 4)
    assert np.isfinite(refinement.rasterise_points(found, 1.0, 9.0, (32, 32))).all()


# ---- the workspace's JSON

def _make_workspace(folder: Path) -> None:
    from curecon_blender.core.base.records import Component, Frame, GeoPosition, Gimbal, Photo, PhotoSet, SkippedPhoto
    from curecon_blender.core.photos.record import write_photos
    from curecon_blender.core.run.workspace import StageRecord, Workspace
    from curecon_blender.core.site import adjustment as alignment
    from curecon_blender.core.sparse.record import write_frame
    from curecon_blender.core.views import record as components

    place = GeoPosition(latitude=24.6, longitude=117.0, altitude=530.0)
    frame = Frame(scale="metres", up="gps", north=True, origin=place, gps_residual=0.4, note="Metres.")
    views = (_view(), replace(_view(), name="2.jpg", sources=((PHOTO, 1.5),), overlaps=(PHOTO,)))
    component = Component(index=0, sparse="sparse/0", cloud="cloud.ply", frame=frame, views=views)
    components.write(folder, [component])
    (folder / "sparse" / "0").mkdir(parents=True)
    write_frame(folder / "sparse" / "0", frame)
    measured = alignment.Measured(kind="scale", value=4.2, how="a measured distance", when="2026-01-01T00:00:00",
                                  points=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), sigma=0.1)
    alignment.write(folder / "sparse" / "0", alignment.Adjustment(scale=2.0, measured=(measured,)))
    photo = Photo(name=PHOTO, path=Path("/photos/1.jpg"), width=300, height=200, camera="DJI", focal_px=300.0,
                  gps=place, gimbal=Gimbal(yaw=1, pitch=-90, roll=0), relative_altitude=30.0, sharpness=1.0,
                  time="2026-01-01T00:00:00+08:00")
    skipped = SkippedPhoto(path=Path("/photos/2.jpg"), reason="cut short")
    write_photos(folder, PhotoSet(photos=(photo,), skipped=(skipped,)))
    with Workspace(folder) as workspace:
        workspace.mark_done("depth", StageRecord(key="k", seconds=1.0, peak_gib=0.5))
    (folder / "speeds.json").write_text(json.dumps({"depth cpu": [1.0, 1.2], "sparse": [0.9]}))
    features = {"settings": {"a": 1}, "photos": {PHOTO: [1, 2, 300, 200, "D", 3]}}
    (folder / "features.json").write_text(json.dumps(features))


def _json_cases(name: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        return st.tuples(st.just(name), spoiled_json(json.loads((folder / name).read_text())))
    return cases


def _read_views(folder: Path) -> None:
    from curecon_blender.core.site import adjustment as alignment
    from curecon_blender.core.views import record as components

    for component in components.read(folder):
        for path in (component.sparse, component.cloud, *(view.image for view in component.views)):
            assert (folder / path).resolve().is_relative_to(folder.resolve()), path
        for view in component.views:
            assert np.isfinite(view.centre).all() and np.isfinite(np.linalg.inv(view.K)).all()
            assert Path(view.name).name == view.name
        centres = np.array([view.centre for view in component.views]).reshape(-1, 3)
        alignment.gps_scale_sigma(component.frame, centres)
        json.dumps(components._component_to_json(component), allow_nan=False)


def _read_frame(folder: Path) -> None:
    from curecon_blender.core.base.geodesy import enu_to_geodetic
    from curecon_blender.core.sparse.record import read_frame

    frame = read_frame(folder / "sparse" / "0")
    if frame.origin is not None:
        assert np.isfinite(enu_to_geodetic(np.zeros((1, 3)), frame.origin)).all()


def _read_adjustment(folder: Path) -> None:
    from curecon_blender.core.base.records import Frame
    from curecon_blender.core.site import adjustment as alignment

    adjustment = alignment.read(folder / "sparse" / "0")
    assert np.isfinite(np.linalg.inv(adjustment.matrix)).all()
    alignment.adjusted_frame(Frame(scale="unknown", up="given"), adjustment)
    alignment.from_json(alignment.to_json(adjustment))


def _read_photo_set(folder: Path) -> None:
    from curecon_blender.core.photos.record import read_photos

    for photo in read_photos(folder).photos:
        assert Path(photo.name).name == photo.name


def _read_times(folder: Path) -> None:
    from curecon_blender.core.photos import capture

    if times := capture.read_times(folder):
        capture.to_utc(capture.middle_time(times), 117.0)


def _read_marker(folder: Path) -> None:
    from curecon_blender.core.run.workspace import Workspace

    with Workspace(folder) as workspace:
        if record := workspace.record("depth"):
            round(record.seconds, 1), round(record.peak_gib, 2)


def _read_speeds(folder: Path) -> None:
    import statistics

    from curecon_blender.core.run import cost
    from curecon_blender.core.sparse import features

    for ratios in cost._read(folder / "speeds.json").values():
        assert not ratios or statistics.median(ratios) > 0
    features._read_record(folder / "features.json").get("photos", {}).get(PHOTO)


def _speeds_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.one_of(_json_cases("speeds.json")(folder), _json_cases("features.json")(folder))


def _make_message(folder: Path) -> None:
    (folder / "line").write_text('{"type": "log", "text": "x"}')


def _message_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    from curecon_blender.core.base import messages as m

    seeds = [m.StageStarted(stage="depth", index=0, count=2), m.Warning(text="x", photo="y"), m.Log(text="x"),
             m.Progress(stage="depth", done=1, total=2, overall=0.5, eta=3.0), m.Result(summary={"points": 1}),
             m.Failure(kind="photos", message="x", remedy="y", path=None, exit_code=3)]
    return st.tuples(st.just("line"), st.one_of(*[spoiled_json(json.loads(m.encode(seed))) for seed in seeds]))


def _read_message(folder: Path) -> None:
    from curecon_blender.core.base import messages as m

    try:
        message = m.decode((folder / "line").read_text(encoding="utf-8", errors="replace"))
    except ValueError:
        return  # what it promises
    if isinstance(message, m.Progress):
        assert 0 <= message.overall <= 1 and (message.eta is None or message.eta >= 0)
        f"{message.stage[:9]} {message.done:,} {message.total:,}"


# ---- models and weights

def _make_model(folder: Path) -> None:
    import pycolmap

    pycolmap.set_random_seed(0)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 1, 4, 12
    model = pycolmap.synthesize_dataset(options)
    for kind in ("bin", "txt"):
        (folder / kind).mkdir()
    model.write_binary(folder / "bin")
    model.write_text(folder / "txt")


def _model_cases(kind: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        strategies = []
        for file in sorted((folder / kind).iterdir()):
            content = file.read_bytes()
            spoiled = spoiled_bytes(content)
            if kind == "txt":
                spoiled = st.one_of(spoiled, spoiled_words(content), spoiled_words(content))
            strategies.append(st.tuples(st.just(f"{kind}/{file.name}"), spoiled))
        return st.one_of(*strategies)
    return cases


def _model_reader(kind: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from curecon_blender.core.sparse import models as colmap_model
        from curecon_blender.core.views.undistortion import undistorted_camera

        for found in colmap_model.find_models(folder / kind):
            model = colmap_model.read_model(found)
            for image_id in model.reg_image_ids():
                image = model.image(image_id)
                assert np.isfinite(image.cam_from_world().matrix()).all()
                for point in image.get_observation_points2D():
                    assert np.isfinite(model.point3D(point.point3D_id).xyz).all()
                undistorted_camera(model.camera(image.camera_id))
            for point in model.points3D.values():
                for element in point.track.elements:
                    model.image(element.image_id).points2D[element.point2D_idx]
    return read


def _make_weights(folder: Path) -> None:
    from curecon_blender.core.network import weights
    from curecon_blender.core.network.config import NetworkConfig
    from curecon_blender.core.network.model import LCMMVSNet

    config = NetworkConfig(channels=(2, 2, 2), groups=(2, 2, 2), regulariser_channels=2, context=0)
    weights.save_network(LCMMVSNet(config), folder / "own.safetensors", {"samples": 1})


def _weights_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    content = (folder / "own.safetensors").read_bytes()
    size = 8 + int.from_bytes(content[:8], "little")
    return st.one_of(
        _json_cases("own.json")(folder),
        st.tuples(st.just("own.safetensors"), st.one_of(
            spoiled_bytes(content[:size]).map(lambda header: header + content[size:]), spoiled_bytes(content),
            spoiled_json(json.loads(content[8:size])).map(
                lambda text: len(text).to_bytes(8, "little") + text + content[size:]),
        )),
    )


def _read_weights(folder: Path) -> None:
    from curecon_blender.core.network import weights

    path = folder / "own.safetensors"
    record = path.with_suffix(".json")
    try:
        fields = json.loads(record.read_text())
        if "sha256" in fields:  # as whoever made both files would have it
            record.write_text(json.dumps({**fields, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}))
    except (ValueError, TypeError, RecursionError):
        pass  # it is for the reader to say so
    weights.load_network(path)


TARGETS = {
    "pictures": Target(_make_picture, _picture_cases, _read_picture),
    "cloud": Target(_make_cloud, _ply_cases("cloud.ply"), _read_cloud),
    "mesh": Target(_make_mesh, _ply_cases("mesh.ply"), _read_mesh),
    "removed": Target(_make_cloud, _removed_cases, _read_removed),
    "depth": Target(_make_depth, _depth_cases, _read_depth),
    "points": Target(_make_points, _points_cases, _read_points),
    "views": Target(_make_workspace, _json_cases("views.json"), _read_views),
    "frame": Target(_make_workspace, _json_cases("sparse/0/frame.json"), _read_frame),
    "adjustment": Target(_make_workspace, _json_cases("sparse/0/adjustment.json"), _read_adjustment),
    "photo_set": Target(_make_workspace, _json_cases("photos.json"), _read_photo_set),
    "times": Target(_make_workspace, _json_cases("photos.json"), _read_times),
    "workspace": Target(_make_workspace, _json_cases("workspace.json"), _read_marker),
    "stage": Target(_make_workspace, _json_cases("stages/depth.json"), _read_marker),
    "speeds": Target(_make_workspace, _speeds_cases, _read_speeds),
    "messages": Target(_make_message, _message_cases, _read_message),
    "model_binary": Target(_make_model, _model_cases("bin"), _model_reader("bin")),
    "model_text": Target(_make_model, _model_cases("txt"), _model_reader("txt")),
    "weights": Target(_make_weights, _weights_cases, _read_weights),
}
