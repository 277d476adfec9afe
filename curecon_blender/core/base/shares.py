# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Which paths lead off this computer's own drives. On Windows the mere look at a file on a share logs in there, with
the user's name and a hash of the password: a path that a stranger wrote must not be looked at, not even for whether it
exists."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

_SCHEME = re.compile(r"[a-z][a-z0-9+.-]+:", re.IGNORECASE)  # two letters at least: one is a drive of Windows
_DEVICES = ("?", ".", "??")  # \\?\C:\x, \\.\pipe\x, \??\C:\x


def share_of(path: Path | str) -> str | None:
    r"""The share that a path leads to (`//host/share`, in lower case), or the device, or the scheme of an address; None
    for a path on a drive. It reads the path alone, by Windows' rules on every system."""
    text = str(path).replace("\\", "/")
    if scheme := _SCHEME.match(text):
        return scheme[0].casefold()
    if not text.startswith(("//", "/??/")):
        return None
    parts = [part for part in text.casefold().split("/") if part]
    if ".." in parts:  # where that leads is for Windows to say
        return text
    if parts[:1] and parts[0] in _DEVICES:
        if parts[1:2] != ["unc"]:
            return "/".join(["//?", *parts[1:2]])
        parts = parts[2:]
    return "//" + "/".join(parts[:2])


def is_safe(path: Path | str, chosen: Iterable[Path]) -> bool:
    """Whether a path from a workspace may be looked at: it lies on a drive, or on the share of one of the folders that
    the user has chosen."""
    share = share_of(path)
    return share is None or share in {share_of(folder) for folder in chosen}
