# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The surface in Blender 4.5 LTS and 5.2 LTS, and what other programs find in its exports."""

from __future__ import annotations

import functools
import http.server
import importlib.util
import json
import os
import shutil
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from test_extension import _blender52, blender, run_alone, run_script  # noqa: F401

from curecon_blender.core.base.errors import WorkspaceError
from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.surface import export
from curecon_blender.core.surface.export import Provenance

WEB = Path(__file__).parent / "web"
MODULES = WEB.parent.parent / "web" / "node_modules"
PATIENCE = 240  # seconds for the page on a busy computer
WEAK, FILLED = 0, 3  # quarters
QUARTERS = np.array([(200, 40, 30), (40, 180, 60), (50, 70, 200), (220, 200, 60)])
ORIGIN = {"crs": "WGS84", "latitude": 24.5, "longitude": 117.25, "altitude": 310.0,
          "altitude_datum": "sea level"}


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def exports(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the little surface exported in every form by that Blender."""
    python = Path(sys.executable) if request.param == "4.5" else _blender52()
    if not python.is_file() or (request.param == "4.5" and importlib.util.find_spec("bpy") is None):
        pytest.skip(f"no Python with bpy {request.param}")
    folder = tmp_path_factory.mktemp("exports")
    run_script(python, "export_surface.py", folder, resources=tmp_path_factory.mktemp("user"))
    return folder


def glb_json(path: Path) -> dict[str, Any]:
    content = path.read_bytes()
    assert struct.unpack("<I", content[8:12])[0] == len(content)
    length = struct.unpack("<I", content[12:16])[0]
    return json.loads(content[20 : 20 + length])


def primitives(path: Path) -> list[dict[str, np.ndarray]]:
    """The attributes of a GLB's primitives, colours from 0 to 1."""
    content, binary = glb_json(path), path.read_bytes()
    start = 20 + struct.unpack("<I", binary[12:16])[0] + 8

    def values(index: int) -> np.ndarray:
        accessor = content["accessors"][index]
        kind = {5121: np.uint8, 5123: np.uint16, 5126: np.float32}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        offset = start + content["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
        rows = np.frombuffer(binary, kind, accessor["count"] * width, offset).reshape(-1, width)
        return rows if kind is np.float32 else rows / np.iinfo(kind).max

    return [{name: values(index) for name, index in primitive["attributes"].items()}
            for mesh in content["meshes"] for primitive in mesh["primitives"]]


def colours_of(mesh: trimesh.Trimesh) -> np.ndarray:
    """sRGB bytes (N,3) of the texture at the vertices."""
    return np.asarray(mesh.visual.to_color().vertex_colors)[:, :3].astype(int)


def z_up(scene: trimesh.Scene) -> list[trimesh.Trimesh]:
    """A GLB's meshes in the site frame again."""
    meshes = scene.dump()
    for mesh in meshes:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return meshes


def found_colours(meshes: list[trimesh.Trimesh]) -> np.ndarray:
    """The colour (4,3) of each quarter's middle, from whichever mesh holds it."""
    places = np.concatenate([mesh.vertices[:, :2] for mesh in meshes])
    colours = np.concatenate([colours_of(mesh) for mesh in meshes])
    middles = np.array([(2.5, 2.5), (7.5, 2.5), (2.5, 7.5), (7.5, 7.5)])
    return colours[np.linalg.norm(places - middles[:, None], axis=2).argmin(axis=1)]


def test_a_surface_comes_in_with_all_that_is_known_of_it(blender: Path, tmp_path: Path) -> None:  # noqa: F811
    run_alone(blender, "check_surface.py", tmp_path)


def test_the_operators_say_why_not_and_what_they_tell_the_worker(
    blender: Path, tmp_path: Path  # noqa: F811
) -> None:
    run_alone(blender, "check_surface_operators.py", tmp_path)


@pytest.mark.parametrize("name", ["textured", "jpeg", "webp", "packed", "pages"])
def test_a_glb_has_the_colours_and_the_size(exports: Path, name: str) -> None:
    meshes = z_up(trimesh.load(exports / f"{name}.glb"))
    corners = np.concatenate([mesh.bounds for mesh in meshes])
    np.testing.assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[0, 0, 0], [10, 10, 1]], atol=1e-5)
    assert sum(len(mesh.faces) for mesh in meshes) == 800
    tolerance = 12 if name in ("jpeg", "webp") else 3
    assert np.abs(found_colours(meshes) - QUARTERS).max() <= tolerance


