# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The flow: photos, sparse model, views, depth maps, fused cloud, mesh, texture. A stage that is already done is
skipped."""

from __future__ import annotations

import hashlib
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import psutil

from ..base.allocator import release
from ..base.errors import DeviceError, PhotoError, SparseError, SurfaceError, WorkspaceError, ran_out_of_memory
from ..base.files import scratch_folder
from ..base.messages import Reporter
from ..base.options import STAGES, SURFACE_STAGES, Options
from ..base.records import Component, PhotoSet
from ..cloud.ply import point_count
from ..photos import record as photos_record
from ..photos.record import read_photos, write_photos
from ..surface.mesh import filled_share, mesh_file, read_mesh, textured_folder, write_mesh
from ..views import record as components_file
from .workspace import StageRecord, Workspace, folder_bytes, key_of


def reconstruct(options: Options, reporter: Reporter) -> dict[str, Any]:
    """Run the job to `options.until` and return its JSON summary; without photos, from the finished cloud on.

    The stages read and write the workspace only, so a second run finds them done and a killed one goes on. Raises
    the CuReconError of whichever stage cannot go on; what was finished before it stays.
    """
    stages = STAGES[: STAGES.index(options.until) + 1]
    if options.photos is None:
        stages = tuple(stage for stage in stages if stage in SURFACE_STAGES)
        if not (options.workspace / "workspace.json").is_file():
            raise WorkspaceError(
                f"{options.workspace} is not a workspace of CU-Recon.", path=options.workspace,
                remedy="Choose the folder that Reconstruct made, or run Reconstruct first.",
            )
    reporter.begin(stages)
    if options.scheduler and "depth" in stages:  # a wrong address is told now, not when the cameras are found
        from ..depth.cluster import connect

        with connect(options.scheduler):
            pass
    with Workspace(options.workspace) as workspace:
        job = _Job(options, workspace, reporter)
        if options.photos is None:
            job.take_up()
        runs: dict[str, Callable[[], None]] = {
            "photos": job.photos, "sparse": job.sparse, "views": job.views, "depth": job.depth, "fusion": job.fusion,
            "mesh": job.mesh, "texture": job.texture,
        }
        for stage in stages:
            reporter.stage(stage)
            runs[stage]()
            reporter.progress(1, 1, fresh=False)
        return job.summary(stages)


def check(options: Options, thumbnails: Path | None, reporter: Reporter) -> dict[str, Any]:
    """The photo check alone: what was found, and what each quality would cost here. Only the folder `thumbnails` is
    written, with small pictures of doubtful photos."""
    from ..photos.check import check_photos, describe, write_thumbnails
    from . import cost

    assert options.photos is not None
    reporter.begin(("photos",))
    reporter.stage("photos")
    photo_set = check_photos(options.photos, reporter)
    summary = describe(photo_set)
    if thumbnails is not None:
        files = write_thumbnails(photo_set, thumbnails)
        for doubtful in summary["doubtful"]:
            doubtful["thumbnail"] = str(files.get(doubtful["name"], ""))
    try:
        slowness = cost.slowness_here(options.device, options.speeds)
    except DeviceError as error:
        reporter.warning(f"{error.message} {error.remedy}")
        slowness = cost.slowness_here("cpu", options.speeds)
    return {
        **summary, **cost.free(options.workspace), "presets": cost.predict_all(photo_set.photos, options, slowness),
    }


class _Job:
    """One run over an open workspace: holds what a stage hands to the next."""

    def __init__(self, options: Options, workspace: Workspace, reporter: Reporter) -> None:
        self.options, self.workspace, self.reporter = options, workspace, reporter
        self.photo_set = PhotoSet(photos=())
        self.components: list[Component] = []
        self.files: dict[Path, tuple[int, ...]] = {}  # the photos' sizes (bytes) and times (ns) when the job began
        self.key = ""  # of the stage just done; every stage's key takes in the one before

    def take_up(self) -> None:
        """Begin after fusion, from what the workspace holds. Raises WorkspaceError when its cloud is not finished."""
        root, record = self.workspace.root, self.workspace.record("fusion")
        if record is None:
            raise WorkspaceError(
                f"The cloud of {root} is not finished.", remedy="Run Reconstruct to the end first.", path=root,
            )
        self.photo_set = read_photos(root)
        self.components, self.key = components_file.read(root), record.key
        if any(not view.original for component in self.components for view in component.views):
            self.reporter.warning(
                "This workspace names photos on a network drive, which are left alone: a stranger could have written "
                "that, to make your computer log in to his. Texture comes from the smaller pictures in the workspace. "
                "If the photos are yours, run Reconstruct with them up to the texture."
            )

    def photos(self) -> None:
        from ..photos.check import check_photos, find_photos

        assert self.options.photos is not None
        source = self.options.photos.absolute()
        self.files = {path: _size_and_time(path) for path in find_photos(source)}
        root = self.workspace.root

        def run() -> None:
            write_photos(root, check_photos(source, self.reporter, list(self.files)))

        self._stage("photos", {"files": [(str(path), *facts) for path, facts in self.files.items()]}, run,
                    [photos_record.FILE_NAME])
        self.photo_set = read_photos(root)
        if not {photo.path for photo in self.photo_set.photos} <= set(self.files):
            raise WorkspaceError(
                f"{root / photos_record.FILE_NAME} names photos that are not in {source}.", path=root,
                remedy=f"Delete the folder {root / 'stages'} and run Reconstruct again.",
            )
        # What follows depends on the pictures and not on where they lie: a moved or copied folder is checked again,
        # and finds everything else done.
        self.key = key_of([{**asdict(photo), "path": None} for photo in self.photo_set.photos])

    def sparse(self) -> None:
        from ..sparse import find_cameras as sparse
        from . import cost

        options = self.options
        inputs: dict[str, Any] = {"model": _digest(options.model)} if options.model else {"mapper": options.mapper}
        inputs["image_size"] = options.preset.sfm_image_size

        def find_cameras() -> None:
            # The database ends the process when its disk is full, so what it may need is asked for beforehand.
            self.workspace.require_space(cost.disk_bytes(self.photo_set.photos, options))
            if options.model:
                sparse.import_model(options.model, self.photo_set, options, self.workspace.root, self.reporter)
            else:
                sparse.reconstruct(self.photo_set, options, self.workspace.root, self.reporter)

        def run() -> None:
            with self._photos_must_stay():
                find_cameras()

        self._stage("sparse", inputs, run, ["sparse/[0-9]*/*.bin", "sparse/[0-9]*/frame.json"])

    def views(self) -> None:
        from ..views.prepare import prepare_views
        from ..views.scores import BEYOND
        from . import cost

        def run() -> None:
            self.workspace.require_space(cost.depth_bytes(self.photo_set.photos, self.options))
            with self._photos_must_stay():
                found = prepare_views(self.photo_set, self.options, root, self.reporter)
            components_file.write(root, found)

        root = self.workspace.root
        inputs = {"image_size": self.options.image_size, "sources": self.options.source_views, "points": True,
                  "beyond": BEYOND}
        self._stage("views", inputs, run, [components_file.FILE_NAME, "undistorted/*"])
        self.components = self._following_the_photos(components_file.read(root))

    def depth(self) -> None:
        from ..depth.estimate import estimate_depths
        from ..network import weights

        record = weights.describe(self.options.weights)
        inputs = {"weights": record["sha256"], "precision": self.options.precision}
        key = self._key("depth", inputs)

        def run() -> None:
            try:
                estimate(self.options)
                return
            except Exception as error:
                if self.options.half_memory or not ran_out_of_memory(error):
                    raise
            # Outside of the except block, or the traceback would hold on to what filled the memory.
            release()
            self.reporter.warning("Memory ran out: the depth maps go on with half the memory budget.")
            estimate(replace(self.options, half_memory=True))

        def estimate(options: Options) -> None:
            if options.scheduler:
                from ..depth.cluster import spread_depths

                spread_depths(self.components, self.workspace.root, options, key, self.reporter)
                return
            network = weights.load_network(options.weights)
            estimate_depths(self.components, network, self.workspace.root, options, key, self.reporter)

        self._stage("depth", inputs, run, ["depth/*.npz"])

    def fusion(self) -> None:
        from ..cloud.fuse import NoPointsError, fuse

        options = self.options
        inputs = {name: getattr(options, name) for name in
                  ("min_confidence", "min_views", "max_reprojection_error", "max_depth_difference")}

        def run() -> None:
            points = 0
            for component in self.components:
                try:
                    points += fuse(component, self.workspace.root, options, self.reporter)
                except NoPointsError as error:
                    if len(self.components) == 1:
                        raise
                    self.reporter.warning(error.message)
            if points == 0:
                raise NoPointsError(
                    "No part of the reconstruction gave a point that enough views agree on.",
                    remedy="Take photos that overlap more, or lower the minimum confidence or the confirming views.",
                )

            self._drop_surfaces(textures_only=False)  # they are of the cloud before

        self._stage("fusion", inputs, run, ["cloud*.ply"])

    def mesh(self) -> None:
        from ..base.rotations import from_quaternion
        from ..cloud.edits import edits_key, read_edited_cloud
        from ..surface.build import MeshOptions, build_mesh

        options, root = self.options, self.workspace.root
        x0, y0, z0, x1, y1, z1 = options.region or (0.0,) * 6
        region = ((x0, y0, z0), (x1, y1, z1)) if options.region else None
        settings = MeshOptions(fill_holes=options.fill_holes, max_faces=options.mesh_faces, region=region)

        def build(component: Component) -> None:
            cloud = read_edited_cloud(root / component.cloud)
            turn = from_quaternion(options.region_turn) if options.region_turn else None
            with scratch_folder(root / "mesh") as scratch:
                # Along the region's own axes, and back.
                if turn is not None:
                    cloud = cloud.rotated(turn)
                mesh = build_mesh(cloud, settings, scratch, self.reporter)
            if turn is not None:
                mesh = replace(mesh, vertices=(mesh.vertices @ turn).astype("float32"))
            write_mesh(root / mesh_file(component.index), mesh)

        def run() -> None:
            self._each_surface([c for c in self.components if (root / c.cloud).exists()], build)
            self._drop_surfaces(textures_only=True)  # they are of the mesh before

        inputs = asdict(settings)
        if options.region_turn:
            inputs["region_turn"] = options.region_turn
        if any(edits := [edits_key(root / component.cloud) for component in self.components]):
            inputs["edits"] = edits
        self._stage("mesh", inputs, run, ["mesh*.ply"])

    def texture(self) -> None:
        from ..texture.texturing import TextureOptions, texture_mesh

        options, root = self.options, self.workspace.root
        settings = TextureOptions(page_size=options.texture_size, jpeg=options.texture_format == "jpeg")

        def paint(component: Component) -> None:
            folder = root / textured_folder(component.index)
            mesh = read_mesh(root / mesh_file(component.index))
            write_mesh(folder / "mesh.ply", texture_mesh(mesh, component, root, settings, folder, self.reporter))

        def run() -> None:
            self._each_surface([c for c in self.components if (root / mesh_file(c.index)).exists()], paint)

        self._stage("texture", {"size": options.texture_size, "format": options.texture_format}, run, ["textured*/*"])

    def _following_the_photos(self, components: list[Component]) -> list[Component]:
        """The components with their views' originals where the photos lie now, kept so in the workspace."""
        places = {photo.name: str(photo.path) for photo in self.photo_set.photos}
        if any(view.original != places[view.name] for component in components for view in component.views):
            components = [replace(component, views=tuple(
                replace(view, original=places[view.name]) for view in component.views
            )) for component in components]
            components_file.write(self.workspace.root, components)
        return components

    @contextmanager
    def _photos_must_stay(self) -> Iterator[None]:
        """Raise PhotoError when a photo was changed, moved or deleted since the job began: whatever went wrong in the
        block is then its consequence, and what went well may be of two states of it."""
        try:
            yield
        finally:
            for photo in self.photo_set.photos:
                now = _size_and_time(photo.path)
                if now != self.files[photo.path]:
                    what = "changed" if now else "moved or deleted"
                    raise PhotoError(
                        f"{photo.path.name} was {what} while the job was running.",
                        remedy="Put it back if it should be used, then run it again: the photos are checked anew.",
                        path=photo.path,
                    )

    def _each_surface(self, components: list[Component], run: Callable[[Component], None]) -> None:
        """Run for every component; one that cannot have a surface does not cost the others theirs."""
        failures = []
        for component in components:
            try:
                run(component)
            except SurfaceError as error:
                failures.append(error)
                self.reporter.warning(f"Part {component.index + 1}: {error.message}")
        if failures and len(failures) == len(components):
            raise failures[0]

    def _drop_surfaces(self, *, textures_only: bool) -> None:
        """Remove what was made from an earlier cloud or mesh, once the new one is there."""
        root = self.workspace.root
        for component in self.components:
            shutil.rmtree(root / textured_folder(component.index), ignore_errors=True)
            if not textures_only:
                (root / mesh_file(component.index)).unlink(missing_ok=True)

    def summary(self, stages: tuple[str, ...]) -> dict[str, Any]:
        """The job's JSON summary: counts, what each stage took when it last ran, and where everything lies."""
        root = self.workspace.root
        cloudy = {"fusion", *SURFACE_STAGES} & set(stages)
        clouds = [root / c.cloud for c in self.components if (root / c.cloud).exists()] if cloudy else []
        records = {stage: self.workspace.record(stage) for stage in stages}
        return {
            "photos": len(self.photo_set.photos),
            "skipped": [{"path": str(s.path), "reason": s.reason} for s in self.photo_set.skipped],
            "registered": sum(_registered(root / "sparse")) if (root / "sparse").is_dir() else 0,
            "components": [
                {"index": c.index, "photos": len(c.views), "scale": c.frame.scale, "up": c.frame.up,
                 "gps_residual": c.frame.gps_residual, "note": c.frame.note, "points": point_count(root / c.cloud)}
                for c in self.components
            ],
            "points": sum(point_count(path) for path in clouds),
            "meshes": [_described(root, c.index) for c in self.components if (root / mesh_file(c.index)).exists()]
            if set(SURFACE_STAGES) & set(stages) else [],
            "seconds": {s: round(r.seconds, 1) for s, r in records.items() if r},
            "peak_memory_gib": {s: round(r.peak_gib, 2) for s, r in records.items() if r},
            "workspace_gib": round(folder_bytes(root) / 2**30, 3),
            "warnings": self.reporter.warnings,
            "paths": {
                "workspace": str(root), "sparse": str(root / "sparse"), "views": str(root / components_file.FILE_NAME),
                "depth": str(root / "depth"), "clouds": [str(path) for path in clouds],
            },
        }

    def _key(self, stage: str, inputs: dict[str, Any]) -> str:
        return key_of({"stage": stage, "before": self.key, **inputs})

    def _stage(self, stage: str, inputs: dict[str, Any], run: Callable[[], None], made: list[str]) -> None:
        """Run a stage unless it is done for the same inputs, and mark it done with what it took and made (patterns of
        files in the workspace)."""
        key = self._key(stage, inputs)
        if not self.workspace.is_done(stage, key):
            self.workspace.reopen(stage)
            release()
            with PeakMemory() as peak:
                started = time.monotonic()
                run()
            root = self.workspace.root
            files = tuple(sorted(p.relative_to(root).as_posix() for pattern in made for p in root.glob(pattern)))
            seconds = time.monotonic() - started
            record = StageRecord(key=key, seconds=seconds, peak_gib=peak.bytes / 2**30, files=files)
            self.workspace.mark_done(stage, record)
            self._learn(stage, record.seconds)
        else:
            self.reporter.log(f"{stage}: already done")
        self.key = key

    def _learn(self, stage: str, seconds: float) -> None:
        """Keep this computer's speed, unless the stage was not run from its start, on the whole site, or here."""
        from . import cost

        options = self.options
        if stage == "depth" and options.scheduler:
            return
        if stage != "photos" and options.photos and not (self.reporter.resumed or options.model or options.region):
            cost.learn(stage, seconds, self.photo_set.photos, options)


