# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""When the photos were taken, as the workspace's `photos.json` has it."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

from ..base.errors import WorkspaceError
from ..base.language import Text
from .record import FILE_NAME, read_photos

FIRST_YEAR, LAST_YEAR = 1900, 2200  # of a photo's time; a clock beyond them was never set


def read_times(workspace: Path) -> dict[str, datetime]:
    """The capture time of every photo that has one, by the photo's name, in order of capture.

    A time is aware (with its offset from UTC) where the photo has EXIF's offset tag, otherwise naive: the camera's
    local time. Raises WorkspaceError when the record is missing or damaged.
    """
    taken = {photo.name: photo.time for photo in read_photos(workspace).photos if photo.time}
    try:
        times = {name: datetime.fromisoformat(time) for name, time in taken.items()}
        if not all(FIRST_YEAR <= time.year <= LAST_YEAR for time in times.values()):
            raise ValueError("a time that no photo can have")
    except ValueError as error:
        path = workspace / FILE_NAME
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))),
            remedy="Delete it and run Reconstruct again.", path=path
        ) from error
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
