# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sparse stage on small ray-cast scenes: cameras found, components, resume, given models, undistortion."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from curecon_blender.core.adjust.adjust import adjust_cameras
from curecon_blender.core.base.errors import Cancelled, SparseError
from curecon_blender.core.base.geodesy import enu_to_geodetic, geodetic_to_enu
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.base.records import Frame, GeoPosition, Photo, PhotoSet
from curecon_blender.core.sparse import find_cameras
from curecon_blender.core.sparse.features import FeatureSettings, extract_features, open_database
from curecon_blender.core.sparse.mapping import drop_loose
from curecon_blender.core.sparse.record import read_frame
from curecon_blender.core.views.undistortion import undistort

WIDTH, HEIGHT, FOCAL = 480, 360, 420.0
SITE = GeoPosition(latitude=24.6612, longitude=117.0523, altitude=423.0)
BOXES = (((-6, -4, 0), (2, 3, 5)), ((4, -6, 0), (8, 0, 3)), ((-9, 5, 0), (-5, 9, 7)))  # metres


def cast(rotation: np.ndarray, centre: np.ndarray, seed: int) -> np.ndarray:
    """A photo (H,W,3) uint8 of boxes on the ground z = 0, every face covered with noise of the scene's own seed."""
    rng = np.random.default_rng(seed)
    noise = np.sum([cv2.resize(rng.random((n, n), np.float32), (1024, 1024)) for n in (64, 128, 256, 512)], axis=0)
    texture = (noise / noise.max() * 255).astype(np.float32)
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    rays = np.stack([(x - WIDTH / 2) / FOCAL, (y - HEIGHT / 2) / FOCAL, np.ones_like(x)], -1) @ rotation
    depth = np.where(rays[..., 2] < 0, -centre[2] / rays[..., 2], np.inf)
    face = np.full(depth.shape, 2)
    for low, high in BOXES:
        planes = (np.array([low, high])[:, None, None] - centre) / rays
        enter, leave = planes.min(0), planes.max(0).min(-1)
        nearest = enter.max(-1)
        hit = (nearest < leave) & (nearest > 0) & (nearest < depth)
        depth[hit], face[hit] = nearest[hit], enter.argmax(-1)[hit]
    points = centre + rays * np.minimum(depth, 200)[..., None]
    u = np.where(face == 0, points[..., 1], points[..., 0]) * 22 + 137 * face
    v = np.where(face == 2, points[..., 1], points[..., 2]) * 22 + 311 * face
    grey = cv2.remap(texture, (u % 1022).astype(np.float32), (v % 1022).astype(np.float32), cv2.INTER_LINEAR)
    grey[~np.isfinite(depth)] = 200
    return np.repeat(grey.clip(0, 255).astype(np.uint8)[..., None], 3, axis=2)


@dataclass(frozen=True)
class Scene:
    photo_set: PhotoSet
    centres: dict[str, np.ndarray]
    rotations: dict[str, np.ndarray]


def make_scene(folder: Path, count: int, *, seed: int, gps: bool = False, prefix: str = "photo") -> Scene:
    """`count` photos on an arc of 12 degrees a step, 22 m from the site and 14 m up."""
    folder.mkdir(parents=True, exist_ok=True)
    photos, centres, rotations = [], {}, {}
    jitter = np.random.default_rng(9).normal(0, 0.15, (count, 3))
    for i in range(count):
        angle = np.radians(12 * i)
        centre = np.array([22 * np.cos(angle), 22 * np.sin(angle), 14 + i % 2])
        forward = (np.array([0, 0, 1.0]) - centre) / np.linalg.norm(np.array([0, 0, 1.0]) - centre)
        right = np.cross(forward, [0, 0, 1]) / np.linalg.norm(np.cross(forward, [0, 0, 1]))
        rotation = np.stack([right, np.cross(forward, right), forward])
        name = f"{prefix} {i:02d}.png"
        cv2.imwrite(str(folder / name), cast(rotation, centre, seed))
        position = enu_to_geodetic((centre + jitter[i])[None], SITE)[0].tolist()
        photos.append(Photo(
            name=name, path=folder / name, width=WIDTH, height=HEIGHT, camera="drone", focal_px=FOCAL,
            gps=GeoPosition(latitude=position[0], longitude=position[1], altitude=position[2]) if gps else None,
        ))
        centres[name], rotations[name] = centre, rotation
    return Scene(PhotoSet(photos=tuple(photos)), centres, rotations)


