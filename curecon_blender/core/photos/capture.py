# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""When the photos were taken, as the workspace's `photos.json` has it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

from ..base.errors import WorkspaceError
from ..base.reading import read_json

FILE_NAME = "photos.json"
FIRST_YEAR, LAST_YEAR = 1900, 2200  # of a photo's time; a clock beyond them was never set


def read_times(workspace: Path) -> dict[str, datetime]:
    """The capture time of every photo that has one, by the photo's name, in order of capture.

    A time is aware (with its offset from UTC) where the photo has EXIF's offset tag, otherwise naive: the camera's
    local time. Raises WorkspaceError when the record is missing or damaged.
    """
    path = workspace / FILE_NAME
    try:
        photos = read_json(path)["photos"]
        times = {photo["name"]: datetime.fromisoformat(photo["time"]) for photo in photos if photo["time"]}
        if not all(isinstance(name, str) and FIRST_YEAR <= time.year <= LAST_YEAR for name, time in times.items()):
            raise ValueError("a time that no photo can have")
    except FileNotFoundError as error:
        raise WorkspaceError(
            f"{path} is missing, so the photos' capture times are unknown.",
            remedy="Run Reconstruct with the photos in this workspace.", path=path,
        ) from error
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise WorkspaceError(f"{path} is damaged.", remedy="Delete it and run Reconstruct again.", path=path) from error
    # By the clock's face: photos with and without an offset cannot be compared otherwise.
    return dict(sorted(times.items(), key=lambda item: (item[1].replace(tzinfo=None), item[0])))


def middle_time(times: dict[str, datetime]) -> datetime:
    """The time of the photo in the middle of the series. `times` as from `read_times`, not empty."""
    return list(times.values())[len(times) // 2]


def to_utc(time: datetime, longitude: float) -> datetime:
    """`time` in UTC. A time without an offset is taken to be of the longitude's own hour (degrees, east positive),
    since EXIF tells the camera's local time alone; summer time and borders may make that wrong by an hour or two."""
    if time.tzinfo is None:
        time = time.replace(tzinfo=timezone(timedelta(hours=round(longitude / 15))))
    return time.astimezone(UTC)