class PeakMemory:
    """The largest resident memory of the process and its children while the block runs, sampled ten times a second."""

    def __enter__(self) -> PeakMemory:
        self._process = psutil.Process()
        self.bytes = self._process.memory_info().rss
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._sample, daemon=True)
        self._thread.start()
        return self

    def _sample(self) -> None:
        while not self._stop.wait(0.1):
            self.bytes = max(self.bytes, sum(map(_resident, [self._process, *self._process.children()])))

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()


def _resident(process: psutil.Process) -> int:
    try:
        return int(process.memory_info().rss)
    except psutil.NoSuchProcess:  # a child that has just ended
        return 0


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
            f"{model} holds no COLMAP model.", path=model,
            remedy="Choose the folder with cameras, images and points3D as .bin or .txt.",
        )
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.name.encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()


def _described(root: Path, index: int) -> dict[str, Any]:
    """A component's surface in the summary; its filled share is of the area."""
    textured = root / textured_folder(index) / "mesh.ply"
    mesh = read_mesh(textured if textured.exists() else root / mesh_file(index))
    return {"index": index, "faces": len(mesh.faces), "vertices": len(mesh.vertices),
            "filled_share": round(filled_share([mesh]), 4), "textured": textured.exists()}


def _registered(sparse: Path) -> list[int]:
    """Registered photos of each component: the count that a binary COLMAP model's images begin with."""
    return [int.from_bytes(file.read_bytes()[:8], "little") for file in sorted(sparse.glob("[0-9]*/images.bin"))]
