# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""COLMAP models that are brought in: rigs, far-off coordinates, byte order marks, lenses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from test_georeference import SITE, looking_at, make_photos, orbit

from curecon_blender.core.adjust.adjust import adjust_cameras
from curecon_blender.core.base.errors import SparseError
from curecon_blender.core.base.geodesy import enu_from_ecef, geodetic_to_enu
from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Frame, PhotoSet
from curecon_blender.core.depth.estimate import recentred
from curecon_blender.core.site import adjustment as adjustments
from curecon_blender.core.sparse import find_cameras
from curecon_blender.core.sparse.record import read_frame
from curecon_blender.core.surface.export import Provenance
from curecon_blender.core.views.undistortion import undistort

CENTRES, ROTATIONS = orbit(12)
NAMES = [f"{number:02d}.jpg" for number in range(1, 13)]
UTM = np.array([505_246.3, 2_727_213.7, 423.1])


def model_of(camera: pycolmap.Camera | None = None) -> pycolmap.Reconstruction:
    """Twelve cameras about some points on the ground, in metres east, north and up of SITE."""
    model = pycolmap.Reconstruction()
    camera = camera or pycolmap.Camera.create_from_model_name(1, "PINHOLE", 900, 1200, 900)
    model.add_camera_with_trivial_rig(camera)
    points = np.random.default_rng(3).uniform((-12, -12, -0.05), (12, 12, 0.05), (200, 3))
    for number, (name, centre, rotation) in enumerate(zip(NAMES, CENTRES, ROTATIONS, strict=True), start=1):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), -rotation @ centre)
        pixels = camera.img_from_cam(points @ rotation.T + pose.translation)
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=1, image_id=number)
        model.add_image_with_trivial_frame(image, pose)
    for number, point in enumerate(points):
        track = pycolmap.Track()
        for image_id in range(1, 13):
            track.add_element(image_id, number)
        model.add_point3D(point, track)
    return model


def photos_of(*, gps: bool = False, leave_out: tuple[str, ...] = ()) -> PhotoSet:
    photos = make_photos(CENTRES, gps=gps).values()
    return PhotoSet(photos=tuple(photo for photo in photos if photo.name not in leave_out))


def bring_in(folder: Path, photos: PhotoSet, workspace: Path) -> tuple[pycolmap.Reconstruction, Frame, list[str]]:
    workspace.mkdir()
    reporter = Reporter()
    reporter.stage("sparse")
    options = Options(photos=workspace, workspace=workspace, quality="preview")
    find_cameras.import_model(folder, photos, options, workspace, reporter)
    adjust_cameras(photos, workspace, reporter)
    found = workspace / "sparse/0"
    return pycolmap.Reconstruction(found), read_frame(found), reporter.warnings


def written(model: pycolmap.Reconstruction, folder: Path, *, text: bool = False) -> Path:
    folder.mkdir()
    (model.write_text if text else model.write_binary)(folder)
    return folder


def centres_of(model: pycolmap.Reconstruction) -> np.ndarray:
    images = sorted((model.image(i) for i in model.reg_image_ids()), key=lambda image: str(image.name))
    return np.array([image.projection_center() for image in images])


