# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A published site to an atlas, in chunks. What was sent stays there: the same files sent again go on from it."""

from __future__ import annotations

import hashlib
import json
import re
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ..base.errors import CuReconError, WorkspaceError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.reading import parse_json, read_bytes
from . import film
from .folder import SITES
from .records import PublishError

STAGE = "upload"
_TAKEN = re.compile(
    r"(site\.json|thumbnail\.jpg|film\.mp4|pictures/\d+\.jpg|(surface|cloud)/(tileset\.json|earth\.json|\d+\.glb))"
)
_MOST_ANSWER = 8 << 20
_PATIENCE = 120  # seconds for an answer
_WAITS = (1, 3, 10, 30)  # seconds before an attempt is made again
_AGAIN = (408, 429, 500, 502, 503, 504, 507)
_SCHEME = "Bearer"
_LOOPBACK = ("127.0.0.1", "localhost", "::1")


class UploadError(CuReconError):
    """The atlas does not answer, or does not take the site."""

    exit_code = 17
    kind = "upload"


@dataclass(frozen=True, kw_only=True)
class Added:
    """What a site is found by at an atlas, beside what it says itself: tags with commas between, its number in a
    heritage register, first and last year."""

    tags: str = ""
    register: str = ""
    period: Sequence[int] | None = None

    def as_json(self) -> dict[str, Any]:
        first, last = self.period or (None, None)
        return {"tags": [tag.strip() for tag in re.split("[,，、]", self.tags) if tag.strip()],
                "register": self.register.strip(), "period_from": first, "period_to": last}


def upload(folder: Path, name: str, added: Added, atlas: Atlas, reporter: Reporter) -> dict[str, Any]:
    """Send site `name` of a published folder, or the only one where `name` is empty, to an atlas. A moderator there
    decides on it. Raises PublishError, UploadError, WorkspaceError, Cancelled."""
    site = _site(folder, name)
    reporter.stage(STAGE)
    files = sorted(path for path in site.rglob("*")
                   if path.is_file() and _TAKEN.fullmatch(path.relative_to(site).as_posix()))
    contents = {path.relative_to(site).as_posix(): path for path in files}
    listed, total = [], 0
    for name_, path in contents.items():
        reporter.check_cancelled()
        content = _content(path)
        total += len(content)
        listed.append({"path": name_, "size": len(content), "sha256": hashlib.sha256(content).hexdigest()})
    begun = atlas.ask("POST", "api/uploads", {"files": listed, "added": added.as_json()})
    done = sum(one["received"] for one in begun["files"])
    reporter.progress(done, total, fresh=False)
    for number, one in enumerate(begun["files"]):
        content, start = _content(contents[one["path"]]), one["received"]
        while start < len(content):
            part = content[start : start + begun["chunk"]]
            end = atlas.send(f"api/uploads/{begun['upload']}/{number}?start={start}", part, start)
            done, start = done + end - start, end
            reporter.progress(done, total)
    held = atlas.ask("POST", f"api/uploads/{begun['upload']}/finish", {})
    return {"uploaded": atlas.address, "version": held["version"], "bytes": total, "warnings": reporter.warnings}


def _site(folder: Path, name: str) -> Path:
    if (folder / "site.json").is_file():
        return folder
    found = sorted(path.parent for path in (folder / SITES).glob(f"{name or '*'}/site.json"))
    if not found:
        raise PublishError(Text("{} holds no published site of that name.", folder), path=folder,
                           remedy="Choose the folder that Publish Web Pages wrote.")
    if len(found) > 1:
        raise PublishError(
            Text("{} holds {} sites: name one.", folder, len(found)),
            path=folder,
            remedy=Text("Give one of these names (--site): {}", ", ".join(one.name for one in found[:20])),
        )
    return found[0]


def _content(path: Path) -> bytes:
    try:
        return read_bytes(path, film.LARGEST)
    except (OSError, ValueError) as error:
        raise WorkspaceError(Text("{} cannot be read ({}).", path, Text(str(error))), path=path,
                             remedy="Publish the site again, then upload it.") from error


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """The token goes to the atlas's address and to no other."""

    def redirect_request(self, *_: Any) -> None:
        return None


class Atlas:
    """Asks the atlas at `address`, which answers in `language`, such as zh_HANS. Raises UploadError."""

    def __init__(self, address: str, token: str, language: str, reporter: Reporter) -> None:
        parts = urlsplit(address)
        if (
            parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in _LOOPBACK)
        ) or not parts.hostname:
            raise UploadError(Text("{} is no safe address of an atlas.", address), remedy="It begins with https://.")
        if not re.fullmatch(r"atlas_[\w-]{20,100}", token):
            raise UploadError("There is no token for the atlas.",
                              remedy="Make one on your page of the atlas, and put it into the preferences.")
        self.address, self._token, self._reporter = address.rstrip("/"), token, reporter
        self._language = language.replace("_", "-") or "en"
        self._open = urllib.request.build_opener(
            _NoRedirect, urllib.request.HTTPSHandler(context=ssl.create_default_context())).open

    def ask(self, method: str, path: str, value: Any) -> dict[str, Any]:
        status, said = self._answer(method, path, json.dumps(value).encode(), "application/json")
        if status != 200:
            raise self._refused(said)
        return said

    def send(self, path: str, part: bytes, start: int) -> int:
        """Where the file's next chunk begins; the atlas may have had this one already."""
        status, said = self._answer("PUT", path, part, "application/octet-stream")
        if status == 409 and isinstance(said.get("offset"), int) and said["offset"] != start:
            return int(said["offset"])
        if status != 200:
            raise self._refused(said)
        return int(said["received"])

    def _answer(self, method: str, path: str, body: bytes, kind: str) -> tuple[int, dict[str, Any]]:
        """The status and the JSON of an answer. What may pass is tried again for a while. Raises UploadError,
        Cancelled."""
        why = ""
        for wait in (*_WAITS, None):
            self._reporter.check_cancelled()
            request = urllib.request.Request(f"{self.address}/{path}", body, method=method, headers={
                "Authorization": " ".join((_SCHEME, self._token)), "Content-Type": kind, "User-Agent": "CU-Recon",
                "Accept-Language": self._language})
            try:
                try:
                    with self._open(request, timeout=_PATIENCE) as answer:
                        return answer.status, self._json(answer)
                except urllib.error.HTTPError as error:
                    with error:
                        said = self._json(error)
                    if error.code not in _AGAIN:
                        return error.code, said
                    why = str(said.get("said") or error)
            except (OSError, ValueError, urllib.error.URLError) as error:
                why = str(error)
            for _ in range(10 * (wait or 0)):
                self._reporter.check_cancelled()
                time.sleep(0.1)
        raise UploadError(Text("The atlas at {} does not answer ({}).", self.address, Text(why[:300])),
                          remedy="Upload again later: it goes on from where it stopped.")

    @staticmethod
    def _json(answer: Any) -> dict[str, Any]:
        found = parse_json(answer.read(_MOST_ANSWER).decode("utf-8", "replace") or "{}")
        return found if isinstance(found, dict) else {}

    def _refused(self, said: dict[str, Any]) -> UploadError:
        return UploadError(Text("The atlas does not take the site: {}", Text(str(said.get("said", ""))[:1000])),
                           remedy="Change what it names, then upload again.")
