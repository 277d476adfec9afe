# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A published folder: what a visitor sees of the site, and what nobody can find in it."""

from __future__ import annotations

import functools
import http.server
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import published
import pytest
from conftest import ROOT, MakeOnce, Run
from little_site import CREDIT, FRAME
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from scipy.spatial import cKDTree

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.base.options import CELL, EXACT, HIDDEN
from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.cloud.ply import read_cloud
from curecon_blender.core.publish import levels, page, privacy, tiles
from curecon_blender.core.publish.records import About, Note
from curecon_blender.core.run.publish import publish
from curecon_blender.core.surface.mesh import Mesh, read_mesh
from curecon_blender.core.surface.triangles import face_neighbours, face_normals

MODULES = ROOT / "web" / "node_modules"
PATIENCE = 400  # seconds for the whole tour on a busy computer
TITLE = "<b>Yude \"Lou\"</b> 土楼 / ..\\.. '\n"
PUBLISHED = {"MOST_FACES": 400, "MOST_POINTS": 2000}  # so that a small site has many tiles


@pytest.fixture(scope="session")
def told(textured: tuple[Path, Run], made_once: MakeOnce[Path]) -> Path:
    """A finished workspace with pictures and a report that tell its place in text and in metadata. Read only."""
    def make(folder: Path) -> Path:
        shutil.copytree(textured[0], folder / "w")
        secret = PngInfo()
        secret.add_text("Comment", "24.658307 117.052089 DJI_0014 10:48:05")
        (folder / "w" / "presentation").mkdir()
        for name in ("still_1", "1_north"):
            Image.new("RGB", (64, 48), "brown").save(folder / "w" / "presentation" / f"{name}.png", pnginfo=secret)
        write_film(folder / "w" / "presentation" / "film.mp4")
        (folder / "w" / "report").mkdir()
        (folder / "w" / "report" / "report.pdf").write_bytes(b"%PDF-1.4 24.658307 117.052089 DJI_0014")
        mesh = read_mesh(folder / "w" / "textured" / "mesh.ply")
        (folder / "w" / "report" / "report.json").write_text(json.dumps({"parts": [{
            "index": 0, "points": textured[1].summary["points"], "faces": len(mesh.faces),
            "clearness": {"pixel": {"low": 0.03, "median": 0.048, "high": 0.06}},
            "correctness": {"reprojection_error": 0.32, "check": {"rms": [0.03, 0.04, 0.12]}, "control": None,
                            "rests_on": "24.658307 117.052089"}}]}))
        return folder / "w"
    return made_once("told", make)


@pytest.fixture(scope="session")
def site(told: Path, made_once: MakeOnce[Path]) -> Callable[[str], Path]:
    """The folder published of it at a level of privacy, in several levels of many tiles. Read only."""
    def of(location: str) -> Path:
        def make(folder: Path) -> Path:
            shutil.copytree(told, folder / "w")
            places = known_places(told)
            about = About(
                title=TITLE, location=location, text="Round & <i>old</i>", place="Fujian", credit=CREDIT,
                licence="CC-BY-4.0", notes=(Note(title="<script>alert(1)</script>", text="\"&'", place=places[0]),))
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(levels, "COARSEST", 250)
                for name, value in PUBLISHED.items():
                    patch.setattr(tiles, name, value)
                publish(folder / "w", folder / "out", about, 1, Reporter())
            return folder / "out"
        return made_once(f"published_{location}", make)
    return of


