# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages, each declared once: what it depends on, what it makes, and how it runs.

A stage reads and writes the workspace, and hands what the next one needs on through the Job.
"""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

from ..adjust.adjust import adjust_cameras
from ..adjust.control import ControlSet, read_control, to_json
from ..adjust.control_frame import tell_checks
from ..base.errors import PhotoError, SparseError, SurfaceError, WorkspaceError
from ..base.files import disk_errors, scratch_folder
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import DETAILS, MASKS_FOLDER, Options
from ..base.records import Component, Photo, PhotoSet
from ..base.rotations import from_quaternion
from ..cloud.edits import edits_key, read_edited_cloud
from ..cloud.fuse import NoPointsError, fuse
from ..cloud.ply import Cloud
from ..depth.cluster import spread_depths
from ..depth.estimate import estimate_depths
from ..network import weights
from ..photos import record as photos_record
from ..photos.check import check_photos
from ..photos.find import find_files
from ..photos.record import read_photos, write_photos
from ..sparse import find_cameras
from ..surface.build import MeshOptions, build_mesh
from ..surface.detail import simplified
from ..surface.mesh import detail_folder, mesh_file, read_mesh, textured_folder, write_mesh
from ..surface.sight import Sight
from ..texture.texture import TextureOptions, texture_mesh
from ..texture.transfer import transfer_texture
from ..views import record as views_record
from ..views.prepare import prepare_views
from . import cost
from .workspace import Workspace, key_of


@dataclass
class Job:
    """One run over an open workspace: what a stage hands to the next."""

    options: Options
    workspace: Workspace
    reporter: Reporter
    photo_set: PhotoSet = field(default_factory=lambda: PhotoSet(photos=()))
    components: list[Component] = field(default_factory=list)
    files: dict[Path, tuple[int, ...]] = field(default_factory=dict)  # the photos' sizes (bytes) and times (ns)
    masks: dict[Path, tuple[int, ...]] = field(default_factory=dict)  # the same of their masks
    key: str = ""  # of the stage just done; every stage's key takes in the one before

    @property
    def root(self) -> Path:
        return self.workspace.root


@dataclass(frozen=True, kw_only=True)
class Stage:
    """A stage: it is done when its marker has the key of these options, inputs, version, and the stage before.

    `version` is raised by whoever changes the stage's result: workspaces of before then make it anew, and what follows
    it. `options` are names in Options; `inputs` is what else the result depends on. `files` are patterns below the
    workspace of what it makes. `weight` is its share of a typical job's time (the sample site at Standard). `load`
    takes up what the stage has made, just now or in an earlier run. A stage `in_budget` keeps to the memory budget, and
    is tried again with half of it when memory runs out. Nothing depends on one that is `last`.
    """

    name: str
    version: int
    weight: float
    files: tuple[str, ...]
    run: Callable[[Job], None]
    options: tuple[str, ...] = ()
    inputs: Callable[[Job], dict[str, Any]] | None = None
    load: Callable[[Job], None] | None = None
    in_budget: bool = False
    last: bool = False

    def key(self, job: Job) -> str:
        """The key of the stage's done-marker in this job."""
        options = {name: attrgetter(name)(job.options) for name in self.options}
        inputs = self.inputs(job) if self.inputs else {}
        return key_of({"stage": self.name, "version": self.version, "before": job.key, **options, **inputs})


# ---- photos: what they are


def _photo_files(job: Job) -> dict[str, Any]:
    assert job.options.photos is not None
    found = find_files(job.options.photos.absolute())
    job.files = {path: _size_and_time(path) for path in found.pictures}
    beside = [mask for of_photo in found.masks.values() for mask in of_photo]
    job.masks = {mask: _size_and_time(mask) for mask in (*beside, *sorted((job.root / MASKS_FOLDER).glob("*.png")))}
    inputs = {"files": [(str(path), *facts) for path, facts in job.files.items()]}
    return {**inputs, "masks": [(str(path), *facts) for path, facts in job.masks.items()]} if job.masks else inputs


