# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The published folder: the pages' own files, a folder for each site, and the catalogue of them all (STAC)."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import date
from pathlib import Path
from typing import Any

from ..base.files import atomic_write, disk_errors, partial_path, write_json
from ..base.language import Text
from ..base.messages import Reporter
from ..base.reading import read_json
from .privacy import Shown
from .records import About, PublishError

PAGES = Path(__file__).resolve().parents[2] / "pages"  # what the browser runs
CATALOGUE, ITEMS, SITES = "catalog.json", "items.json", "sites"
_STAC = "1.1.0"
_ID = "curecon-sites"
_SPDX = re.compile(r"[A-Za-z0-9][A-Za-z0-9.+-]*")


def check(folder: Path) -> None:
    """Make a folder for pages, or see that it is one. Raises PublishError for a file in the way or somebody else's
    files, WorkspaceError for a disk that cannot be written."""
    with disk_errors(folder):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError) as error:
            raise PublishError(Text("{} cannot be a folder: a file is in the way.", folder),
                               remedy="Choose another folder.",
                               path=folder) from error
        if not any(not entry.name.startswith(".") for entry in folder.iterdir()):
            return
    try:
        own = read_json(folder / CATALOGUE).get("id") == _ID
    except (OSError, ValueError, AttributeError):
        own = False
    if not own:
        raise PublishError(Text("{} is not empty, and its files are not of a publish before.", folder), path=folder,
                           remedy="Choose an empty folder, or one that was published into: the site is added there.")


@contextmanager
def site_folder(folder: Path, name: str) -> Iterator[Path]:
    """An empty folder for a site's files. It takes its place among the sites, and the place of what was published of
    that site before, when the block ends well; else nothing is left of it. Raises WorkspaceError."""
    place = folder / SITES / name
    partial = partial_path(place)
    with disk_errors(place):
        place.parent.mkdir(exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
    try:
        yield partial
        with disk_errors(place):
            old = partial_path(partial)
            shutil.rmtree(old, ignore_errors=True)
            if place.exists():
                os.replace(place, old)
            os.replace(partial, place)
            shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
        with suppress(OSError):  # it holds other sites
            place.parent.rmdir()


def write_pages(folder: Path) -> None:
    """Put the pages' own files into the folder. Raises PublishError where they are missing, WorkspaceError."""
    if not (PAGES / "index.html").is_file():
        raise PublishError(Text("{} lacks the pages.", PAGES), remedy="Install the CU-Recon zip again.", path=PAGES)
    for source in sorted(PAGES.rglob("*")):
        if source.is_dir() or source.name == "site.html":
            continue
        target = folder / ("index.html" if source.name == "index.html" else f"pages/{source.relative_to(PAGES)}")
        with disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
        copy(source, target)


def copy(source: Path, target: Path) -> None:
    """Raises WorkspaceError."""
    with source.open("rb") as file, atomic_write(target) as out:
        shutil.copyfileobj(file, out)


def item(
    about: About, shown: Shown, taken: date | None, assets: dict[str, tuple[str, str, list[str]]]
) -> dict[str, Any]:
    """A site as a STAC item. `taken` is the day of its photos, None where nobody knows it: the item then has the day
    of its publication. `assets` are (address, media type, roles) by their names."""
    day = f"{(taken or date.today()).isoformat()}T00:00:00Z"
    licence = " ".join(about.licence.split())
    properties: dict[str, Any] = {
        "datetime": day, "title": about.title, "description": about.text or about.title,
        "license": licence if _SPDX.fullmatch(licence) else "other", "curecon:location": shown.location,
        "curecon:date_of": "photos" if taken else "publication",
    }
    for name, text in (("curecon:licence", licence), ("curecon:place", about.place)):
        properties |= {name: text} if text else {}
    if about.credit.strip():
        properties["providers"] = [{"name": " ".join(about.credit.split()), "roles": ["producer"]}]
    found: dict[str, Any] = {
        "type": "Feature", "stac_version": _STAC, "id": about.id, "geometry": shown.geometry,
        "properties": properties,
        "links": [{"rel": rel, "href": f"../../{CATALOGUE}", "type": "application/json"} for rel in ("root", "parent")],
        "assets": {name: {"href": address, "type": kind, "roles": roles}
                   for name, (address, kind, roles) in assets.items()},
    }
    return found if shown.box is None else found | {"bbox": shown.box}


def listed(found: Any, name: str) -> dict[str, Any]:
    """An item as it stands in the collection: its files' addresses count from there. Raises ValueError, LookupError,
    TypeError or AttributeError for what is no item of a site of that name."""
    if found["type"] != "Feature" or found["id"] != name or not isinstance(found["properties"]["title"], str):
        raise ValueError("it is no item of this folder")
    assets = {key: {**asset, "href": f"{SITES}/{name}/{asset['href'].removeprefix('./')}"}
              for key, asset in found["assets"].items()}
    return {**found, "assets": assets, "links": []}


def write_catalogue(folder: Path, reporter: Reporter) -> int:
    """Write the catalogue of all sites that have a folder, so that a site goes with its folder; their number. Raises
    WorkspaceError."""
    items = []
    for path in sorted((folder / SITES).glob("*/item.json")):
        try:
            items.append(listed(read_json(path), path.parent.name))
        except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
            reporter.warning(Text("{} cannot be read ({}): that site is not in the catalogue. Publish it again.", path,
                                  Text(str(error))))
    write_json(folder / ITEMS, {"type": "FeatureCollection", "features": items})
    write_json(folder / CATALOGUE, {
        "type": "Catalog", "stac_version": _STAC, "id": _ID, "title": "Sites",
        "description": "Sites recorded from drone photos, published by CU-Recon.",
        "links": [
            {"rel": "root", "href": f"./{CATALOGUE}", "type": "application/json"},
            *({"rel": "item", "href": f"./{SITES}/{one['id']}/item.json", "type": "application/geo+json",
               "title": one["properties"]["title"]} for one in items),
        ],
    })
    return len(items)