def make_options(workspace: Path) -> Options:
    return Options(photos=workspace, workspace=workspace, quality="preview", matches="sift")


def make_reporter(sink: Callable[[Message], None] = lambda message: None) -> Reporter:
    reporter = Reporter(sink)
    reporter.stage("sparse")
    return reporter


def reconstruct(photo_set: PhotoSet, options: Options, workspace: Path, reporter: Reporter) -> list[Frame]:
    """Cameras found, and adjusted."""
    find_cameras.reconstruct(photo_set, options, workspace, reporter)
    reporter.stage("adjust")
    return adjust_cameras(photo_set, workspace, reporter)


def read(workspace: Path, index: int = 0) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(workspace / "sparse" / str(index))


def names(model: pycolmap.Reconstruction) -> set[str]:
    return {model.image(i).name for i in model.reg_image_ids()}


@dataclass(frozen=True)
class Site:
    scene: Scene
    workspace: Path
    frames: list[Frame]
    warnings: list[str]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """Seven photos with GPS, the fifth of which is recorded 80 m off, reconstructed."""
    root = tmp_path_factory.mktemp("site")
    scene = make_scene(root / "photos", 7, seed=1, gps=True)
    photos = list(scene.photo_set.photos)
    gps = photos[4].gps
    assert gps is not None
    photos[4] = replace(photos[4], gps=replace(gps, altitude=gps.altitude + 80))
    scene = replace(scene, photo_set=PhotoSet(photos=tuple(photos)))
    reporter = make_reporter()
    frames = reconstruct(scene.photo_set, make_options(root), root, reporter)
    return Site(scene, root, frames, reporter.warnings)


def test_every_photo_is_placed_in_metres_in_spite_of_one_wrong_gps(site: Site) -> None:
    model = read(site.workspace)
    assert names(model) == set(site.scene.centres)
    assert len(site.frames) == 1 and read_frame(site.workspace / "sparse/0") == site.frames[0]
    frame = site.frames[0]
    assert (frame.scale, frame.up, frame.north) == ("metres", "gps", True)
    assert frame.origin is not None
    shift = geodetic_to_enu(np.array([[frame.origin.latitude, frame.origin.longitude, frame.origin.altitude]]), SITE)[0]
    for image in (model.image(i) for i in model.reg_image_ids()):
        assert np.linalg.norm(image.projection_center() + shift - site.scene.centres[image.name]) < 0.5
        turned = image.cam_from_world().rotation.matrix() @ site.scene.rotations[image.name].T
        assert np.degrees(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))) < 1.5
    assert any("photo 04.png" in warning and "GPS" in warning for warning in site.warnings)


def test_a_photo_that_hardly_any_points_hold_is_left_out(site: Site) -> None:
    """Ten points of three photos or more are what false matches leave of a photo: it may stand anywhere."""
    model = pycolmap.Reconstruction(site.workspace / "sparse/mapped/0")
    image = next(model.image(i) for i in model.reg_image_ids() if model.image(i).name == "photo 06.png")
    held = [
        i for i, point in enumerate(image.points2D)
        if point.has_point3D() and model.point3D(point.point3D_id).track.length() >= 3
    ]
    for i in held[10:]:
        model.delete_observation(image.image_id, i)
    drop_loose(model)
    assert names(model) == set(site.scene.centres) - {"photo 06.png"}


def test_keypoints_stand_in_the_photo_s_own_pixels(site: Site) -> None:
    """A point projected by the model lies where the photo shows it: half a pixel's shift would be seen."""
    model = read(site.workspace)
    assert model.compute_mean_reprojection_error() < 0.7
    camera = next(iter(model.cameras.values()))
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert camera.mean_focal_length() == pytest.approx(FOCAL, rel=0.02)
    assert max(point.color.max() for point in model.points3D.values()) > 100  # sparse points carry the photos' colours


