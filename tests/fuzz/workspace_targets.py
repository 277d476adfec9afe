# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The JSON of a workspace and of the worker's messages, spoiled."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

from .geometry_targets import some_view
from .mutations import spoiled_bytes, spoiled_json, spoiled_words
from .target import PHOTO


def make_workspace(folder: Path) -> None:
    from curecon_blender.core.adjust import control as points
    from curecon_blender.core.adjust.record import ACCURACY_FILE, Accuracy, Dome, LensFound, PhotoResidual
    from curecon_blender.core.base.files import write_json
    from curecon_blender.core.base.records import Component, Frame, GeoPosition, Gimbal, Photo, PhotoSet, SkippedPhoto
    from curecon_blender.core.photos.record import write_photos
    from curecon_blender.core.run.workspace import StageRecord, Workspace
    from curecon_blender.core.site import adjustment as alignment
    from curecon_blender.core.sparse.record import FRAME_FILE
    from curecon_blender.core.texture.falloff import write_cameras
    from curecon_blender.core.views import record as components

    place = GeoPosition(latitude=24.6, longitude=117.0, altitude=530.0)
    frame = Frame(scale="metres", up="gps", north=True, origin=place, gps_residual=0.4, note="Metres.")
    views = (some_view(), replace(some_view(), name="2.jpg", sources=((PHOTO, 1.5),), overlaps=(PHOTO,)))
    component = Component(index=0, sparse="sparse/0", cloud="cloud.ply", frame=frame, views=views)
    components.write(folder, [component])
    write_cameras(folder, views, np.array([[0.2, 0.1]] * 2))
    (folder / "sparse" / "0").mkdir(parents=True)
    write_json(folder / "sparse" / "0" / FRAME_FILE, asdict(frame))
    accuracy = Accuracy(adjusted=True, reprojection_error=0.5, gps=(PhotoResidual(name=PHOTO, off=(0.1, 0.2, -0.1)),),
                        lenses=(LensFound(source="nothing", known=(1.0,) * 9, values=(1.0,) * 9, sigmas=(0.1,) * 9),),
                        domes=(Dome(source="GPS", bend=1.0, sigma=0.1, limit=0.1),), focal_sigma=0.01)
    write_json(folder / "sparse" / "0" / ACCURACY_FILE, asdict(accuracy))
    measured = alignment.Measured(kind="scale", value=4.2, how="a measured distance", when="2026-01-01T00:00:00",
                                  points=((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), sigma=0.1)
    alignment.write(folder / "sparse" / "0", alignment.Adjustment(scale=2.0, measured=(measured,)))
    point = points.ControlPoint(name="gcp1", system="WGS84", given=(24.6, 117.0, None), place=(24.6, 117.0, None))
    position = points.PhotoPosition(photo=PHOTO, place=(24.6, 117.0, 530.0), sigma_plan=0.02, sigma_height=0.03)
    control = points.ControlSet(points=(point,), positions=(position,))
    points.write_control(folder, control.with_marks([points.Mark(point="gcp1", photo=PHOTO, x=10, y=20)]))
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


def json_cases(name: str) -> Callable[[Path], st.SearchStrategy[tuple[str, bytes]]]:
    def cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
        return st.tuples(st.just(name), spoiled_json(json.loads((folder / name).read_text())))
    return cases


def check_views(folder: Path) -> None:
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


def check_falloff(folder: Path) -> None:
    from curecon_blender.core.texture.falloff import read_cameras, through_lens

    for camera in read_cameras(folder):
        if camera.width * camera.height < 1000:
            view = replace(some_view(), width=camera.width, height=camera.height, K=camera.K)
            seen = through_lens(np.ones((view.height, view.width, 3)), view, [camera])
            assert np.isfinite(seen).all() and seen.max() <= 1 + 1e-6


def check_frame(folder: Path) -> None:
    from curecon_blender.core.base.geodesy import enu_to_geodetic
    from curecon_blender.core.sparse.record import read_frame

    frame = read_frame(folder / "sparse" / "0")
    if frame.origin is not None:
        assert np.isfinite(enu_to_geodetic(np.zeros((1, 3)), frame.origin)).all()


def check_accuracy(folder: Path) -> None:
    from curecon_blender.core.adjust.record import read_accuracy

    accuracy = read_accuracy(folder / "sparse" / "0")
    assert all(np.isfinite(residual.off).all() for residual in accuracy.gps)


def check_adjustment(folder: Path) -> None:
    from curecon_blender.core.base.records import Frame
    from curecon_blender.core.site import adjustment as alignment

    adjustment = alignment.read(folder / "sparse" / "0")
    assert np.isfinite(np.linalg.inv(adjustment.matrix)).all()
    alignment.adjusted_frame(Frame(scale="unknown", up="given"), adjustment)
    alignment.from_json(alignment.to_json(adjustment))


def check_control(folder: Path) -> None:
    from curecon_blender.core.adjust import control as points
    from curecon_blender.core.adjust.control_files import write_odm
    from curecon_blender.core.base.records import GeoPosition
    from curecon_blender.core.photos.record import read_photos

    control = points.read_control(folder)
    assert points.from_json(points.to_json(control)) == control
    origin = None if control.is_local else GeoPosition(latitude=24.6, longitude=117.0, altitude=530.0)
    assert np.isfinite(points.frame_positions(control.points, origin)).all()
    photos = read_photos(folder).photos
    points.check_places(points.resolved(control, photos, {})[0], photos, {})
    write_odm(folder / "gcp_list.txt", control)


CONTROL_TEXTS = (
    "WGS84 UTM 50N\n500000.5 2720000 424.5 120 80 DJI_0001.JPG gcp1 role=check sigma=0.01/0.02\n",
    "EPSG:4326\nDJI_0001.JPG 117.0 24.6 480 12 -90 0 0.02 0.03\n", "gcp1,24.6,117.0,530,0.02,0.03\nb,24.601,117,530\n",
    "DJI_0001.JPG,gcp1,10,20,1\n", "name;east [m];north [m];height\na;1,5;2;3\nb;4;5;6,25\n",
    '# CoordinateSystem: LOCAL_CS["m"]\n#Label,X/East,Y/North,Z/Altitude,Accuracy_(m)\n"p 1",1,2,3,0.005\n',
)


def make_control_file(folder: Path) -> None:
    make_workspace(folder)
    (folder / "points.csv").write_text(CONTROL_TEXTS[0])


def control_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.tuples(st.just("points.csv"), st.one_of(*[
        spoiled(text.encode(encoding)) for text in CONTROL_TEXTS for encoding in ("utf-8", "utf-16")
        for spoiled in (spoiled_bytes, spoiled_words)
    ]))


def check_control_file(folder: Path) -> None:
    from curecon_blender.core.adjust import control as points
    from curecon_blender.core.adjust.control_files import import_files
    from curecon_blender.core.photos.record import read_photos

    for photos in ((), read_photos(folder).photos):
        control, said = import_files([folder / "points.csv"], points.read_control(folder), photos)
        assert all(said)
        points.write_control(folder, control)
        assert points.read_control(folder) == control
        (folder / points.CONTROL_FILE).unlink(missing_ok=True)


def check_photo_set(folder: Path) -> None:
    from curecon_blender.core.photos.record import read_photos

    for photo in read_photos(folder).photos:
        assert Path(photo.name).name == photo.name


def check_times(folder: Path) -> None:
    from curecon_blender.core.photos import capture

    if times := capture.read_times(folder):
        capture.to_utc(capture.middle_time(times), 117.0)


def check_marker(folder: Path) -> None:
    from curecon_blender.core.run.workspace import Workspace

    with Workspace(folder) as workspace:
        if record := workspace.record("depth"):
            round(record.seconds, 1), round(record.peak_gib, 2)


def check_speeds(folder: Path) -> None:
    import statistics

    from curecon_blender.core.run import cost
    from curecon_blender.core.sparse import features

    for ratios in cost._read(folder / "speeds.json").values():
        assert not ratios or statistics.median(ratios) > 0
    features._read_record(folder / "features.json").get("photos", {}).get(PHOTO)


def speeds_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    return st.one_of(json_cases("speeds.json")(folder), json_cases("features.json")(folder))


def make_message(folder: Path) -> None:
    (folder / "line").write_text('{"type": "log", "text": "x"}')


def message_cases(folder: Path) -> st.SearchStrategy[tuple[str, bytes]]:
    from curecon_blender.core.base import messages as m

    seeds = [m.StageStarted(stage="depth", index=0, count=2), m.Warning(text="x", photo="y"), m.Log(text="x"),
             m.Progress(stage="depth", done=1, total=2, overall=0.5, eta=3.0), m.Result(summary={"points": 1}),
             m.Failure(kind="photos", message="x", remedy="y", path=None, exit_code=3)]
    return st.tuples(st.just("line"), st.one_of(*[spoiled_json(json.loads(m.encode(seed))) for seed in seeds]))


def check_message(folder: Path) -> None:
    from curecon_blender.core.base import messages as m

    try:
        message = m.decode((folder / "line").read_text(encoding="utf-8", errors="replace"))
    except ValueError:
        return  # what it promises
    if isinstance(message, m.Progress):
        assert 0 <= message.overall <= 1 and (message.eta is None or message.eta >= 0)
        f"{message.stage[:9]} {message.done:,} {message.total:,}"
