# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of strangers: what an atlas refuses, and of whatever it takes, that a browser can show it."""

from __future__ import annotations

import hashlib
import io
import json
import re
import struct
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from atlas_run import listed, make_site
from conftest import ROOT, MakeOnce
from PIL import Image

from atlas import checks
from atlas.configuration import Limits
from atlas.problems import Problem
from curecon_blender.core.base.options import CELL, EXACT, HIDDEN

BIDI = "\u202egpj.exe"


@pytest.fixture(scope="module")
def files(made_once: MakeOnce[Path]) -> Callable[[str], dict[str, bytes]]:
    """What is sent of a little site with a picture, anew each time."""
    def of(location: str) -> dict[str, bytes]:
        def make(folder: Path) -> Path:
            site = make_site(folder / "p", "Gate", location)
            (site / "pictures").mkdir()
            Image.new("RGB", (64, 48), "brown").save(site / "pictures" / "1.jpg")
            record = json.loads((site / "site.json").read_text())
            (site / "site.json").write_text(json.dumps({**record, "pictures": ["pictures/1.jpg"]}))
            return site
        return listed(made_once(f"atlas_checked_{location}", make))
    return of


def checked(files: dict[str, bytes]) -> list[str]:
    """What a moderator is to look at. Raises Problem."""
    value = [{"path": path, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()}
             for path, content in files.items()]
    return checks.check(checks.manifest(value, Limits()), lambda file: files[file.path])[1]


def refusal(files: dict[str, bytes]) -> str:
    with pytest.raises(Problem) as found:
        checked(files)
    assert found.value.status in (413, 422)
    return found.value.said


def edited(files: dict[str, bytes], path: str, *way: str | int, to: Any) -> dict[str, bytes]:
    """The files with one value of a JSON file, or of a tile's JSON, changed."""
    content = files[path]
    start, end = (20, 20 + struct.unpack_from("<I", content, 12)[0]) if path.endswith(".glb") else (0, len(content))
    value = json.loads(content[start:end])
    at = value
    for step in way[:-1]:
        at = at[step]
    at[way[-1]] = to
    text = json.dumps(value).encode()
    if path.endswith(".glb"):
        text += b" " * (-len(text) % 4)
        head = struct.pack("<4sIII4s", b"glTF", 2, len(content) - (end - start) + len(text), len(text), b"JSON")
        text = head + text + content[end:]
    return {**files, path: text}


@pytest.mark.parametrize("location", [EXACT, CELL, HIDDEN])
def test_what_publishing_writes_is_taken(files: Callable[[str], dict[str, bytes]], location: str) -> None:
    assert checked(files(location)) == []


@pytest.mark.parametrize(
    "path",
    [
        "../site.json",
        "/etc/passwd",
        "surface/../../x.glb",
        "a\\b",
        "index.html",
        "surface/evil.js",
        "surface/0.glb ",
        "pictures/1.svg",
        "surface//0.glb",
        "SITE.JSON",
        "report.pdf",
        "surface/0000001.glb",
        "pictures/41.jpg",
        "C:\\x",
        "",
    ],
)
def test_names_that_are_none_of_a_site(files: Callable[[str], dict[str, bytes]], path: str) -> None:
    assert "no file of a published site" in refusal({**files(CELL), path: b"x"})


def test_sizes_are_refused_before_anything_is_sent(files: Callable[[str], dict[str, bytes]]) -> None:
    listing = [
        {"path": "site.json", "size": 10, "sha256": "0" * 64},
        {"path": "thumbnail.jpg", "size": 9, "sha256": "0" * 64},
    ]
    checks.manifest(listing, Limits())
    for changes, limits in (({"size": 1 << 60}, Limits()), ({"size": -1}, Limits()), ({"size": 0}, Limits()),
                            ({"size": 1.5}, Limits()), ({"sha256": "x"}, Limits()), ({"more": 1}, Limits()),
                            ({"path": "thumbnail.jpg"}, Limits()), ({}, Limits(upload=18)), ({}, Limits(files=1))):
        with pytest.raises(Problem):
            checks.manifest([{**listing[0], **changes}, listing[1]], limits)
    film = {"path": "film.mp4", "size": 200_000_000, "sha256": "0" * 64}  # what publishing takes, too
    checks.manifest([*listing, film], Limits())
    with pytest.raises(Problem, match=r"film.mp4 has 200\.1 MB; 200\.0 are the most"):
        checks.manifest([*listing, {**film, "size": 200_100_000}], Limits())
    for nothing in (None, {}, "x", [1], [listing[0]]):
        with pytest.raises(Problem):
            checks.manifest(nothing, Limits())