def test_photos_of_one_camera_with_other_focal_lengths_are_cameras_of_their_own(site: Site, tmp_path: Path) -> None:
    photos = [replace(photo, focal_px=2 * FOCAL if i % 3 == 1 else FOCAL)
              for i, photo in enumerate(site.scene.photo_set.photos)]
    photos[6] = replace(photos[6], focal_px=None)
    settings = FeatureSettings(image_size=240, max_features=100)
    with open_database(tmp_path / "features.db", tuple(photos), settings) as database:
        extract_features(database, tuple(photos), settings, lambda: None)
        cameras = {image.name: database.read_camera(image.camera_id) for image in database.read_all_images()}
    for photo in photos:
        camera = cameras[photo.name]
        assert camera.mean_focal_length() == pytest.approx(photo.focal_px or 1.2 * WIDTH)
        assert camera.has_prior_focal_length == (photo.focal_px is not None)
    assert len({camera.camera_id for camera in cameras.values()}) == 3


def test_without_gps_z_is_up_and_the_scale_is_said_to_be_unknown(site: Site, tmp_path: Path) -> None:
    shutil.copytree(site.workspace / "sparse", tmp_path / "sparse")  # features are the same: only the mapper runs
    photos = tuple(replace(photo, gps=None) for photo in site.scene.photo_set.photos)
    reporter = make_reporter()
    frames = reconstruct(PhotoSet(photos=photos), make_options(tmp_path), tmp_path, reporter)
    assert (frames[0].scale, frames[0].up, frames[0].north) == ("unknown", "gravity", False)
    assert any("unknown" in warning for warning in reporter.warnings)
    image = read(tmp_path).image(min(read(tmp_path).reg_image_ids()))
    up = image.cam_from_world().rotation.matrix()[:, 2]
    assert np.degrees(np.arccos(up @ site.scene.rotations[image.name][:, 2])) < 4


def test_a_model_that_contradicts_its_gps_is_warned_of_with_figures(site: Site, tmp_path: Path) -> None:
    """A GPS track ten times the site's size, off by some 15 m: as a bent model stands against a true track."""
    shutil.copytree(site.workspace / "sparse", tmp_path / "sparse")
    noise = np.random.default_rng(2).normal(0, 15, (7, 3))
    track = enu_to_geodetic(10 * np.array(list(site.scene.centres.values())) + noise, SITE)
    photos = tuple(
        replace(photo, gps=GeoPosition(latitude=p[0], longitude=p[1], altitude=p[2]))
        for photo, p in zip(site.scene.photo_set.photos, track.tolist(), strict=True)
    )
    reporter = make_reporter()
    frames = reconstruct(PhotoSet(photos=photos), make_options(tmp_path), tmp_path, reporter)
    assert frames[0].gps_residual is not None and frames[0].gps_residual > 5
    assert (frames[0].scale, frames[0].north) == ("unknown", True)
    assert any(f"{frames[0].gps_residual:.1f} m off" in w and "bent" in w for w in reporter.warnings)


def test_separate_sites_become_components_and_a_cancelled_job_goes_on(tmp_path: Path) -> None:
    """Two sites of 4 and 3 photos and one photo of a third, cancelled after three photos' features, then resumed."""
    groups = [make_scene(tmp_path / "photos", count, seed=seed, prefix=prefix)
              for count, seed, prefix in ((4, 1, "east"), (3, 2, "west"), (1, 3, "stray"))]
    photo_set = PhotoSet(photos=tuple(photo for group in groups for photo in group.photo_set.photos))
    first: list[int] = []
    second: list[int] = []
    reporter = make_reporter(lambda message: first.append(message.done) if isinstance(message, Progress) else None)
    reporter.cancelled = lambda: len(first) >= 3
    with pytest.raises(Cancelled):
        reconstruct(photo_set, make_options(tmp_path), tmp_path, reporter)
    reporter = make_reporter(lambda message: second.append(message.done)
                             if isinstance(message, Progress) and message.stage == "sparse" else None)
    frames = reconstruct(photo_set, make_options(tmp_path), tmp_path, reporter)
    assert second[0] >= first[-1] > 0  # the bar stands where it stood
    assert second == sorted(second)
    assert len(frames) == 2
    assert names(read(tmp_path, 0)) == set(groups[0].centres)
    assert names(read(tmp_path, 1)) == set(groups[1].centres)
    assert any("2 separate parts (4, 3 photos)" in warning for warning in reporter.warnings)
    assert any("1 of 8 photos" in warning and "stray 00.png" in warning for warning in reporter.warnings)