def test_a_compressed_glb_comes_back_to_half_a_millimetre(exports: Path) -> None:
    content = glb_json(exports / "draco.glb")
    if "KHR_draco_mesh_compression" not in content["extensionsUsed"]:
        pytest.skip("this Blender comes without Draco")
    assert "KHR_draco_mesh_compression" in content["extensionsRequired"]
    assert (exports / "draco.glb").stat().st_size < (exports / "textured.glb").stat().st_size
    vertices = np.load(exports / "draco.npy")  # as Blender reads it back
    grid = np.unique(vertices[:, :2].round(3), axis=0)
    assert len(grid) == 21 * 21 and np.abs(grid - (grid / 0.5).round() * 0.5).max() <= 0.001
    assert np.abs(vertices[:, 2] - (1 - np.abs(vertices[:, 0] - 5) / 5)).max() <= 0.001


def test_a_glb_is_compressed_where_blender_can_and_else_whole(exports: Path) -> None:
    used, plain = glb_json(exports / "meshopt.glb")["extensionsUsed"], exports / "textured.glb"
    if any("meshopt" in name for name in used):
        assert (exports / "meshopt.glb").stat().st_size < plain.stat().st_size
    else:
        assert len(glb_json(exports / "meshopt.glb")["accessors"]) == len(glb_json(plain)["accessors"])


def test_a_glb_without_a_texture_has_vertex_colours(exports: Path) -> None:
    for attributes in primitives(exports / "plain.glb"):
        assert "COLOR_1" not in attributes and "TEXCOORD_0" not in attributes
        places, linear = attributes["POSITION"], attributes["COLOR_0"][:, :3]
        colours = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        assert np.abs(colours - QUARTERS[(places[:, 0] > 5) + 2 * (places[:, 2] < -5)]).max() < 1


@pytest.mark.parametrize("name", ["plain", "textured", "pages"])
def test_a_glb_says_of_each_corner_what_is_known_of_its_face(exports: Path, name: str) -> None:
    found = set()
    for attributes in primitives(exports / f"{name}.glb"):
        x, y = attributes["POSITION"][:, 0], -attributes["POSITION"][:, 2]
        (kind,) = np.unique(attributes["_KIND"])  # each is a primitive of its own
        wanted = {0: ~(((x > 5) & (y > 5)) | ((x < 5) & (y < 5))), 1: (x <= 5) & (y <= 5), 2: (x >= 5) & (y >= 5)}
        assert wanted[kind].all() and not attributes["_UNSEEN"].any()
        found.add(kind)
    assert found == {0, 1, 2}


def test_a_glb_says_where_it_stands_and_whose_it_is(exports: Path) -> None:
    content = glb_json(exports / "textured.glb")
    (node,) = content["nodes"]
    assert node["extras"]["origin"] == content["asset"]["extras"]["origin"] == ORIGIN
    assert node["extras"]["scale"] == "metres" and node["extras"]["north"] is True
    assert content["asset"]["copyright"] == "福建 Team and Co, CC BY 4.0"
    assert content["asset"]["extras"]["axes"].startswith("Y up")
    for mark in ("filled", "weak"):
        assert sorted(material["extras"][mark] for material in content["materials"]) == [False, False, True]
    for material in content["materials"]:  # matte, and with no light of its own to be added to the viewer's
        assert "emissiveTexture" not in material and not any(material.get("emissiveFactor", [0]))
        assert material["pbrMetallicRoughness"].get("roughnessFactor", 1) == 1
        assert "KHR_materials_unlit" in material["extensions"]
    lit = glb_json(exports / "jpeg.glb")
    assert "KHR_materials_unlit" not in lit["extensionsUsed"]
    assert [image["mimeType"] for image in lit["images"]] == ["image/jpeg"]
    assert [image["mimeType"] for image in glb_json(exports / "webp.glb")["images"]] == ["image/webp"]
    assert len(glb_json(exports / "pages.glb")["images"]) == 2


