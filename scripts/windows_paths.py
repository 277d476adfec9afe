# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Wheels that Windows can unpack: a Windows without long paths takes 259 characters, and torch's licences have more.

Blender gives up a whole wheel when one file of it cannot be written. A wheel of that kind is packed again with the
licences whose path is too long gathered, each under its path, in one text; every other file stays what it was.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import re
import zipfile
from pathlib import Path
from typing import IO

# Where Blender unpacks wheels; the names of Windows' users have up to 20 characters.
FOLDER = (rf"C:\Users\{'u' * 20}\AppData\Roaming\Blender Foundation\Blender\5.2\extensions\.local"
          "\\lib\\python3.13\\site-packages\\")
LONGEST = 259 - len(FOLDER)  # characters of a file's path in a wheel
LONGEST_FOLDER = 247 - len(FOLDER)
GATHERED = "licenses/GATHERED_LICENSES.txt"


def too_long(wheel: Path | IO[bytes]) -> list[str]:
    """The files and folders of a wheel whose path does not fit, or whose folder's does not."""
    with zipfile.ZipFile(wheel) as archive:
        return [name for name in archive.namelist()
                if len(name) > LONGEST or len(name.rpartition("/")[0]) > LONGEST_FOLDER]


def is_shortened(wheel: Path | IO[bytes]) -> bool:
    """Whether a wheel was written by `shorten`, with all that its RECORD names unharmed."""
    with zipfile.ZipFile(wheel) as archive:
        info = _info(archive)
        rows = csv.reader(io.StringIO(archive.read(f"{info}/RECORD").decode()))
        recorded = {row[0]: row[1] for row in rows if row and row[0] != f"{info}/RECORD"}
        names = {name for name in archive.namelist() if not name.endswith("/")} - {f"{info}/RECORD"}
        return (f"{info}/{GATHERED}" in names == set(recorded)
                and all(not digest or digest == _digest(archive.read(name)) for name, digest in recorded.items()))


def shorten(wheel: Path, place: Path) -> None:
    """Write `wheel` to `place` with its licences of too long a path in one file. Raises SystemExit for other files."""
    gone = set(too_long(wheel))
    with zipfile.ZipFile(wheel) as archive, zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as shortened:
        info = _info(archive)
        if others := [name for name in gone if not name.startswith(f"{info}/licenses/")]:
            raise SystemExit(f"{wheel.name} has files whose path is too long for Windows: {', '.join(others)}")
        texts = [f"{'=' * 80}\n{name}\n{'=' * 80}\n\n".encode() + archive.read(name)
                 for name in sorted(gone) if not name.endswith("/")]
        gathered = b"\n\n".join(texts)
        record = [row for row in csv.reader(io.StringIO(archive.read(f"{info}/RECORD").decode())) if row[0] not in gone]
        record.append([f"{info}/{GATHERED}", _digest(gathered), str(len(gathered))])
        for entry in archive.infolist():
            if entry.filename not in gone and entry.filename != f"{info}/RECORD":
                shortened.writestr(entry, archive.read(entry))
        shortened.writestr(f"{info}/{GATHERED}", gathered)
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(record)
        shortened.writestr(f"{info}/RECORD", text.getvalue())


def _info(archive: zipfile.ZipFile) -> str:
    (record,) = (name for name in archive.namelist() if re.fullmatch(r"[^/]+\.dist-info/RECORD", name))
    return record.partition("/")[0]


def _digest(data: bytes) -> str:
    """As RECORD writes it."""
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode().rstrip("=")