def test_photos_that_do_not_overlap(tmp_path: Path) -> None:
    groups = [make_scene(tmp_path / "photos", 1, seed=seed, prefix=str(seed)) for seed in (1, 2, 3)]
    photo_set = PhotoSet(photos=tuple(photo for group in groups for photo in group.photo_set.photos))
    with pytest.raises(SparseError, match="overlap") as caught:
        reconstruct(photo_set, make_options(tmp_path), tmp_path, make_reporter())
    assert "share" in caught.value.remedy
    assert not (tmp_path / "sparse/0").exists()


def test_a_damaged_feature_database_is_started_afresh(site: Site, tmp_path: Path) -> None:
    path, photos = tmp_path / "features.db", site.scene.photo_set.photos
    shutil.copy(site.workspace / "sparse/features.db", path)
    shutil.copy(site.workspace / "sparse/features.json", tmp_path)
    settings = FeatureSettings(image_size=1200, max_features=4096)
    with open_database(path, photos, settings) as database:
        assert database.num_images() == len(photos)
    path.write_bytes(path.read_bytes()[:50_000])
    with open_database(path, photos, settings) as database:
        assert database.num_images() == 0


# ---- given models

def import_model(folder: Path, photo_set: PhotoSet, workspace: Path) -> tuple[pycolmap.Reconstruction, list[str]]:
    reporter = make_reporter()
    workspace.mkdir(exist_ok=True)
    find_cameras.import_model(folder, photo_set, make_options(workspace), workspace, reporter)
    frames = adjust_cameras(photo_set, workspace, reporter)
    assert [frame.up for frame in frames] == ["given"]
    return read(workspace), reporter.warnings


@pytest.mark.parametrize("binary", [True, False])
def test_a_given_model_keeps_cameras_and_frame_exactly(site: Site, tmp_path: Path, binary: bool) -> None:
    given = read(site.workspace)
    for image in given.images.values():  # as another program may have named them
        image.name = f"IMAGES/{image.name.upper()}"
    (tmp_path / "model/sparse/0").mkdir(parents=True)
    (given.write_binary if binary else given.write_text)(tmp_path / "model/sparse/0")
    model, warnings = import_model(tmp_path / "model", site.scene.photo_set, tmp_path)
    assert not warnings
    assert names(model) == set(site.scene.centres)
    for image_id in given.reg_image_ids():
        kept, original = (m.image(image_id).cam_from_world().matrix() for m in (model, given))
        assert (kept == original).all()
    for camera_id, camera in given.cameras.items():
        assert (model.camera(camera_id).params == camera.params).all()
    assert model.num_points3D() == given.num_points3D()


def test_a_given_model_of_other_photos(site: Site, tmp_path: Path) -> None:
    photos = site.scene.photo_set.photos
    given = read(site.workspace)
    given.write_text(tmp_path)
    model, warnings = import_model(tmp_path, PhotoSet(photos=photos[:5]), tmp_path / "fewer")
    assert model.num_reg_images() == 5
    assert any("2 images of the model have no photo" in warning for warning in warnings)

    double = PhotoSet(photos=tuple(replace(photo, width=2 * WIDTH, height=2 * HEIGHT) for photo in photos))
    model, _ = import_model(tmp_path, double, tmp_path / "double")
    for camera_id, camera in given.cameras.items():
        assert model.camera(camera_id).mean_focal_length() == pytest.approx(2 * camera.mean_focal_length())
    given.update_point_3d_errors()
    errors = [m.compute_mean_reprojection_error() for m in (model, given)]
    assert errors[0] == pytest.approx(2 * errors[1], rel=0.1)

    cropped = PhotoSet(photos=(replace(photos[0], width=WIDTH - 100), *photos[1:]))
    with pytest.raises(SparseError, match=r"photo 00\.png"):
        import_model(tmp_path, cropped, tmp_path / "cropped")
    with pytest.raises(SparseError, match="Only 2 of the 7"):
        import_model(tmp_path, PhotoSet(photos=photos[:2]), tmp_path / "two")


