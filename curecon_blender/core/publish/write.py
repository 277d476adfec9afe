# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A site's folder: tiles of its surface and its cloud, pictures, figures, and what its page needs to know of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import CuReconError
from ..base.files import write_json
from ..base.geodesy import enu_from_ecef
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import EXACT
from ..base.records import Component, Frame
from ..cloud.edits import edited_blocks
from ..deliver.ortho import read_pages
from ..deliver.placement import DeliverError
from ..report.measure import subject
from ..report.write import FOLDER as REPORT
from ..surface.mesh import Mesh, filled_share, read_mesh, unseen_share, weak_share
from . import folder as site_files
from . import page, privacy, tiles
from .levels import Level, coarser, texel
from .records import About, PublishError

STAGES = {"levels": 5.0, "tiles": 3.0, "cloud": 2.0, "pages": 1.0}
_MOST_POINTS = 2_000_000  # of the cloud: more make the pages large, and show nothing more on a screen
_BLOCK = 1 << 20  # points read at once
_SUBJECT = (0.01, 0.99)  # of the subject along each axis: the page begins with a view of that


@dataclass(frozen=True, kw_only=True)
class Source:
    """A finished component in its workspace: `matrix` (4,4) takes it to the site frame, which `frame` describes; `mesh`
    is its mesh's file, None where there is none; `taken` the day of its photos."""

    workspace: Path
    component: Component
    frame: Frame
    matrix: np.ndarray
    mesh: Path | None
    taken: date | None = None

    def place(self, points: np.ndarray) -> np.ndarray:
        """(N,3) as reconstructed -> (N,3) float64 in the site frame."""
        placed: np.ndarray = points.astype(np.float64) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return placed

    @property
    def metre(self) -> float:
        """How long a unit as reconstructed is in the site frame."""
        return float(np.cbrt(np.linalg.det(self.matrix[:3, :3])))


def write_site(source: Source, about: About, folder: Path, reporter: Reporter) -> dict[str, Any]:
    """Write a site's files into its empty folder; what was made, in figures. What cannot be shown is told as a warning.
    Raises PublishError where nothing can be, WorkspaceError, Cancelled."""
    shown = privacy.shown(source.frame, about.location)
    if source.frame.scale != "metres":
        reporter.warning("The scale is unknown: the page tells its visitors not to measure. Set the scale, then "
                         "publish again.")
    reporter.stage("levels")
    levels = _levels(source, folder, reporter)
    reporter.stage("tiles")
    surface, cloud, views = None, None, []
    if levels:
        surface, picture, places = _surface(source, levels, about, folder, reporter)
        views.append(places)
    reporter.stage("cloud")
    points, colours, count = _cloud(source, reporter)
    if len(points):
        to = _destination(source, about, folder / "cloud")
        cloud = {**asdict(tiles.write_cloud(points, colours, to, reporter)), "points": len(points), "of": count,
                 "tileset": f"cloud/{tiles.TILESET}"}
        views.append(points)
    if not views:
        raise PublishError("The site has no surface and no points.", remedy="Run Reconstruct to the end first.",
                           path=source.workspace)
    reporter.stage("pages")
    if not levels:
        picture = page.thumbnail_of_cloud(points, colours)
    page.write_picture(folder / "thumbnail.jpg", picture)
    known = page.figures(source.workspace / REPORT / "report.json", source.component.index, count,
                         surface["faces"] if surface else 0, reporter)
    near, _ = subject(views[-1])  # of the cloud, where there is one: it is densest about the subject
    low, high = np.quantile(views[-1][near], _SUBJECT, axis=0)
    record = {
        "format": 1, "id": about.id, "title": about.title, "text": about.text, "place": about.place,
        "credit": about.credit, "licence": about.licence, "taken": source.taken and source.taken.isoformat(),
        "location": shown.location, "geometry": shown.geometry,
        "metres": source.frame.scale == "metres", "north": source.frame.north, "doubt": bool(source.frame.doubt),
        "box": np.round([low, high], 3).tolist(), "surface": surface, "cloud": cloud, "figures": known,
        "notes": [asdict(note) for note in about.notes],
        "pictures": page.pictures(source.workspace, about.location, folder, reporter),
        "film": page.film(source.workspace, folder, reporter),
        "report": page.report(source.workspace, about.location, folder),
    }
    write_json(folder / "site.json", record)
    site_files.copy(site_files.PAGES / "site.html", folder / "index.html")
    write_json(folder / "item.json", site_files.item(about, shown, source.taken, _assets(record)))
    return record


