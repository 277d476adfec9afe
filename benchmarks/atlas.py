# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas with many sites and under load, on this computer's loopback. Needs atlas/requirements.txt.

    python benchmarks/atlas.py catalogue [--sites 100000]
    python benchmarks/atlas.py load [--visitors 200] [--uploads 20] [--megabytes 200] [--large]

`catalogue` makes sites up, and says what a visitor's first view of the map costs in bytes. `load` lets visitors read
while uploads run at once. When some of the bytes have come the server is killed and started again, and every upload
goes on, until its files are checked and held. It says latencies and memory, and compares every byte that came. With
--large a PostgreSQL and an S3 store of their own stand behind the server. All loops end by themselves.
"""

from __future__ import annotations

import argparse
import gzip
import http.client
import io
import json
import multiprocessing
import os
import random
import signal
import statistics
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from functools import cache
from multiprocessing.connection import Connection
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import atlas_services  # noqa: E402
from atlas_run import Asker, Atlas, listed, make_site, running  # noqa: E402
from little_site import CREDIT  # noqa: E402

from atlas import configuration, quadkeys, server, words  # noqa: E402
from atlas.database import now  # noqa: E402
from atlas.store import HELD  # noqa: E402
from curecon_blender.core.base.options import CELL  # noqa: E402
from curecon_blender.core.publish.glb import mesh_tile  # noqa: E402
from curecon_blender.core.publish.records import About  # noqa: E402

_ALONE, _LONGEST = 10, 1800  # seconds
_VERTICES, _FACES, _SIDE = 50_000, 40_000, 420  # of a tile of a megabyte, and the pixels of its texture
_PATHS = ("/", "/items.json", "/catalogue/map/0/world.json", "/sites/gate/site.json", "/sites/gate.1/surface/0.glb",
          "/api/search?q=gate")
CENTRES = [
    (117.0, 24.7),
    (112.0, 35.0),
    (2.3, 48.8),
    (-99.1, 19.4),
    (78.0, 27.2),
    (31.1, 29.9),
    (12.5, 41.9),
    (-72.5, -13.2),
]


def made_up(number: int, chance: random.Random) -> dict[str, Any]:
    longitude, latitude = chance.choice(CENTRES)
    longitude, latitude = (round(chance.gauss(value, 4), 6) for value in (longitude, latitude))
    name = f"site-{number}"
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "id": name,
        "geometry": {"type": "Point", "coordinates": [longitude, latitude]},
        "bbox": [longitude, latitude, longitude, latitude],
        "links": [],
        "properties": {
            "datetime": "2026-05-01T00:00:00Z",
            "title": f"House {number} of clan {number % 997}",
            "license": "CC-BY-4.0",
            "description": "A round earthen house of three floors about a court, with a gate to the south.",
            "curecon:location": "exact",
            "curecon:date_of": "photos",
            "curecon:place": f"County {number % 211}",
            "providers": [{"name": "A survey", "roles": ["producer"]}],
        },
        "assets": {
            "page": {"href": f"sites/{name}/index.html", "type": "text/html", "roles": ["overview"]},
            "thumbnail": {"href": f"sites/{name}/thumbnail.jpg", "type": "image/jpeg", "roles": ["thumbnail"]},
        },
    }


def catalogue(count: int, folder: Path) -> None:
    configuration.write_new(folder / "atlas.toml")
    parts = server.assemble(configuration.read(folder / "atlas.toml"))
    chance = random.Random(0)
    rows = []
    for number in range(count):
        feature = made_up(number, chance)
        longitude, latitude = feature["geometry"]["coordinates"]
        rows.append(
            {
                "name": feature["id"],
                "number": number,
                "title": feature["properties"]["title"],
                "longitude": longitude,
                "latitude": latitude,
                "quadkey": quadkeys.of(longitude, latitude),
                "feature": json.dumps(feature),
                "now": now(),
                "said": words.cut(f"{feature['properties']['title']} {feature['properties']['curecon:place']}"),
            }
        )
    with parts.database.write() as transaction:
        transaction.run("INSERT INTO account VALUES ('a', 'a', 'contributor', '', 0, 0)")
        transaction.many("INSERT INTO site VALUES (:name, 'a', 'public', :number, 1, :now, :now, NULL, '', :title, '', "
                         "'[]', '', NULL, NULL, :longitude, :latitude, :quadkey, NULL, :feature, 0)", rows)
        transaction.many("INSERT INTO words (name, said) VALUES (:name, :said)", rows)
    began = time.process_time()
    parts.publisher.write_pages()
    parts.publisher._catalogue.write_all()
    print(f"{count:,} sites: all static files of the catalogue in {time.process_time() - began:.1f} s of processor "
          f"time")
    public = folder / "store" / "public"
    made = [path for path in public.rglob("*") if path.is_file() and "pages" not in path.relative_to(public).parts[:1]]
    print(f"{len(made):,} files, {sum(path.stat().st_size for path in made) / 1e6:.1f} MB; the largest "
          f"{max(path.stat().st_size for path in made) / 1e3:.0f} kB")
    for kind in (
        "items.json",
        "catalogue/map/0/world.json",
        "catalogue/pages",
        "catalogue/map",
        "catalog.json",
        "catalogue/stac",
    ):
        sizes = [
            path.stat().st_size
            for path in ([public / kind] if (public / kind).is_file() else (public / kind).rglob("*.json"))
        ]
        print(f"    {kind}: {len(sizes):,} files, median {statistics.median(sizes) / 1e3:.1f} kB, largest "
              f"{max(sizes) / 1e3:.1f} kB")
    pages = [
        "index.html",
        "pages/style.css",
        "pages/vendor/maplibre.css",
        "pages/map.js",
        "pages/words.js",
        "pages/tiles.js",
        "pages/vendor/maplibre.js",
        "pages/vendor/topojson.js",
        "pages/vendor/maplibre-worker.js",
        "pages/vendor/world.json",
    ]
    data = ["items.json", "catalogue/map/0/world.json"]
    for name, files in (("the map's program", pages), ("the catalogue", data)):
        contents = [(public / file).read_bytes() for file in files]
        print(f"first view, {name}: {len(files)} requests, {sum(map(len, contents)) / 1e3:.0f} kB, packed "
              f"{sum(len(gzip.compress(content)) for content in contents) / 1e3:.0f} kB")
    began = time.process_time()
    parts.publisher._catalogue.write([count - 1], [rows[-1]["quadkey"]], 1)
    print(f"a new site: {1000 * (time.process_time() - began):.0f} ms of processor time to write what names it")
    for query in ("house 4711", "clan 99", "county 17", "nothing"):
        began = time.perf_counter()
        matched = words.search(parts.database, {"q": query})["numberMatched"]
        print(f"search {query!r}: {matched:,} sites in {1000 * (time.perf_counter() - began):.0f} ms")


# ---- load

class Made(Mapping[str, bytes]):
    """The files of a site of `megabytes` tiles of a megabyte each, whose every byte an atlas checks. They are made as
    they are asked for; no two sites have a tile in common."""

    def __init__(self, number: int, megabytes: int, little: dict[str, bytes]) -> None:
        record = json.loads(little["site.json"]) | {"title": f"Load {number}", "id": f"load-{number}", "cloud": None}
        entry = json.loads(little["surface/tileset.json"])["root"]
        leaf = {name: entry[name] for name in ("boundingVolume", "geometricError", "refine")}
        entries = [{**leaf, "content": {"uri": f"{tile}.glb"}} for tile in range(megabytes)]
        tileset = {"asset": {"version": "1.1"}, "geometricError": 1, "root": {**leaf, "children": entries}}
        self._number = number
        self._small = {"site.json": json.dumps(record).encode(), "thumbnail.jpg": little["thumbnail.jpg"],
                       "surface/tileset.json": json.dumps(tileset).encode()}
        self._names = [*self._small, *(f"surface/{tile}.glb" for tile in range(megabytes))]

    def __getitem__(self, path: str) -> bytes:
        if path in self._small:
            return self._small[path]
        content, at = _tile()
        mark = struct.pack("<HH", self._number, int(Path(path).stem))  # in bytes that pad the first vertices
        return b"".join([content[: at + 6], mark[:2], content[at + 8 : at + 14], mark[2:], content[at + 16 :]])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


@cache
def _tile() -> tuple[bytes, int]:
    """A tile of a megabyte, most of it triangles as in real ones, and where its vertices begin."""
    chance, packed = np.random.default_rng(0), io.BytesIO()
    Image.fromarray(chance.integers(0, 256, (_SIDE, _SIDE, 3), np.uint8)).save(packed, "WEBP", quality=85)
    places, faces = chance.uniform(-9, 9, (_VERTICES, 3)), chance.integers(0, _VERTICES, (_FACES, 3))
    said = About(title="", location=CELL, credit=CREDIT, licence="CC-BY-4.0").copyright
    content = mesh_tile(places, faces, np.zeros(_FACES, int), said, uv=chance.uniform(0, 1, (_VERTICES, 2)),
                        picture=packed.getvalue())
    return content, 28 + struct.unpack_from("<I", content, 12)[0]


def _visit(port: int, visitors: int, over: Event, out: Connection) -> None:
    """Visitors who ask for something every 0.5 to 2 seconds. Sends when each answer was asked for, when it had come,
    and its status: 0 where nobody answered."""
    found: list[tuple[float, float, int]] = []

    def visit(number: int) -> None:
        chance = random.Random(number)
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        while not over.is_set():
            time.sleep(chance.uniform(0.5, 2))
            asked, status = time.monotonic(), 0
            try:
                connection.request("GET", chance.choice(_PATHS))
                answer = connection.getresponse()
                answer.read()
                status = answer.status
            except (OSError, http.client.HTTPException):
                connection.close()
            found.append((asked, time.monotonic(), status))

    _all([threading.Thread(target=visit, args=(number,)) for number in range(visitors)])
    out.send(found)


def _send(asker: Asker, uploads: int, megabytes: int, little: dict[str, bytes], out: Connection) -> None:
    """People who upload at once, each until the site is held. Sends when the last chunk had come, when the last site
    was held, and the versions by the number of their upload."""
    os.nice(15)  # they stand for other computers: the server's processor is not theirs
    held: dict[int, str] = {}
    sent: list[float] = []

    def send(number: int) -> None:
        files = Made(number, megabytes, little)
        for _ in range(30):
            try:
                begun = asker.begin(files).said
                asker.send(begun, files)
                sent.append(time.monotonic())
                held[number] = asker.ask("POST", f"/api/uploads/{begun['upload']}/finish", {}).said["version"]
                return
            except (OSError, http.client.HTTPException, AssertionError, KeyError, TypeError):
                time.sleep(1)

    _all([threading.Thread(target=send, args=(number,)) for number in range(uploads)])
    out.send((max(sent, default=0.0), time.monotonic(), held))


def _all(threads: list[threading.Thread]) -> None:
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def load(visitors: int, uploads: int, megabytes: int, large: bool, folder: Path) -> None:
    little = listed(make_site(folder / "p"))
    limits = "[limits]\nupload = 1000000000\nuploads = 100\naccount = 100000000000\n"
    with ExitStack() as stack:
        facts: dict[str, Any] = {"more": limits}
        if large:
            store, options = stack.enter_context(atlas_services.s3(folder / "s3"))
            facts = {"database": stack.enter_context(atlas_services.postgresql(safe=True)).url, "store": store,
                     "more": options + limits}
        atlas = stack.enter_context(running(folder / "a", **facts))
        somebody, moderator = atlas.somebody(), atlas.somebody("moderator")
        version = somebody.upload(little).said["version"]
        moderator.ask("POST", f"/api/versions/{version}/accept", {})
        atlas.published()
        _load(atlas, somebody, little, visitors, uploads, megabytes)


def _load(atlas: Atlas, somebody: Asker, little: dict[str, bytes], visitors: int, uploads: int, megabytes: int) -> None:
    fork = multiprocessing.get_context("fork")  # visitors and uploads are not to wait for one another
    visited, visiting = fork.Pipe(duplex=False)
    done, sending = fork.Pipe(duplex=False)
    over = fork.Event()
    fork.Process(target=_visit, args=(atlas.port, visitors, over, visiting), daemon=True).start()
    time.sleep(_ALONE)
    began, killed, up = time.monotonic(), 0.0, 0.0
    fork.Process(target=_send, args=(somebody, uploads, megabytes, little, sending), daemon=True).start()
    memory = processor = before = 0.0
    while not done.poll(1):
        if time.monotonic() > began + _LONGEST:
            raise SystemExit(f"the uploads are not done after {_LONGEST} s")
        used, ran = _used(atlas)
        memory, processor = max(memory, used), max(processor, ran)
        if not killed and _received(atlas) > 0.4e6 * uploads * megabytes:
            killed = time.monotonic()
            atlas.stop(signal.SIGKILL)
            atlas.start()
            up, before, processor = time.monotonic(), processor, 0.0
    sent, ended, held = done.recv()
    over.set()
    answers = visited.recv()
    print(f"{visitors} visitors, {uploads} uploads of {megabytes} MB: killed after {killed - began:.0f} s, up again "
          f"{up - killed:.1f} s later; all had come after {sent - began:.0f} s, all were checked and held after "
          f"{ended - began:.0f} s")
    sound = [one for one in answers if one[1] < killed or one[0] > up]
    for name, first, last in (("alone", 0.0, began), ("while chunks come", began, sent),
                              ("while files are checked", sent, ended)):
        waits = sorted(came - asked for asked, came, status in sound if first <= asked < last and status == 200)
        if waits:
            shares = ", ".join(f"{share:.0%} {1000 * waits[int(share * len(waits))]:.0f} ms"
                               for share in (0.5, 0.95, 0.99))
            print(f"visitors {name}: {len(waits):,} answers, {shares}, longest {1000 * waits[-1]:.0f} ms")
    failed = [status for _, _, status in sound if status != 200]
    print(f"{len(failed)} answers were others than 200: {sorted(set(failed))}")
    print(f"the server: at most {memory:.0f} MiB, {before + processor:.0f} s of processor time")
    parts = server.assemble(configuration.read(atlas.configuration))
    wrong = sum(parts.store.get(f"{HELD}/{version}/{path}") != content for number, version in held.items()
                for path, content in Made(number, megabytes, little).items())
    print(f"{len(held)} of {uploads} sites are held; {wrong} of their files differ from what was sent")


def _used(atlas: Atlas) -> tuple[float, float]:
    """The server's memory in MiB, and the processor's seconds that it took."""
    assert atlas.process is not None
    folder = Path("/proc") / str(atlas.process.pid)
    ran = (folder / "stat").read_text().rpartition(") ")[2].split()[11:13]
    return (int((folder / "status").read_text().partition("VmRSS:")[2].split()[0]) / 1024,
            sum(map(int, ran)) / os.sysconf("SC_CLK_TCK"))


def _received(atlas: Atlas) -> float:
    figures = atlas.visitor.ask("GET", "/metrics", Authorization="Bearer 0123456789abcdef").body.decode()
    return float(figures.partition("\natlas_received_bytes_total ")[2].split()[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("catalogue", "load"))
    parser.add_argument("--sites", type=int, default=100_000)
    parser.add_argument("--visitors", type=int, default=200)
    parser.add_argument("--uploads", type=int, default=20)
    parser.add_argument("--megabytes", type=int, default=200)
    parser.add_argument("--large", action="store_true", help="with PostgreSQL and a store that speaks S3")
    parser.add_argument("--keep", type=Path, help="a new folder to leave the catalogue in")
    given = parser.parse_args()
    os.environ["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        if given.what == "catalogue":
            catalogue(given.sites, given.keep or Path(folder))
        else:
            load(given.visitors, given.uploads, given.megabytes, given.large, Path(folder))


if __name__ == "__main__":
    main()