@pytest.mark.parametrize(
    ("way", "to", "said"),
    [
        (("title",), "x" * 201, "200 are the most"),
        (("text",), "x" * 10_000, "5000 are the most"),
        (("title",), f"photo{BIDI}", "invisible letter U\\+202E"),
        (("text",), "a\x00b", "text of a reasonable"),
        (("title",), "a\x7fb", "control character"),
        (("place",), "\x1b[31m", "control character"),
        (("title",), "  ", "no name"),
        (("id",), "../x", "no name"),
        (("id",), "a.1", "no name"),
        (("format",), 2, "within"),
        (("evil",), 1, "unknown field"),
        (("box", 0, 0), 6.4e6, "within"),
        (("notes", 0, "place", 1), 2_730_000, "within"),
        (("notes", 0, "title"), "\u2066x", "invisible"),
        (("pictures",), ["../x.jpg"], "none that publishing gives"),
        (("surface", "tileset"), "cloud/tileset.json", "another's tiles"),
        (("surface", "tileset"), "//evil/t.json", "none of"),
        (("figures", "pixel"), "1", "str instead"),
        (("geometry",), {"type": "Point", "coordinates": [117.05, 24.65]}, "none of Polygon"),
        (("geometry", "coordinates", 0, 0, 0), 117.051, "not one of the grid"),
        (("location",), HIDDEN, "hidden"),
        (("geometry", "more"), 1, "unknown field"),
        (("taken",), "2024-09-28T10:00:00", "taken|no day|Invalid"),
    ],
)
def test_a_record_that_publishing_does_not_write(
    files: Callable[[str], dict[str, bytes]], way: tuple[str | int, ...], to: Any, said: str
) -> None:
    assert re.search(said, found := refusal(edited(files(CELL), "site.json", *way, to=to))), found


def test_letters_of_any_script_are_taken_as_they_are(files: Callable[[str], dict[str, bytes]]) -> None:
    for title in ("土楼 <b>&amp;</b> '\"", "قلعة\u200f", "می\u200cخواهم", "ਪੰਜਾਬ 🏯",
                  "javascript:alert(1)", "../../etc"):
        checked(edited(files(CELL), "site.json", "title", to=title))


def test_a_text_that_may_tell_the_place_is_shown_to_the_moderator(files: Callable[[str], dict[str, bytes]]) -> None:
    for text in ("at 24.658307, 117.052089", "24° 39' N", "easting 505263 northing 2726262"):
        said = edited(files(CELL), "site.json", "text", to=text)
        assert checked(said) == (["coordinates in text?"] if "easting" not in text else checked(said))
    assert checked(edited(files(CELL), "site.json", "notes", 0, "text", to="24,6583 117,0520")) == ["coordinates in "
                                                                                                    "note 1?"]
    assert checked(edited(files(EXACT), "site.json", "text", to="at 24.658307, 117.052089")) == []


def test_a_picture_that_tells_the_place(files: Callable[[str], dict[str, bytes]]) -> None:
    exif = Image.Exif()
    exif[0x8825] = {1: "N", 2: (24.0, 39.0, 29.0), 3: "E", 4: (117.0, 3.0, 7.0)}
    told = io.BytesIO()
    Image.new("RGB", (64, 48)).save(told, "JPEG", exif=exif)
    commented = io.BytesIO()
    Image.new("RGB", (64, 48)).save(commented, "JPEG", comment=b"24.65 117.05")
    for location in (CELL, HIDDEN):
        for path in ("pictures/1.jpg", "thumbnail.jpg"):
            assert "may tell the place" in refusal({**files(location), path: told.getvalue()})
        assert "may tell the place" in refusal({**files(location), "pictures/1.jpg": commented.getvalue()})
    checked({**files(EXACT), "pictures/1.jpg": told.getvalue()})