@pytest.mark.parametrize("name", ["secret.glb", "secret.obj", "secret.ply", "secret.mtl"])
def test_the_position_can_be_left_out(exports: Path, name: str) -> None:
    content = (exports / name).read_bytes()
    for word in (b"117.25", b"24.5", b"latitude", b"origin"):
        assert word not in content
    assert name == "secret.mtl" or b"CC BY 4.0" in content


@pytest.mark.parametrize("name", ["my site", "packed", "pages"])
def test_an_obj_reads_back_in_the_site_frame(exports: Path, name: str) -> None:
    path = exports / f"{name}.obj"
    head = path.read_text(encoding="utf-8").splitlines()[:5]
    assert "Z up, x east, y north, metres" in head[0]
    assert "latitude 24.500000000 longitude 117.250000000 altitude 310.0000 above sea level" in head[1]
    assert "# credit: 福建 Team and Co" in head
    # trimesh splits at spaces, so it wants the material file under a name without.
    plain = path.with_name("read_" + path.name.replace(" ", "_"))
    plain.write_text(path.read_text(encoding="utf-8").replace("mtllib my site.mtl", "mtllib my_site.mtl"), "utf-8")
    if " " in name:
        shutil.copy(path.with_suffix(".mtl"), exports / "my_site.mtl")
    loaded = trimesh.load(plain)
    meshes = loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]
    np.testing.assert_allclose(np.concatenate([m.bounds for m in meshes]).max(axis=0), [10, 10, 1], atol=1e-5)
    assert np.abs(found_colours(meshes) - QUARTERS).max() <= 3
    rows = (exports / "plain.obj").read_text(encoding="utf-8").splitlines()
    vertices = np.array([row.split()[1:] for row in rows if row.startswith("v ")], float)  # trimesh drops the colours
    quarter = (vertices[:, 0] > 5) + 2 * (vertices[:, 1] > 5)
    assert np.abs(vertices[:, 3:] * 255 - QUARTERS[quarter]).max() < 1
    assert "None" not in path.with_suffix(".mtl").read_text() and "blend" not in path.with_suffix(".mtl").read_text()


@pytest.mark.parametrize("name", ["my site", "plain", "pages"])
def test_a_ply_reads_back_with_its_marks(exports: Path, name: str) -> None:
    path = exports / f"{name}.ply"
    header = path.read_bytes().split(b"end_header")[0].decode()
    assert "comment origin WGS84 latitude 24.500000000" in header and "comment licence: CC BY 4.0" in header
    mesh = trimesh.load(path)
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [10, 10, 1]], atol=1e-5)
    rows = mesh.metadata["_ply_raw"]["vertex"]["data"]
    x, y = np.asarray(rows["x"]).ravel(), np.asarray(rows["y"]).ravel()
    filled = (x > 5) & (y > 5)
    # A vertex is what the least sure of its faces is.
    assert np.array_equal(np.asarray(rows["_KIND"]).ravel(), np.where((x >= 5) & (y >= 5), 2, (x <= 5) & (y <= 5)))
    assert not np.asarray(rows["_UNSEEN"]).any()
    assert np.array_equal(np.asarray(rows["views"]).ravel() == 0, filled)
    assert np.allclose(np.asarray(rows["distance"]).ravel(), np.where(filled, 0.5, 0.01))
    colours = np.stack([np.asarray(rows[c]).ravel() for c in ("red", "green", "blue")], axis=1).astype(int)
    assert np.abs(colours - QUARTERS[(x > 5) + 2 * (y > 5)]).max() <= 1
    if name == "my site":
        assert np.allclose(np.asarray(rows["s"]).ravel(), x / 10) and np.allclose(np.asarray(rows["t"]).ravel(), y / 10)
        assert "comment TextureFile my_site_texture_1.png" in header
        assert (exports / "my_site_texture_1.png").is_file()
    else:
        assert "TextureFile" not in header and "property float s" not in header