def _check(job: Job) -> None:
    assert job.options.photos is not None
    photo_set = check_photos(
        job.options.photos.absolute(), job.reporter, list(job.files), surplus=job.options.surplus,
        drawn=job.root / MASKS_FOLDER,
    )
    write_photos(job.root, photo_set)


def _load_photos(job: Job) -> None:
    """Take up the photo check's result. What follows depends on the pictures and not on where they lie: a moved or
    copied folder is checked again, and finds everything else done. Raises WorkspaceError for a record of others."""
    job.photo_set = read_photos(job.root)
    photos = job.photo_set.photos
    if not ({photo.path for photo in photos} <= set(job.files)
            and {mask for photo in photos for mask in photo.masks} <= set(job.masks)):
        raise WorkspaceError(
            Text("{} names photos that are not in {}.", job.root / photos_record.FILE_NAME,
                 job.options.photos), path=job.root,
            remedy=Text("Delete the folder {} and run Reconstruct again.", job.root / 'stages'),
        )
    job.key = key_of([_of_the_picture(photo) for photo in job.photo_set.photos])


def _of_the_picture(photo: Photo) -> dict[str, Any]:
    """What later stages depend on of a photo."""
    fields = {**asdict(photo), "path": None}
    masks = {name: fields.pop(name) for name in ("masks", "mask", "masked")}
    return {**fields, "mask": masks["mask"]} if photo.mask else fields


# ---- sparse: where the cameras stood


def _model(job: Job) -> dict[str, Any]:
    options = job.options
    return {"model": _digest(options.model)} if options.model else {
        "mapper": options.mapper, "matches": options.matches}


def _find_cameras(job: Job) -> None:
    with _photos_must_stay(job):
        # The database ends the process when its disk is full, so what it may need is asked for beforehand.
        job.workspace.require_space(cost.disk_bytes(job.photo_set.photos, job.options))
        if job.options.model:
            find_cameras.import_model(job.options.model, job.photo_set, job.options, job.root, job.reporter)
        else:
            find_cameras.reconstruct(job.photo_set, job.options, job.root, job.reporter)


# ---- adjust: the cameras in the site frame, adjusted with all that is known


def _control(job: Job) -> dict[str, Any]:
    held = read_control(job.root).adjusted_to
    return {} if held == ControlSet() else {"control": to_json(held)}


def _tell_checks(job: Job) -> None:
    tell_checks(job.root, read_control(job.root))


def _adjust(job: Job) -> None:
    adjust_cameras(job.photo_set, job.root, job.reporter)


# ---- views: undistorted photos with their sources


def _prepare_views(job: Job) -> None:
    job.workspace.require_space(cost.depth_bytes(job.photo_set.photos, job.options))
    with _photos_must_stay(job):
        components = prepare_views(job.photo_set, job.options, job.root, job.reporter)
    views_record.write(job.root, components)


def _load_views(job: Job) -> None:
    """Take up the components, with their views' originals where the photos lie now, kept so in the workspace."""
    components = views_record.read(job.root)
    places = {photo.name: str(photo.path) for photo in job.photo_set.photos}
    if any(view.original != places[view.name] for component in components for view in component.views):
        components = [replace(component, views=tuple(
            replace(view, original=places[view.name]) for view in component.views
        )) for component in components]
        views_record.write(job.root, components)
    job.components = components


# ---- depth


def _weights(job: Job) -> dict[str, Any]:
    return {"weights": weights.describe(job.options.weights)["sha256"]}


def _estimate_depths(job: Job) -> None:
    key = DEPTH.key(job)  # each photo's file carries it
    if job.options.scheduler:
        spread_depths(job.components, job.root, job.options, key, job.reporter)
    else:
        network = weights.load_network(job.options.weights)
        estimate_depths(job.components, network, job.root, job.options, key, job.reporter)


# ---- fusion: one cloud a component


