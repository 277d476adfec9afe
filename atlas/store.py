# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Bytes by their names, in a folder or in whatever fsspec knows by its URL. What a name holds is whole or not there."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import fsspec

INCOMING, HELD, PUBLIC = "incoming", "held", "public"


class Store:
    """`put`, `get` and `size` raise OSError; FileNotFoundError where there is nothing of that name."""

    def __init__(self, url: str, options: dict[str, Any]) -> None:
        if "://" in url:
            options = {"use_listings_cache": False, **options}  # other machines write, too
        if url.startswith("s3://"):  # with a part some stores send the checksum of the whole; ours are SHA-256
            options = {"config_kwargs": {"response_checksum_validation": "when_required"}, **options}
        self.files, self._root = fsspec.core.url_to_fs(url, **options)
        self.is_folder = "file" in (self.files.protocol if isinstance(self.files.protocol, tuple)
                                    else (self.files.protocol,))
        if self.is_folder:
            os.makedirs(self._root, exist_ok=True)

    def path(self, name: str) -> Path:
        """Of a folder: where a name's bytes lie."""
        return Path(self._root, *name.split("/"))

    def _at(self, name: str) -> str:
        return f"{self._root}/{name}"

    def put(self, name: str, content: bytes) -> None:
        if not self.is_folder:
            self.files.pipe_file(self._at(name), content)
            return
        path = self.path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.urandom(4).hex()}.partial")  # two may write one name at once
        try:
            with open(partial, "xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)

    def get(self, name: str) -> bytes:
        content: bytes = self.path(name).read_bytes() if self.is_folder else self.files.cat_file(self._at(name))
        return content

    def part(self, name: str, start: int, end: int) -> bytes:
        """The bytes from `start` to before `end`, or as many as there are."""
        if not self.is_folder:
            content: bytes = self.files.cat_file(self._at(name), start=start, end=end)
            return content
        with self.path(name).open("rb") as file:
            file.seek(start)
            return file.read(end - start)

    def size(self, name: str) -> int:
        return self.path(name).stat().st_size if self.is_folder else int(self.files.info(self._at(name))["size"])

    def has(self, name: str, size: int) -> bool:
        try:
            return self.size(name) == size
        except FileNotFoundError:
            return False

    def copy(self, source: str, target: str) -> None:
        if not self.is_folder:
            self.files.cp_file(self._at(source), self._at(target))
            return
        path = self.path(target)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_name(f".{path.name}.{os.urandom(4).hex()}.partial")
        try:
            os.link(self.path(source), partial)  # a file that is whole is never written to again
            os.replace(partial, path)
        except OSError:
            self.put(target, self.get(source))
        finally:
            partial.unlink(missing_ok=True)

    def remove(self, name: str) -> None:
        with suppress(FileNotFoundError):
            if self.is_folder:
                self.path(name).unlink()
            else:
                self.files.rm_file(self._at(name))

    def remove_folder(self, name: str) -> None:
        if self.is_folder:
            with suppress(FileNotFoundError):
                shutil.rmtree(self.path(name))
        else:
            with suppress(FileNotFoundError):
                self.files.rm(self._at(name), recursive=True)

    def names(self, folder: str) -> Iterator[tuple[str, int]]:
        """What lies in a folder and below, with its size; nothing where there is none."""
        prefix = len(self._at(""))
        for path, facts in self.files.find(self._at(folder), detail=True).items():
            name = str(path)[prefix:]
            if not name.endswith(".partial"):
                yield name, int(facts["size"])

    def folders(self, folder: str) -> list[str]:
        """The folders right in a folder, by their own names."""
        try:
            found = self.files.ls(self._at(folder), detail=True)
        except FileNotFoundError:
            return []
        return [str(entry["name"]).rstrip("/").rpartition("/")[2] for entry in found if entry["type"] == "directory"]