def write_film(path: Path) -> None:
    """A film of ten grey pictures whose metadata tell the site's place: in the film's own, and in a box beside."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"vp09"), 10, (64, 48))
    for shade in range(100, 200, 10):
        writer.write(np.full((48, 64, 3), shade, np.uint8))
    writer.release()
    film = path.read_bytes()
    at = film.index(b"moov") - 4  # its index comes last, and grows
    own, beside = _box(b"udta", b"24.658307 117.052089 DJI_0014"), _box(b"uuid", b"10:48:05 DJI_0014")
    path.write_bytes(film[:at] + _box(b"moov", film[at + 8 :] + own) + beside)


def _box(kind: bytes, content: bytes) -> bytes:
    return (8 + len(content)).to_bytes(4, "big") + kind + content


def known_places(workspace: Path) -> list[tuple[float, float, float]]:
    """Two vertices of the surface far apart, in the site frame: on level ground, far from its borders."""
    mesh = read_mesh(workspace / "textured" / "mesh.ply")
    neighbours, normals = face_neighbours(mesh.faces), face_normals(mesh.vertices.astype(float), mesh.faces)
    level = (normals[:, 2] > 0.95 * np.linalg.norm(normals, axis=1)) & ~mesh.filled
    border = mesh.vertices[np.unique(mesh.faces[(neighbours < 0).any(axis=1) | ~level])]
    far = cKDTree(border).query(mesh.vertices)[0]
    found = mesh.vertices[np.argsort(-far)[:30]].astype(float)
    apart = np.linalg.norm(found[:, None] - found, axis=2)
    ends = np.unravel_index(np.argmax(apart), apart.shape)
    return [tuple(map(float, found[end])) for end in ends]


def only_site(folder: Path) -> Path:
    (found,) = (folder / "sites").iterdir()
    return found


@pytest.mark.parametrize("location", [CELL, HIDDEN])
def test_no_byte_below_exact_tells_where_when_or_from_which_photos(
    site: Callable[[str], Path], told: Path, location: str
) -> None:
    needles = published.needles(told)
    assert len(needles) > 20
    assert not (found := published.telling(site(location), needles)), "\n".join(found)
    item = json.loads((only_site(site(location)) / "item.json").read_text())
    assert item["properties"]["datetime"] == "2024-09-28T00:00:00Z"
    assert (item["geometry"] is None) == (location == HIDDEN)
    assert [path.name for path in only_site(site(location)).glob("pictures/*")] == ["1.jpg"]  # none with writing on it


def test_the_search_finds_what_there_is_to_find(site: Callable[[str], Path], told: Path) -> None:
    needles = published.needles(told)
    exact = "\n".join(published.telling(site(EXACT), needles))
    for what in ("item.json: latitude as text", "site.json: longitude as text", "report.pdf: packed"):
        assert what in exact, exact
    workspace = "\n".join(published.telling(told, needles))
    for what in ("altitude as text", "photo DJI_0014", "time of DJI_0014", "GPS of DJI_0014", "still_1.png: Comment",
                 "film.mp4: photo DJI_0014"):
        assert what in workspace, what
    earth = json.loads((only_site(site(EXACT)) / "surface" / "earth.json").read_text())["root"]["transform"]
    assert np.linalg.norm(earth[12:15]) == pytest.approx(6.375e6, rel=1e-3)
    assert not (only_site(site(CELL)) / "surface" / "earth.json").exists()


def test_a_film_goes_along_as_it_was_and_one_that_may_tell_more_stays(
    site: Callable[[str], Path], told: Path, tmp_path: Path
) -> None:
    film = only_site(site(CELL)) / "film.mp4"
    assert "film" in json.loads((film.parent / "item.json").read_text())["assets"]
    shown, rendered = ([*_frames(path)] for path in (film, told / "presentation" / "film.mp4"))
    assert len(shown) == 10 and np.array_equal(shown, rendered)
    (tmp_path / "presentation").mkdir()
    sound = film.read_bytes()
    for spoiled in (sound.replace(b"vide", b"soun"), sound[:-20], b"", b"RIFF    AVI LIST"):
        (tmp_path / "presentation" / "film.mp4").write_bytes(spoiled)
        reporter = Reporter()
        assert page.film(tmp_path, tmp_path, reporter) is None and not (tmp_path / "film.mp4").exists()
        assert "film.mp4 is left out" in reporter.warnings[0]


def _frames(path: Path) -> Iterator[np.ndarray]:
    film = cv2.VideoCapture(str(path))
    while True:
        more, frame = film.read()
        if not more:
            return
        yield frame


def test_all_places_of_a_cell_are_shown_alike() -> None:
    assert FRAME.origin is not None
    cells = []
    for north in (0.0, 0.0004, -0.0004, 0.05):
        origin = replace(FRAME.origin, latitude=FRAME.origin.latitude + north, altitude=100 * north)
        cells.append(privacy.shown(replace(FRAME, origin=origin), CELL))
        box = cells[-1].box
        assert box is not None and box[0] < origin.longitude < box[2] and box[1] < origin.latitude < box[3]
    assert cells[0] == cells[1] == cells[2] != cells[3]
    ring = np.array(cells[0].geometry["coordinates"][0])  # type: ignore[index]
    sides = np.linalg.norm(np.diff(ring, axis=0) * [111_320 * np.cos(np.radians(ring[0, 1])), 110_770], axis=1)
    assert np.abs(sides - 1000).max() < 5
    south = privacy.shown(replace(FRAME, origin=GeoPosition(latitude=-13.16, longitude=-72.54, altitude=None)), CELL)
    assert south.box is not None and south.box[1] < -13.16 < south.box[3] and south.box[0] < -72.54 < south.box[2]
    unknown = privacy.shown(replace(FRAME, origin=None), EXACT)
    assert unknown.geometry is None and "not known" in unknown.sentences[0][0]


def test_tiles_hold_the_whole_surface_where_it_is(site: Callable[[str], Path], told: Path) -> None:
    mesh = read_mesh(told / "textured" / "mesh.ply")
    tree, middles = cKDTree(mesh.vertices), cKDTree(mesh.vertices[mesh.faces].mean(axis=1))
    found = [*published.tiles(only_site(site(CELL)) / "surface")]
    assert len(found) > 8 and max(tile.depth for tile in found) == 2 and sum(tile.depth == 0 for tile in found) == 1
    faces = filled = 0
    colours_off = []
    for tile in found:
        assert "CC-BY-4.0" in tile.copyright and tile.primitives
        for part in tile.primitives:
            assert (np.abs(part.places[np.unique(part.faces)] - tile.box[0]) <= tile.box[1]).all()
            if not tile.leaf:
                continue
            off = tree.query(part.places)[0]
            assert off.max() <= tile.error < 0.01, "height error above the finest tiles' geometricError"
            face = middles.query(part.places[part.faces].mean(axis=1))[1]
            kind = np.where(mesh.filled, "filled", np.where(mesh.unseen, "unseen", "measured"))
            assert (kind[face] == part.material).all()
            faces += len(part.faces)
            filled += len(part.faces) * (part.material == "filled")
            assert part.uv is not None and part.picture is not None
            colours_off.append(_colours_off(part, mesh, face, told / "textured"))
    # A tile of one face may well be off by a texel at an edge: the site as a whole is not.
    assert np.concatenate(colours_off).mean() < 6
    assert faces == len(mesh.faces) and filled == mesh.filled.sum() > 0
    assert max(path.stat().st_size for path in site(CELL).rglob("*.glb")) <= tiles.LARGEST_TILE


def _colours_off(part: published.Primitive, mesh: Mesh, face: np.ndarray, folder: Path) -> np.ndarray:
    """How far the tile's picture is from the texture in the middle of each face, (F, 3) of 255."""
    assert part.uv is not None and part.picture is not None and mesh.uv is not None and mesh.page is not None
    pages = np.stack([np.asarray(Image.open(folder / name).convert("RGB")) for name in mesh.pages]).astype(float)
    here = part.uv[part.faces].mean(axis=1) * part.picture.shape[1::-1]
    there = mesh.uv[face].mean(axis=1)
    there = np.column_stack([there[:, 0], 1 - there[:, 1]]) * pages.shape[1]
    x, y = np.clip(there.astype(int), 0, pages.shape[1] - 1).T
    u, v = (np.minimum(here[:, axis].astype(int), part.picture.shape[1 - axis] - 1) for axis in (0, 1))
    return np.abs(part.picture[v, u] - pages[mesh.page[face], y, x])


