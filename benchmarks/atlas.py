# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The atlas with many sites and under load, on this computer's loopback. Needs atlas/requirements.txt.

    python benchmarks/atlas.py catalogue [--sites 100000]
    python benchmarks/atlas.py load [--visitors 200] [--uploads 20] [--megabytes 200] [--seconds 60]

`catalogue` makes sites up, and says what a visitor's first view of the map costs in bytes. `load` lets visitors read
while uploads run at once; after a third of the time the server is killed and started again, and every upload goes on.
It says latencies and memory, and compares every byte that came. All loops end by themselves.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import http.client
import json
import os
import random
import resource
import signal
import statistics
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

from atlas import configuration, quadkeys, server, words  # noqa: E402
from atlas.database import now  # noqa: E402

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

def upload_of(number: int, megabytes: int, site: dict[str, bytes], noise: memoryview) -> dict[str, Any]:
    """A site's files, filled up to its size with noise: no film and no pictures, which is found when all has come."""
    record = {**json.loads(site["site.json"]), "title": f"Load {number}", "id": f"load-{number}"}
    files: dict[str, Any] = {**site, "site.json": json.dumps(record).encode()}
    at, end = 1_000_003 * number, 1_000_003 * number + 1_000_000 * megabytes
    for name, size in (("film.mp4", 60_000_000), *((f"pictures/{one}.jpg", 8_000_000) for one in range(1, 41))):
        if at < end:
            files[name] = noise[at : min(at + size, end)]
            at += size
    return files


def load(visitors: int, uploads: int, megabytes: int, seconds: int, folder: Path) -> None:
    from atlas_run import Asker, Atlas, free_port, listed, make_site

    site = listed(make_site(folder / "p"))
    noise = memoryview(random.Random(0).randbytes(1_000_003 * uploads + 1_000_000 * megabytes))
    atlas = Atlas(folder / "a", free_port(), more="[limits]\nupload = 400000000\nuploads = 100\naccount = "
                                                  "20000000000\n")
    atlas.start()
    somebody, moderator = atlas.somebody(), atlas.somebody("moderator")
    version = somebody.upload(site).said["version"]
    moderator.ask("POST", f"/api/versions/{version}/accept", {})
    atlas.published()
    ends, waits, failed, most = time.monotonic() + seconds, [], [0], [0]
    killed = threading.Event()

    def visit(number: int) -> None:
        chance = random.Random(number)
        paths = [
            "/",
            "/items.json",
            "/catalogue/map/0/world.json",
            "/sites/gate/site.json",
            "/sites/gate.1/surface/0.glb",
            "/api/search?q=gate",
        ]
        connection = http.client.HTTPConnection("127.0.0.1", atlas.port, timeout=60)
        while time.monotonic() < ends:
            time.sleep(chance.uniform(0.5, 2))
            began = time.perf_counter()
            try:
                connection.request("GET", chance.choice(paths))
                answer = connection.getresponse()
                answer.read()
                if answer.status not in (200, 429):
                    failed[0] += 1
                if not killed.is_set():
                    waits.append(time.perf_counter() - began)
            except (OSError, http.client.HTTPException):
                connection.close()

    results: dict[int, str] = {}

    def send(number: int) -> None:
        files = upload_of(number, megabytes, site, noise)
        asker = Asker(atlas.port, somebody.cookie, somebody.guard)
        for _ in range(20):
            try:
                begun = asker.begin(files).said
                asker.send(begun, files)
                results[number] = begun["upload"]
                return
            except (OSError, http.client.HTTPException, AssertionError, KeyError, TypeError):
                time.sleep(1)

    def watch() -> None:
        while time.monotonic() < ends:
            try:
                text = Path(f"/proc/{atlas.process.pid}/status").read_text()  # type: ignore[union-attr]
                most[0] = max(most[0], int(text.partition("VmRSS:")[2].split()[0]))
            except (OSError, AttributeError, IndexError):
                pass
            time.sleep(0.2)

    threads = [threading.Thread(target=visit, args=(number,)) for number in range(visitors)]
    senders = [threading.Thread(target=send, args=(number,)) for number in range(uploads)]
    began = time.monotonic()
    for thread in [*threads, *senders, threading.Thread(target=watch, daemon=True)]:
        thread.start()
    time.sleep(seconds / 3)
    killed.set()
    atlas.stop(signal.SIGKILL)
    atlas.start()
    time.sleep(2)
    killed.clear()
    for sender in senders:
        sender.join()
    took = time.monotonic() - began
    for thread in threads:
        thread.join()
    waits.sort()
    print(f"{visitors} visitors, {uploads} uploads of {megabytes} MB, one SIGKILL: {took:.0f} s, "
          f"{uploads * megabytes / took:.0f} MB/s; {len(results)} of {uploads} came whole")
    print(f"{len(waits):,} answers to visitors, median {1000 * waits[len(waits) // 2]:.0f} ms, 95 % "
          f"{1000 * waits[int(0.95 * len(waits))]:.0f} ms, 99 % {1000 * waits[int(0.99 * len(waits))]:.0f} ms, longest "
          f"{1000 * waits[-1]:.0f} ms; {failed[0]} failed")
    print(f"memory of the server at most {most[0] / 1024:.0f} MiB; of this program "
          f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")
    wrong = 0
    parts = server.assemble(configuration.read(atlas.configuration))
    for number, upload in results.items():
        files = upload_of(number, megabytes, site, noise)
        with parts.database.read() as transaction:
            for row in transaction.all("SELECT path, number FROM upload_file WHERE upload = :id", id=upload):
                names = transaction.all("SELECT object FROM chunk WHERE upload = :id AND number = :number ORDER BY "
                                        "start", id=upload,
                                        number=row.number)
                there = hashlib.sha256(b"".join(parts.store.get(one.object) for one in names)).digest()
                wrong += there != hashlib.sha256(files[row.path]).digest()
    print(f"{wrong} files differ from what was sent")
    atlas.stop()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("catalogue", "load"))
    parser.add_argument("--sites", type=int, default=100_000)
    parser.add_argument("--visitors", type=int, default=200)
    parser.add_argument("--uploads", type=int, default=20)
    parser.add_argument("--megabytes", type=int, default=200)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--keep", type=Path, help="a new folder to leave the catalogue in")
    given = parser.parse_args()
    os.environ["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory() as folder:
        if given.what == "catalogue":
            catalogue(given.sites, given.keep or Path(folder))
        else:
            load(given.visitors, given.uploads, given.megabytes, given.seconds, Path(folder))


if __name__ == "__main__":
    main()