def test_a_given_model_without_points_gets_them_from_its_cameras(site: Site, tmp_path: Path) -> None:
    """The true cameras as a COLMAP text model of two files, in the scene's own frame."""
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}\n")
    lines = []
    for i, (name, centre) in enumerate(site.scene.centres.items(), start=1):
        rotation = site.scene.rotations[name]
        x, y, z, w = pycolmap.Rotation3d(rotation).quat
        tx, ty, tz = -rotation @ centre
        lines.append(f"{i} {w} {x} {y} {z} {tx} {ty} {tz} 1 {name}\n\n")
    (tmp_path / "images.txt").write_text("".join(lines))
    shutil.copytree(site.workspace / "sparse", tmp_path / "job/sparse")  # the features are there already
    model, _ = import_model(tmp_path, site.scene.photo_set, tmp_path / "job")
    for image in (model.image(i) for i in model.reg_image_ids()):
        assert image.projection_center() == pytest.approx(site.scene.centres[image.name], abs=1e-9)
    assert model.num_points3D() > 300
    heights = np.array([point.xyz[2] for point in model.points3D.values()])
    assert np.mean((heights > -0.3) & (heights < 7.3)) > 0.97  # on the ground and the boxes, and the ground is at 0
    assert np.median(np.abs(heights[heights < 0.5])) < 0.05


@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "garbage"])
def test_a_malformed_model_is_told(site: Site, tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "model"
    if damage != "missing":
        shutil.copytree(site.workspace / "sparse/0", folder)
        path = folder / "images.bin"
        content = path.read_bytes()
        path.write_bytes({"empty": b"", "cut": content[: len(content) // 2], "garbage": b"not a model\n" * 99}[damage])
    with pytest.raises(SparseError) as caught:
        import_model(folder, site.scene.photo_set, tmp_path)
    assert str(folder) in str(caught.value) and caught.value.remedy


# ---- undistortion

@pytest.mark.parametrize(("model", "params"), [
    ("SIMPLE_RADIAL", (400, 310, 245, -0.08)),
    ("OPENCV", (400, 405, 315, 238, -0.1, 0.02, 0.001, -0.002)),
    ("FULL_OPENCV", (400, 405, 315, 238, -0.1, 0.02, 0.001, -0.002, 0.01, 0.02, -0.01, 0.005)),
    ("OPENCV_FISHEYE", (400, 405, 315, 238, 0.02, -0.01, 0.003, -0.001)),
])
@pytest.mark.parametrize("max_size", [640, 320])
def test_undistorted_points_lie_where_the_pinhole_projects_them(
    model: str, params: tuple[float, ...], max_size: int
) -> None:
    camera = pycolmap.Camera(model=model, width=640, height=480, params=params)
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 6), np.linspace(-0.35, 0.35, 5))
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    row, column = np.mgrid[:480, :640] + 0.5
    photo = np.full((480, 640), 20.0)
    for u, v in camera.img_from_cam(rays):
        photo += 200 * np.exp(-((column - u) ** 2 + (row - v) ** 2) / (2 * 2.5**2))
    rgb, K = undistort(np.repeat(photo.round().astype(np.uint8)[..., None], 3, axis=2), camera, max_size)
    assert max(rgb.shape) <= max_size
    assert rgb.min() >= 19  # no blank pixel
    expected = (rays @ K.T)[:, :2]
    inside = ((expected > 14) & (expected < np.array([rgb.shape[1], rgb.shape[0]]) - 14)).all(axis=1)
    assert inside.sum() > 15
    for u, v in expected[inside]:
        left, top = int(u) - 12, int(v) - 12
        blob = np.maximum(rgb[top : top + 25, left : left + 25, 0].astype(float) - 40, 0)
        rows, columns = np.mgrid[:25, :25] + 0.5
        found = np.array([(blob * columns).sum() + left * blob.sum(), (blob * rows).sum() + top * blob.sum()])
        assert np.linalg.norm(found / blob.sum() - (u, v)) < 0.05


def test_a_small_pinhole_photo_is_kept_as_it_is() -> None:
    camera = pycolmap.Camera(model="PINHOLE", width=64, height=48, params=(50, 51, 31.5, 24.5))
    rgb = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    same, K = undistort(rgb, camera, 64)
    assert (same == rgb).all() and (camera.calibration_matrix() == K).all()
    small, half = undistort(rgb, camera, 32)
    assert small.shape == (24, 32, 3)
    assert half[:2] == pytest.approx(K[:2] / 2)