def _fuse(job: Job) -> None:
    points = 0
    for component in job.components:
        try:
            points += fuse(component, job.root, job.options, job.reporter)
        except NoPointsError as error:
            if len(job.components) == 1:
                raise
            job.reporter.warning(error.message)
    if points == 0:
        raise NoPointsError(
            "No part of the reconstruction gave a point that enough views agree on.",
            remedy="Take photos that overlap more, or lower the minimum confidence or the confirming views.",
        )
    for component in job.components:  # surfaces that are there are of the cloud before
        (job.root / mesh_file(component.index)).unlink(missing_ok=True)
    _drop_textures(job)


# ---- mesh and texture


def _edits(job: Job) -> dict[str, Any]:
    return {"edits": [edits_key(job.root / component.cloud) for component in job.components]}


def _build_meshes(job: Job) -> None:
    options, root = job.options, job.root
    x0, y0, z0, x1, y1, z1 = options.region or (0.0,) * 6
    region = ((x0, y0, z0), (x1, y1, z1)) if options.region else None
    settings = MeshOptions(fill_holes=options.fill_holes, extent=options.extent, max_faces=options.mesh_faces,
                           region=region)
    turn = from_quaternion(options.region_turn) if options.region_turn else None

    def build(component: Component) -> None:
        def cloud() -> Cloud:  # along the region's own axes; not kept here, so that what is thinned out can go
            whole = read_edited_cloud(root / component.cloud)
            return whole if turn is None else whole.rotated(turn)

        with scratch_folder(root / "mesh") as scratch:
            sight = Sight(component, root, job.reporter, turn)
            mesh = build_mesh(cloud(), settings, scratch, job.reporter, sight)
        if turn is not None:
            mesh = replace(mesh, vertices=(mesh.vertices @ turn).astype("float32"))
        write_mesh(root / mesh_file(component.index), mesh)

    _each_surface(job, [c for c in job.components if (root / c.cloud).exists()], build)
    _drop_textures(job)  # they are of the mesh before


def _texture_meshes(job: Job) -> None:
    root = job.root
    settings = TextureOptions(page_size=job.options.texture_size, jpeg=job.options.texture_format == "jpeg")

    def texture(component: Component) -> None:
        folder = root / textured_folder(component.index)
        mesh = read_mesh(root / mesh_file(component.index))
        write_mesh(folder / "mesh.ply", texture_mesh(mesh, component, root, settings, folder, job.reporter))

    _each_surface(job, [c for c in job.components if (root / mesh_file(c.index)).exists()], texture)


def _make_detail(level: str, job: Job) -> None:
    """The textured meshes with fewer faces, each with its own texture; none of what has no more of them."""
    root, detail = job.root, DETAILS[level]
    settings = TextureOptions(
        page_size=min(job.options.texture_size, detail.page_size), jpeg=job.options.texture_format == "jpeg")

    def make(component: Component) -> None:
        folder, source = root / detail_folder(component.index, level), root / textured_folder(component.index)
        shutil.rmtree(folder, ignore_errors=True)
        fine = read_mesh(source / "mesh.ply")
        if len(fine.faces) <= detail.faces:
            job.reporter.log(f"Detail {level}: the mesh has only {len(fine.faces):,} faces")
            return
        with scratch_folder(root / "mesh") as scratch:
            coarse = simplified(fine, detail.faces, scratch, job.reporter)
        with disk_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        pages = [source / page for page in fine.pages]
        coarse = transfer_texture(coarse, fine, pages, settings, folder, job.reporter, normal_map=True)
        write_mesh(folder / "mesh.ply", coarse)

    textured = [c for c in job.components if (root / textured_folder(c.index) / "mesh.ply").exists()]
    _each_surface(job, textured, make)