def test_a_coarser_level_is_off_by_no_more_than_it_says(site: Callable[[str], Path], told: Path) -> None:
    mesh = read_mesh(told / "textured" / "mesh.ply")
    for depth in (0, 1):
        parts = [(part.places[part.faces], tile.error) for tile in published.tiles(only_site(site(CELL)) / "surface")
                 if tile.depth == depth for part in tile.primitives]
        corners = np.concatenate([triangles for triangles, _ in parts])
        # Places spread over the coarse triangles, dense beside their own size.
        weights = np.random.default_rng(0).dirichlet([1, 1, 1], 60)
        places = np.einsum("wk,mkc->mwc", weights, corners).reshape(-1, 3)
        off = cKDTree(places).query(mesh.vertices)[0]
        assert np.quantile(off, 0.9) <= 1.5 * parts[0][1]


def test_the_cloud_is_there_once(site: Callable[[str], Path], told: Path) -> None:
    record = json.loads((only_site(site(CELL)) / "site.json").read_text())
    found = [part for tile in published.tiles(only_site(site(CELL)) / "cloud") for part in tile.primitives]
    places = np.concatenate([part.places for part in found])
    assert len(found) > 3 and len(places) == record["cloud"]["points"] == record["cloud"]["of"] > 4000
    cloud = read_cloud(told / "cloud.ply")
    off, point = cKDTree(cloud.points).query(places)
    assert off.max() < 0.02
    colours = np.concatenate([part.colours for part in found if part.colours is not None])[:, :3]
    shown = 255 * np.where(colours <= 0.0031308, 12.92 * colours, 1.055 * colours ** (1 / 2.4) - 0.055)
    assert np.abs(shown - cloud.colours[point]).mean() < 3