def test_a_film_that_tells_more_than_its_pictures(files: Callable[[str], dict[str, bytes]]) -> None:
    def box(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I4s", 8 + len(body), kind) + body

    handler = box(b"hdlr", bytes(8) + b"vide" + bytes(13))
    sound = box(b"ftyp", b"isom") + box(b"moov", box(b"trak", box(b"mdia", handler))) + box(b"mdat", b"pictures")
    whole = edited({**files(HIDDEN), "film.mp4": sound}, "site.json", "film", to="film.mp4")
    assert checked(whole) == []
    for told in (
        sound + box(b"uuid", b"24.65 117.05"),
        sound.replace(handler, box(b"hdlr", bytes(8) + b"vide" + b"x" * 13)),
        sound.replace(b"vide", b"soun"),
        sound[:-3],
        b"\0\0\0\x08free",
        b"<html>",
    ):
        assert "film.mp4" in refusal({**whole, "film.mp4": told})
    assert "does not name" in refusal({**whole, "site.json": files(HIDDEN)["site.json"]})


def test_pictures_that_are_none(files: Callable[[str], dict[str, bytes]]) -> None:
    sound = files(CELL)["pictures/1.jpg"]
    bomb = io.BytesIO()
    Image.new("1", (20_000, 20_000)).convert("L").save(bomb, "JPEG", quality=1)
    png = io.BytesIO()
    Image.new("RGB", (8, 8)).save(png, "PNG")
    frame = sound.index(b"\xff\xc0")
    lied = sound[: frame + 5] + struct.pack(">HH", 8000, 4000) + sound[frame + 9 :]
    for content, said in (
        (bomb.getvalue(), "are the most|larger|bytes"),
        (png.getvalue(), "no JPEG"),
        (b"<svg onload=alert(1)>", "no JPEG"),
        (sound + b"<script>", "behind the picture"),
        (sound[:-20], "cut short"),
        (sound[:40], "cut short"),
        (b"\xff\xd8\xff", "cut short"),
        (b"\xff\xd8\xff\xd9", "cannot be opened"),
        (lied, "fewer bytes|are the most"),
        (sound[:2] + b"\xff\xe1\0\x04ab" + sound[2:], "may tell"),
        (sound[:3] + b"\0" * 500, "no JPEG|cut|kind"),
    ):
        found = refusal({**files(CELL), "pictures/1.jpg": content})
        assert re.search(said, found), found


def test_textures_that_would_take_long_to_open(
    files: Callable[[str], dict[str, bytes]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "_MOST_PIXELS", 1000)
    assert "0 megapixels" in refusal(files(CELL))


def test_every_byte_of_a_picture_may_be_wrong(files: Callable[[str], dict[str, bytes]]) -> None:
    """Whatever one byte is: a refusal, or a picture; never another error."""
    whole, sound = files(CELL), files(CELL)["pictures/1.jpg"]
    for position in range(0, len(sound), 3):
        for value in (0, 0xFF, sound[position] ^ 0x10):
            spoiled = sound[:position] + bytes([value]) + sound[position + 1 :]
            with suppress(ValueError, struct.error):
                checks.pictures.jpeg(spoiled, metadata=False)
    assert checked(whole) == []


@pytest.mark.parametrize(("path", "way", "to", "said"), [
    ("surface/tileset.json", ("root", "content", "uri"), "../../../etc/passwd", "no tile's name"),
    ("surface/tileset.json", ("root", "content", "uri"), "https://evil/0.glb", "no tile's name"),
    ("surface/tileset.json", ("root", "content", "uri"), "tileset.json", "no tile's name"),
    ("surface/tileset.json", ("root", "content", "uri"), "7.glb", "name each tile"),
    ("surface/tileset.json", ("root", "boundingVolume", "box", 0), 6_378_137.0, "far from"),
    ("surface/tileset.json", ("root", "transform"), [0.0] * 16, "moved elsewhere"),
    ("surface/tileset.json", ("root", "extras"), {}, "unknown field"),
    ("surface/tileset.json", ("extensionsUsed",), ["x"], "unknown field"),
    ("surface/0.glb", ("buffers", 0, "uri"), "https://evil/x.bin", "unknown field"),
    ("surface/0.glb", ("images", 0, "uri"), "https://evil/x.png", "unknown field"),
    ("surface/0.glb", ("extras",), {"latitude": 24.65}, "unknown field"),
    ("surface/0.glb", ("asset", "copyright"), "24.65 117.05", "another copyright"),
    ("surface/0.glb", ("asset", "generator"), "x", "another copyright"),
    ("surface/0.glb", ("bufferViews", 0, "byteOffset"), 1 << 30, "out of the tile"),
    ("surface/0.glb", ("bufferViews", 0, "byteLength"), 4, "reaches out|overlap|nothing|bytes"),
    ("surface/0.glb", ("accessors", 0, "count"), 1 << 24, "reaches out"),
    ("surface/0.glb", ("accessors", 0, "count"), 1 << 40, "within"),
    ("surface/0.glb", ("nodes", 0, "translation"), [6.4e6, 0, 0], "far from the site"),
    ("surface/0.glb", ("nodes", 0, "scale"), [1e6, 1, 1], "far from the site"),
    ("surface/0.glb", ("nodes", 0, "translation"), [1e30, 0, 0], "within"),
    ("surface/0.glb", ("extensionsUsed",), ["KHR_draco_mesh_compression"], "extension"),
    ("surface/0.glb", ("meshes", 0, "primitives", 0, "indices"), 99, "not there"),
    ("surface/0.glb", ("meshes", 0, "primitives", 0, "mode"), 9, "neither triangles"),
    ("surface/0.glb", ("materials", 0, "name"), "x", "none of")])
def test_tiles_that_publishing_does_not_write(
    files: Callable[[str], dict[str, bytes]], path: str, way: tuple[str | int, ...], to: Any, said: str
) -> None:
    assert re.search(said, found := refusal(edited(files(CELL), path, *way, to=to))), found


def test_tiles_that_are_cut_lengthened_or_something_else(files: Callable[[str], dict[str, bytes]]) -> None:
    whole = files(CELL)
    sound = whole["surface/0.glb"]
    index = sound.index(b"RIFF")
    for content in (
        sound[:-4],
        sound + b"\0" * 4,
        sound[:27],
        b"glTF",
        b"PK\3\4" + sound[4:],
        b"<html>" * 20,
        sound[:4] + struct.pack("<II", 2, 1 << 31) + sound[12:],
        sound[:index] + b"GIF8" + sound[index + 4 :],
    ):
        refusal({**whole, "surface/0.glb": content})
    copyright = json.loads(sound[20 : 20 + struct.unpack_from("<I", sound, 12)[0]])["asset"]["copyright"]
    for position in range(0, len(sound), 7):  # another byte is a refusal or a sound tile, never another error
        spoiled = sound[:position] + bytes([sound[position] ^ 0xFF]) + sound[position + 1 :]
        with suppress(Problem):
            checks.tiles.tile("0.glb", spoiled, copyright)


def test_tilesets_within_tilesets_without_end(files: Callable[[str], dict[str, bytes]]) -> None:
    entry = json.loads(files(CELL)["surface/tileset.json"])["root"]
    deep: dict[str, Any] = {name: entry[name] for name in ("boundingVolume", "geometricError", "refine")}
    for count in (60, 5000):
        nested = json.dumps(deep)[:-1] + ', "children": ['
        text = (
            '{"asset": {"version": "1.1"}, "geometricError": 1, "root": '
            + nested * count
            + json.dumps(deep)
            + "]}" * count
            + "}"
        )
        refusal({**files(CELL), "surface/tileset.json": text.encode()})


def test_files_that_are_missing_left_over_or_tell_the_place(files: Callable[[str], dict[str, bytes]]) -> None:
    whole, exact = files(CELL), files(EXACT)
    for path in ("pictures/1.jpg", "surface/tileset.json", "cloud/0.glb", "thumbnail.jpg"):
        refusal({name: content for name, content in whole.items() if name != path})
    assert "does not name" in refusal({**whole, "surface/999.glb": whole["surface/0.glb"]})
    assert "does not name" in refusal({**whole, "pictures/2.jpg": whole["pictures/1.jpg"]})
    assert "tells the place" in refusal({**whole, "surface/earth.json": exact["surface/earth.json"]})
    assert "names other tiles" in refusal(edited(exact, "surface/earth.json", "root", "content", "uri", to="http://evil/"))
    assert "no place on Earth" in refusal(edited(exact, "surface/earth.json", "root", "transform", 0, to=5.0))


def test_what_is_taken_is_sound_to_khronos(files: Callable[[str], dict[str, bytes]], tmp_path: Path) -> None:
    if not (ROOT / "web" / "node_modules" / "gltf-validator").is_dir():
        pytest.skip("NOT VALIDATED: no gltf-validator; npm ci --prefix web")
    whole = files(CELL)
    for name, content in whole.items():
        if name.endswith(".glb"):
            (tmp_path / name).parent.mkdir(exist_ok=True)
            (tmp_path / name).write_bytes(content)
    ran = subprocess.run(
        ["node", ROOT / "tests" / "web" / "validate.mjs", tmp_path], capture_output=True, text=True, check=True
    )
    assert not json.loads(ran.stdout)["wrong"]