def _each_surface(job: Job, components: list[Component], run: Callable[[Component], None]) -> None:
    """Run for every component; one that cannot have a surface does not cost the others theirs."""
    failures = []
    for component in components:
        try:
            run(component)
        except SurfaceError as error:
            failures.append(error)
            job.reporter.warning(Text("Part {}: {}", component.index + 1, error.message))
    if failures and len(failures) == len(components):
        raise failures[0]


def _drop_textures(job: Job) -> None:
    for component in job.components:
        shutil.rmtree(job.root / textured_folder(component.index), ignore_errors=True)
        for level in DETAILS:
            shutil.rmtree(job.root / detail_folder(component.index, level), ignore_errors=True)


# ---- the table

DEPTH = Stage(
    name="depth", version=4, weight=0.65, files=("depth/*.npz",), run=_estimate_depths, options=("precision",),
    inputs=_weights, in_budget=True,
)
STAGES = {stage.name: stage for stage in (
    Stage(name="photos", version=5, weight=0.02, files=(photos_record.FILE_NAME,), run=_check, inputs=_photo_files,
          load=_load_photos, options=("surplus",)),
    Stage(name="sparse", version=8, weight=0.2, files=("sparse/mapped/[0-9]*/*",), run=_find_cameras,
          options=("preset.sfm_image_size", "preset.max_features"), inputs=_model),
    Stage(name="adjust", version=7, weight=0.02, run=_adjust, inputs=_control, load=_tell_checks,
          files=("sparse/[0-9]*/*.bin", "sparse/[0-9]*/frame.json", "sparse/[0-9]*/accuracy.json",
                 "sparse/[0-9]*/precision.npz")),
    Stage(name="views", version=3, weight=0.03, files=(views_record.FILE_NAME, "undistorted/*"), run=_prepare_views,
          options=("image_size", "source_views"), load=_load_views),
    DEPTH,
    Stage(name="fusion", version=3, weight=0.1, files=("cloud*.ply",), run=_fuse, in_budget=True,
          options=("min_confidence", "min_views", "max_reprojection_error", "max_depth_difference")),
    Stage(name="mesh", version=9, weight=0.15, files=("mesh*.ply",), run=_build_meshes, inputs=_edits,
          options=("fill_holes", "extent", "mesh_faces", "region", "region_turn")),
    Stage(name="texture", version=6, weight=0.25, files=("textured*/*",), run=_texture_meshes,
          options=("texture_size", "texture_format")),
)}
DETAIL_STAGES = {level: Stage(
    name=f"detail_{level}", version=4, weight=0.15, files=(f"detail*/{level}/*",), run=partial(_make_detail, level),
    options=("texture_size", "texture_format"), last=True,
) for level in DETAILS}


# ---- what a stage depends on outside of the workspace


@contextmanager
def _photos_must_stay(job: Job) -> Iterator[None]:
    """Raise PhotoError when a photo was changed, moved or deleted since the job began: whatever went wrong in the
    block is then its consequence, and what went well may be of two states of it."""
    try:
        yield
    finally:
        for photo in job.photo_set.photos:
            now = _size_and_time(photo.path)
            if now != job.files[photo.path]:
                what = "changed" if now else "moved or deleted"
                raise PhotoError(
                    Text("{} was {} while the job was running.", photo.path.name, Text(what)),
                    remedy="Put it back if it should be used, then run it again: the photos are checked anew.",
                    path=photo.path,
                )


def _size_and_time(file: Path) -> tuple[int, ...]:
    """A file's size in bytes and time of change in nanoseconds; () when it is not there."""
    try:
        status = file.stat()
    except FileNotFoundError:
        return ()
    return status.st_size, status.st_mtime_ns


def _digest(model: Path) -> str:
    """Digest of a given model's files, so that another model, or a changed one, is seen as such."""
    files = sorted(p for p in model.rglob("*") if p.suffix in (".bin", ".txt")) if model.is_dir() else []
    if not files:
        raise SparseError(
            Text("{} holds no COLMAP model.", model), path=model,
            remedy="Choose the folder with cameras, images and points3D as .bin or .txt.",
        )
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()