def test_the_page_says_how_exact_the_site_is_or_that_nobody_knows(
    site: Callable[[str], Path], told: Path
) -> None:
    record = json.loads((only_site(site(CELL)) / "site.json").read_text())
    assert record["figures"] == {"pixel": 0.048, "reprojection": 0.32, "check": pytest.approx(0.13)}
    assert record["taken"] == "2024-09-28" and record["metres"] and record["title"] == TITLE
    mesh = read_mesh(told / "textured" / "mesh.ply")
    for mark in ("filled", "weak", "unseen"):
        which = getattr(mesh, mark)
        assert record["surface"][mark] == pytest.approx(mesh.areas[which].sum() / mesh.areas.sum() if which is not None
                                                        else 0)


def test_khronos_finds_nothing_wrong_with_any_tile(site: Callable[[str], Path]) -> None:
    if not (MODULES / "gltf-validator").is_dir():
        pytest.skip("NOT VALIDATED: no gltf-validator; npm ci --prefix web")
    ran = subprocess.run(["node", ROOT / "tests" / "web" / "validate.mjs", site(CELL)], capture_output=True, text=True,
                         check=True)
    said = json.loads(ran.stdout)
    assert said["files"] > 10 and not said["wrong"], "\n".join(said["wrong"])


def test_the_libraries_are_what_their_lock_makes(tmp_path: Path) -> None:
    if not (MODULES / "esbuild").is_dir():
        pytest.skip("NOT BUILT anew: no esbuild; npm ci --prefix web")
    subprocess.run(["node", ROOT / "web" / "build.mjs", tmp_path], check=True)
    kept = ROOT / "curecon_blender" / "pages" / "vendor"
    assert {path.name for path in kept.iterdir()} == {path.name for path in tmp_path.iterdir()}
    assert not [path.name for path in kept.iterdir() if path.read_bytes() != (tmp_path / path.name).read_bytes()]


@contextmanager
def served(folder: Path) -> Iterator[tuple[str, list[tuple[str, int]]]]:
    """A folder on this computer's loopback, and what was fetched of it, in order: paths and bytes."""
    fetched: list[tuple[str, int]] = []

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None: ...

        def do_GET(self) -> None:
            path = Path(self.translate_path(self.path))
            fetched.append((self.path, path.stat().st_size if path.is_file() else 0))
            super().do_GET()

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/", fetched
        finally:
            server.shutdown()


def test_a_visitor_finds_turns_and_measures_the_site(site: Callable[[str], Path], told: Path, tmp_path: Path) -> None:
    """In headless Chromium, on a desktop and on a phone; the folder served as it is."""
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("NOT TESTED in a browser: no chromium; apt-get install chromium, or set CHROMIUM")
    if not (MODULES / "playwright-core").is_dir():
        pytest.skip("NOT TESTED in a browser: no playwright-core; npm ci --prefix web")
    places = known_places(told)
    identity = only_site(site(CELL)).name
    with served(site(CELL)) as (address, fetched):
        ran = subprocess.run(
            ["node", ROOT / "tests" / "web" / "browse.mjs", chromium, address, identity, json.dumps(places), tmp_path],
            capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert ran.returncode == 0, ran.stderr
    found: dict[str, Any] = json.loads(ran.stdout)
    assert not found["wrong"], "\n".join(found["wrong"])
    assert (found["marks"], found["list"], found["none"]) == (1, 1, 0)
    assert found["popup"].strip() == found["followed"].strip() == " ".join(TITLE.split())
    assert (found["chinese"], found["phone"]) == ("遗址", "测量")
    metres = float(found["measured"].split()[1])
    assert metres == pytest.approx(np.linalg.norm(np.subtract(*places)), rel=0.01), found["measured"]
    # A link keeps millimetres, which may tip a centimetre that was rounded.
    assert float(found["again"].split()[1]) == pytest.approx(metres, abs=0.011)
    assert found["film"] == 64  # pixels wide: it plays
    assert found["note"].startswith("<script>alert(1)</script>") and found["wide"] <= 390
    sent = [path for path, _ in fetched]
    first = sent.index(f"/sites/{identity}/index.html", sent.index("/index.html") + 1)
    shown = sent.index(f"/sites/{identity}/surface/0.glb", first)
    assert sum(size for _, size in fetched[first : shown + 1]) < 1_500_000, "bytes to the first complete view"
    for text in ("Somewhere in a square of 1 km", "Round & <i>old</i>", "48 mm", "130 mm", "was not measured"):
        assert text in found["about"], found["about"]
    for name in ("map", "site", "section", "phone"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert len(set(picture.convert("RGB").resize((200, 200)).getdata())) > 500, f"{name} shows nothing"