def _levels(source: Source, folder: Path, reporter: Reporter) -> list[Level]:
    """The surface's levels, the coarsest first; none without a mesh."""
    if source.mesh is None:
        reporter.warning("There is no mesh: the page shows the cloud alone. Press Build Mesh, then publish again.")
        return []
    mesh, pages = read_mesh(source.mesh), np.zeros((0, 1, 1, 3), np.uint8)
    if not len(mesh.faces):
        reporter.warning("The mesh has no faces: the page shows the cloud alone.")
        return []
    if mesh.pages:
        try:
            pages = read_pages(source.mesh.parent, mesh.pages)
        except DeliverError as error:
            reporter.warning(Text("The surface is shown with the colours of its vertices. {} {}", error.message,
                                  error.remedy))
    if len(pages) and mesh.page is not None and not set(np.unique(mesh.page)) <= set(range(len(pages))):
        raise PublishError(Text("{} names pages of its texture that are not there.", source.mesh),
                           remedy="Run Texture again.",
                           path=source.mesh)
    if not len(pages):
        mesh = Mesh(vertices=mesh.vertices, faces=mesh.faces, colours=mesh.colours, distance=mesh.distance,
                    views=mesh.views, filled=mesh.filled, weak=mesh.weak, unseen=mesh.unseen)
    levels = coarser(mesh, source.mesh.parent, folder, reporter)
    return [*levels, Level(mesh, pages, texel(mesh, pages))]


def _destination(source: Source, about: About, folder: Path) -> tiles.Destination:
    return tiles.Destination(folder=folder, place=source.place, unit=source.metre, copyright=about.copyright)


def _surface(
    source: Source, levels: list[Level], about: About, folder: Path, reporter: Reporter
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """What was written of a surface, its thumbnail (H,W,3), and vertices (N,3) in the site frame."""
    to = _destination(source, about, folder / "surface")
    made = tiles.write_surface(levels, to, reporter)
    finest = levels[-1].mesh
    if about.location == EXACT and source.frame.origin is not None and source.frame.north \
            and source.frame.scale == "metres":
        rotation, centre = enu_from_ecef(source.frame.origin)
        tiles.write_earth(to.folder, rotation, centre)
    places = source.place(levels[0].mesh.vertices)
    record = {**asdict(made), "faces": len(finest.faces), "textured": len(levels[-1].pages) > 0,
              "filled": filled_share([finest]), "weak": weak_share([finest]), "unseen": unseen_share([finest]),
              "tileset": f"surface/{tiles.TILESET}"}
    return record, page.thumbnail_of_surface(levels[0], places), places


def _cloud(source: Source, reporter: Reporter) -> tuple[np.ndarray, np.ndarray, int]:
    """Points (N,3) of the cloud in the site frame, at most _MOST_POINTS spread over it, their colours (N,3), and how
    many the cloud has."""
    path = source.workspace / source.component.cloud
    try:
        blocks = [(block.points, block.colours) for block in edited_blocks(path, _BLOCK) if len(block)]
    except CuReconError:
        if source.mesh is None:
            raise
        reporter.warning(Text("{} cannot be read: the page shows the surface alone.", path.name))
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), 0
    count = sum(len(points) for points, _ in blocks)
    if not count:
        return np.zeros((0, 3)), np.zeros((0, 3), np.uint8), 0
    chosen = np.random.default_rng(0)
    kept = [chosen.random(len(points)) < _MOST_POINTS / count for points, _ in blocks]
    places = np.concatenate([source.place(points[which]) for (points, _), which in zip(blocks, kept, strict=True)])
    return places, np.concatenate([colours[which] for (_, colours), which in zip(blocks, kept, strict=True)]), count


def _assets(record: dict[str, Any]) -> dict[str, tuple[str, str, list[str]]]:
    assets = {"page": ("./index.html", "text/html", ["overview"]),
              "thumbnail": ("./thumbnail.jpg", "image/jpeg", ["thumbnail"])}
    for name in ("surface", "cloud"):
        if record[name]:
            assets[name] = (f"./{record[name]['tileset']}", "application/json", ["data"])
    if record["film"]:
        assets["film"] = (f"./{record['film']}", "video/mp4", ["overview"])
    if record["report"]:
        assets["report"] = (f"./{record['report']}", "application/pdf", ["metadata"])
    return assets