class TestFarOffCoordinates:
    @pytest.mark.parametrize("offset", [UTM, -UTM, np.array([2_512_345.6, 5_467_890.1, 1203.0])])
    def test_of_a_grid(self, tmp_path: Path, offset: np.ndarray) -> None:
        given = model_of()
        given.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), offset))
        model, frame, _ = bring_in(written(given, tmp_path / "model"), photos_of(), tmp_path / "job")
        assert frame.shift is not None and frame.up == "given"
        assert np.abs(centres_of(model)).max() < 100  # where single precision holds hundredths of a millimetre
        assert centres_of(model) + frame.shift == pytest.approx(CENTRES + offset, abs=1e-6)
        ground = [point.xyz[2] for point in model.points3D.values()]
        assert np.median(ground) == pytest.approx(0, abs=0.6)
        assert f"{offset[0]:.0f}" not in frame.note  # the position may be forgotten, the note stays

    @pytest.mark.parametrize("gps", [True, False], ids=["GPS agrees", "by the cameras' up"])
    def test_earth_centred_ones_are_turned_upright(self, tmp_path: Path, gps: bool) -> None:
        rotation, centre = enu_from_ecef(SITE)
        given = model_of()
        given.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(rotation.T), centre))
        model, frame, _ = bring_in(written(given, tmp_path / "model"), photos_of(gps=gps), tmp_path / "job")
        assert (frame.scale, frame.north, frame.up) == ("metres", True, "given")
        assert frame.origin is not None and frame.origin.altitude_datum == "ellipsoid" and frame.shift is not None
        there = np.array([[frame.origin.latitude, frame.origin.longitude, frame.origin.altitude]])
        assert centres_of(model) + geodetic_to_enu(there, SITE) == pytest.approx(CENTRES, abs=1e-3)
        back, middle = enu_from_ecef(frame.origin)
        assert frame.shift == pytest.approx(middle, abs=1e-6)
        assert centres_of(model) @ back + middle == pytest.approx(CENTRES @ rotation + centre, abs=1e-6)

    def test_a_grid_as_far_as_the_earth_s_middle_is_none(self, tmp_path: Path) -> None:
        offset = np.array([500_000.0, 6_350_000.0, 30.0])  # UTM in Denmark: as long as the Earth's radius
        given = model_of()
        given.transform(pycolmap.Sim3d(1.0, pycolmap.Rotation3d(), offset))
        for number, gps in enumerate((True, False)):
            folder = written(given, tmp_path / f"model{number}")
            model, frame, _ = bring_in(folder, photos_of(gps=gps), tmp_path / f"job{number}")
            assert (frame.scale, frame.origin) == ("unknown", None)
            assert frame.shift is not None
            assert centres_of(model) + frame.shift == pytest.approx(CENTRES + offset, abs=1e-6)

    @pytest.mark.parametrize("change", [(1.0, (300.0, -200.0, 900.0)), (1000.0, (0.0, 0.0, 0.0))])
    def test_what_is_near_stays_where_it_is(self, tmp_path: Path, change: tuple[float, tuple[float, ...]]) -> None:
        scale, offset = change
        given = model_of()
        given.transform(pycolmap.Sim3d(scale, pycolmap.Rotation3d(), np.array(offset)))
        expected = centres_of(given)
        model, frame, _ = bring_in(written(given, tmp_path / "model"), photos_of(), tmp_path / "job")
        assert frame.shift is None
        assert (centres_of(model) == expected).all()

    def test_the_network_is_given_the_same_cameras_to_the_bit(self) -> None:
        def pose_of(centre: np.ndarray, shift: np.ndarray) -> np.ndarray:
            """As a model holds it whose coordinates count from elsewhere, and then without that shift."""
            return np.column_stack([rotation, -rotation @ (centre + shift) + rotation @ shift])

        random = np.random.default_rng(0)
        for _ in range(200):
            rotation = Rotation.from_rotvec(random.normal(size=3)).as_matrix()
            reference, source = random.normal(scale=20, size=(2, 3))
            near, far = (recentred(pose_of(source, shift), reference) for shift in (np.zeros(3), UTM))
            assert np.array_equal(near.astype(np.float32), far.astype(np.float32))
            exact = rotation @ (reference - source)
            assert np.abs(near[:, 3] - exact).max() < 1e-6 * np.linalg.norm(exact)

    def test_the_shift_goes_along_while_it_holds(self) -> None:
        frame = Frame(scale="unknown", up="given", shift=(505_246.0, 2_727_214.0, 423.0))
        lowered = adjustments.with_ground(adjustments.Adjustment(), 2.0, when=adjustments.datetime(2026, 1, 1))
        assert adjustments.adjusted_frame(frame, lowered).shift == (505_246.0, 2_727_214.0, 425.0)
        scaled = replace(lowered, scale=2.0)
        assert adjustments.adjusted_frame(frame, scaled).shift is None

    def test_exports_tell_it(self) -> None:
        told = Provenance(scale="unknown", north=False, shift=(505_246.0, 2_727_214.0, 423.0))
        assert told.extras()["shift"] == [505_246.0, 2_727_214.0, 423.0]
        assert any("505246.0000 2727214.0000 423.0000" in line for line in told.lines())


