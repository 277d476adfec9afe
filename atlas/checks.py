# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What an upload may hold: first its list of files, then each of them."""

from __future__ import annotations

import re
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from curecon_blender.core.base.language import Text
from curecon_blender.core.base.options import EXACT
from curecon_blender.core.base.reading import Within, build
from curecon_blender.core.publish import film

from . import pictures, records, tiles
from .configuration import Limits
from .problems import Problem, refused, why

_MOST_RECORD = 1 << 20
_MOST_PIXELS = 6_000_000_000  # of textures, which take half a minute to be opened
_one_film = threading.Lock()  # at a time: they are the largest files by far
_SHA256 = re.compile(r"[0-9a-f]{64}")
# What a site's folder may hold, and the most bytes of each. Pages are the atlas's own; a PDF nobody can check.
_KINDS = (
    (re.compile(r"site\.json"), _MOST_RECORD), (re.compile(r"thumbnail\.jpg"), 1 << 20),
    (re.compile(r"pictures/([1-9]|[1-3]\d|40)\.jpg"), pictures.MOST_PICTURE),
    (re.compile(re.escape(records.FILM)), film.LARGEST),
    (re.compile(r"(surface|cloud)/tileset\.json"), tiles.MOST_TILESET),
    (re.compile(r"surface/earth\.json"), _MOST_RECORD),
    (re.compile(r"(surface|cloud)/(0|[1-9]\d{0,5})\.glb"), tiles.MOST_TILE),
)


@dataclass(frozen=True, kw_only=True)
class File:
    path: str
    size: Annotated[int, Within(1, 1 << 40)]
    sha256: str


def manifest(value: Any, limits: Limits) -> tuple[File, ...]:
    """The files that somebody wants to send, in the order of their paths. Raises Problem."""
    if not isinstance(value, list) or len(value) > limits.files:
        raise Problem(413, "too_large", Text("An upload has {} files at most.", limits.files))
    try:
        found: tuple[File, ...] = build(tuple[File, ...], value)
    except (ValueError, RecursionError) as error:
        raise refused(Text("The list of files: {}.", why(error))) from error
    for file in found:
        most = next((most for kind, most in _KINDS if kind.fullmatch(file.path)), None)
        if most is None:
            raise refused(Text("{} is no file of a published site.", repr(file.path[:80])))
        if file.size > most:
            raise Problem(413, "too_large", Text(
                "{} has {:.1f} MB; {:.1f} are the most. Publish the site again with less of it.", file.path,
                file.size / 1e6, most / 1e6))
        if not _SHA256.fullmatch(file.sha256):
            raise refused(Text("{}: its SHA-256 is none.", file.path))
    paths = [file.path for file in found]
    if len(set(paths)) != len(paths):
        raise refused("The list names a file twice.")
    if not {"site.json", "thumbnail.jpg"} <= set(paths):
        raise refused("site.json or thumbnail.jpg is missing: choose the folder that Publish Web Pages wrote.")
    if sum(file.size for file in found) > limits.upload:
        raise Problem(413, "too_large", Text("An upload has {:.1f} MB at most.", limits.upload / 1e6))
    return tuple(sorted(found, key=lambda file: file.path))


def check(files: tuple[File, ...], get: Callable[[File], bytes]) -> tuple[records.Site, list[str]]:
    """What the site says of itself, and what a moderator is to look at. `get` brings a file's bytes, whose size and
    SHA-256 are as listed. Raises Problem."""
    by_path = {file.path: file for file in files}
    site, doubts = records.site(get(by_path["site.json"]))
    exact = site.location == EXACT
    expected = {"site.json", "thumbnail.jpg", *site.pictures, *([site.film] if site.film else [])}
    pixels = 0
    for kind in ("surface", "cloud"):
        own = {path for path in by_path if path.startswith(f"{kind}/")}
        if not getattr(site, kind):
            continue
        expected |= own
        if f"{kind}/tileset.json" not in own:
            raise refused(Text("{} is missing.", f"{kind}/tileset.json"))
        if f"{kind}/earth.json" in own:
            if not exact:
                raise refused(Text("{} tells the place, which this site does not show.", f"{kind}/earth.json"))
            tiles.earth(get(by_path[f"{kind}/earth.json"]))
        names = {path.removeprefix(f"{kind}/") for path in own if path.endswith(".glb")}
        tiles.tileset(get(by_path[f"{kind}/tileset.json"]), names)
        for name in sorted(names):
            pixels += tiles.tile(f"{kind}/{name}", get(by_path[f"{kind}/{name}"]), site.said.copyright)
            if pixels > _MOST_PIXELS:
                raise refused(Text("Its textures have more than {} megapixels. Publish the site again with less.",
                                   _MOST_PIXELS // 1_000_000))
    if expected != set(by_path):
        wrong = min(expected ^ set(by_path))
        raise refused(Text("{} is missing.", wrong) if wrong in expected else
                      Text("{} is a file that the site does not name.", wrong))
    if site.film:
        with _one_film:
            _check_film(get(by_path[site.film]))
    for path in ("thumbnail.jpg", *site.pictures):
        try:
            pictures.jpeg(get(by_path[path]), metadata=exact)
        except (ValueError, struct.error) as error:
            raise refused(Text("{}: {}.", path, why(error))) from error
    return site, doubts


def _check_film(content: bytes) -> None:
    """A film that has nothing left to be blanked, as *Publish* writes it. Raises Problem."""
    try:
        if film.without_metadata(content) != content:
            raise ValueError("it carries more than its pictures, which may tell the place")
    except (ValueError, RecursionError) as error:
        raise refused(Text("{}: {}.", records.FILM, why(error))) from error