def test_a_glb_opens_in_a_browser(exports: Path, tmp_path: Path) -> None:
    """three.js in headless Chromium, over the computer's own loopback."""
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("NOT TESTED in a browser: no chromium; apt-get install chromium, or set CHROMIUM")
    if not (MODULES / "three").is_dir():
        pytest.skip("NOT TESTED in a browser: no three.js; npm ci --prefix web")
    shutil.copy(WEB / "view.html", tmp_path)
    (tmp_path / "node_modules").symlink_to(MODULES)
    for name in ("textured", "plain"):
        shutil.copy(exports / f"{name}.glb", tmp_path / "model.glb")
        found = _browse(chromium, tmp_path)
        assert "error" not in found, found["error"]
        np.testing.assert_allclose(found["size"], [10, 1, 10], atol=1e-5)
        assert np.abs(np.array(found["quarters"]) - QUARTERS).max() <= 3, found["quarters"]
        assert found["nodes"][0]["origin"] == ORIGIN and "CC BY 4.0" in found["asset"]["copyright"]
        assert sorted(material["filled"] for material in found["materials"]) == [False, False, True]
        assert {material["type"] for material in found["materials"]} == {"MeshBasicMaterial"}  # unlit


def _browse(chromium: str, folder: Path) -> dict[str, Any]:
    """What view.html, served from `folder`, found in model.glb: the page sends it once it has drawn the model."""

    said: list[bytes] = []
    done = threading.Event()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None: ...

        def do_POST(self) -> None:
            said.append(self.rfile.read(int(self.headers["Content-Length"])))
            self.send_response(204)
            self.end_headers()
            done.set()

    with http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder))
    ) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with (folder / "browser.log").open("w+") as log:
            browser = subprocess.Popen(
                [chromium, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox", "--use-angle=swiftshader",
                 "--enable-unsafe-swiftshader", "--disable-dev-shm-usage", f"--user-data-dir={folder / 'profile'}",
                 "--remote-debugging-port=0", f"http://127.0.0.1:{server.server_port}/view.html"],
                stdout=log, stderr=subprocess.STDOUT,
            )
            try:
                done.wait(PATIENCE)
            finally:
                browser.terminate()
                browser.wait(30)
                server.shutdown()
    assert said, (folder / "browser.log").read_text()[-4000:]
    found: dict[str, Any] = json.loads(said[0])
    return found


def test_what_is_unknown_is_not_written() -> None:
    unknown = Provenance(scale="unknown", north=False)
    assert unknown.copyright == "" and unknown.lines() == ["CU-Recon: Z up, of unknown scale"]
    assert set(unknown.extras()) == {"generator", "scale", "north"}
    sneaky = Provenance(scale="metres", north=True, credit="A\nend_header\n", origin=GeoPosition(**{
        name: value for name, value in ORIGIN.items() if name != "crs"}))
    assert not any("\n" in line for line in sneaky.lines())


@pytest.mark.parametrize(("datum", "words"), [
    ("ellipsoid", "above the WGS84 ellipsoid"), ("sea level", "above sea level"), ("unknown", "of unknown datum"),
])
def test_an_altitude_is_labelled_with_what_it_counts_from(datum: str, words: str) -> None:
    origin = GeoPosition(latitude=24.5, longitude=117.25, altitude=310.0, altitude_datum=datum)
    about = Provenance(scale="metres", north=True, origin=origin)
    assert about.lines()[1].endswith(f"altitude 310.0000 {words}")
    assert about.extras()["origin"]["altitude_datum"] == datum


def test_a_file_that_is_no_glb_is_an_error_in_words(tmp_path: Path) -> None:
    path = tmp_path / "model.glb"
    path.write_bytes(b"x" * 40)
    with pytest.raises(WorkspaceError, match="not a GLB"):
        export.describe_glb(path, {"Surface": Provenance(scale="metres", north=True)})