class TestRigs:
    @staticmethod
    def with_rigs() -> pycolmap.Reconstruction:
        """The same cameras as four frames of a rig of three, as COLMAP 3.12 writes them."""
        plain, model = model_of(), pycolmap.Reconstruction()
        rig = pycolmap.Rig(rig_id=1)
        for number in (1, 2, 3):
            camera = pycolmap.Camera.create_from_model_name(number, "PINHOLE", 900, 1200, 900)
            model.add_camera(camera)
            turn = looking_at(np.zeros(3), np.array([1.0, 0.1 * number, 0]))
            if number == 1:
                rig.add_ref_sensor(camera.sensor_id)
            else:
                rig.add_sensor(camera.sensor_id, pycolmap.Rigid3d(pycolmap.Rotation3d(turn), np.array([0.1, 0, 0])))
        model.add_rig(rig)
        for number in range(4):
            frame = pycolmap.Frame(frame_id=number + 1, rig_id=1)
            ids = [3 * number + place for place in (1, 2, 3)]
            for place, image_id in enumerate(ids, start=1):
                frame.add_data_id(pycolmap.data_t(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, place), image_id))
            frame.rig_from_world = plain.image(ids[0]).cam_from_world()
            model.add_frame(frame)
            for place, image_id in enumerate(ids, start=1):
                image = pycolmap.Image(
                    name=NAMES[image_id - 1], keypoints=np.zeros((200, 2)), camera_id=place, image_id=image_id)
                image.frame_id = frame.frame_id
                model.add_image(image)
        for number, point in enumerate(plain.points3D.values()):
            track = pycolmap.Track()
            for image_id in range(1, 13):
                track.add_element(image_id, number)
            model.add_point3D(point.xyz, track)
        return model

    @pytest.mark.parametrize("missing", [("05.jpg",), ("01.jpg", "06.jpg", "12.jpg"), NAMES[:3], ()])
    def test_each_photo_counts_by_itself(self, tmp_path: Path, missing: tuple[str, ...]) -> None:
        given = self.with_rigs()
        expected = {image.name: image.cam_from_world().matrix() for image in given.images.values()}
        folder = written(given, tmp_path / "model")
        model, _, warnings = bring_in(folder, photos_of(leave_out=tuple(missing)), tmp_path / "job")
        found = {model.image(i).name: model.image(i).cam_from_world().matrix() for i in model.reg_image_ids()}
        assert set(found) == set(NAMES) - set(missing)
        for name, pose in found.items():
            assert pose == pytest.approx(expected[name], abs=1e-12)
        assert model.num_points3D() == given.num_points3D()
        assert any(f"{len(missing)} images" in warning for warning in warnings) == bool(missing)


@pytest.mark.parametrize(("mark", "code"), [
    (b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"),
])
@pytest.mark.parametrize("marked", [("cameras",), ("images", "points3D"), ("cameras", "images", "points3D", "rigs")])
def test_byte_order_marks(tmp_path: Path, mark: bytes, code: str, marked: tuple[str, ...]) -> None:
    folder = written(model_of(), tmp_path / "model", text=True)
    for name in marked:
        path = folder / f"{name}.txt"
        path.write_bytes(mark + path.read_text().replace("\n", "\r\n").encode(code))
    model, _, _ = bring_in(folder, photos_of(), tmp_path / "job")
    assert (model.num_reg_images(), model.num_points3D()) == (12, 200)
    assert centres_of(model) == pytest.approx(CENTRES, abs=1e-9)


LENSES = ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE",
          "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"]


@pytest.mark.parametrize("lens", LENSES)
def test_lenses_are_taken_as_they_are_and_named(tmp_path: Path, lens: str) -> None:
    camera = pycolmap.Camera.create_from_model_name(1, lens, 900, 1200, 900)
    if lens not in ("SIMPLE_PINHOLE", "PINHOLE"):
        camera.params = [*camera.params[:-1], 0.02]
    folder = written(model_of(camera), tmp_path / "model")
    model, frame, _ = bring_in(folder, photos_of(), tmp_path / "job")
    (kept,) = model.cameras.values()
    assert (kept.model_name, kept.params.tolist()) == (lens, camera.params.tolist())
    assert f"({lens})" in frame.note
    picture, _ = undistort(np.full((900, 1200, 3), 90, np.uint8), kept, 600)
    assert (picture == 90).all()


def test_a_panorama_s_lens_is_refused_by_name(tmp_path: Path) -> None:
    folder = written(model_of(), tmp_path / "model", text=True)
    path = folder / "cameras.txt"
    path.write_text(path.read_text().replace("PINHOLE 1200 900 900 900 600 450", "EQUIRECTANGULAR 1200 600 1200 600"))
    with pytest.raises(SparseError, match=r"EQUIRECTANGULAR|cannot be read"):
        bring_in(folder, photos_of(), tmp_path / "job")
