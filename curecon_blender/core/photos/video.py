# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos from a video: of each stretch of the way its sharpest frame, with the place and time that subtitles tell."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from ..base.errors import PhotoError
from ..base.files import atomic_write, disk_errors, read_record, write_json
from ..base.images import shown
from ..base.language import Text
from ..base.messages import Reporter
from .find import find_videos
from .subtitle_track import read_track
from .subtitles import read_subtitles, telemetry

STEP = 0.12  # of the picture's width, that what is seen has moved from one photo to the next: 80 % overlap and more
LOOKED_AT = 6  # frames a second
SMALL = 480  # pixels, width of the frames that are looked at
CORNERS, FEWEST = 400, 0.5  # followed from a photo on; the share of them that must stay in sight
WINDOW = 0.6  # of a step: from then on the sharpest frame is the next photo
MOST_FRAMES = 1500  # of one video; more photos than that take days
STILL = 3  # photos or fewer: nothing moved
_RECORD = "frames.json"
_END_BYTES = 1 << 20
_MODEL, _EXIF, _GPS, _TAKEN, _FILM = 0x0110, 0x8769, 0x8825, 0x9003, 0xA405  # EXIF's tags
_XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" '
    'drone-dji:RelativeAltitude="{height:+.2f}"/></rdf:RDF></x:xmpmeta>'
)


@dataclass(frozen=True)
class Frames:
    """How far a video has been taken: which content, the numbers of the frames that are written, and whether that is
    all of it."""

    content: str
    frames: tuple[int, ...]
    finished: bool


def take_frames(folder: Path, reporter: Reporter) -> dict[str, int]:
    """Write photos of every video in a folder of photos, into a folder beside each; returns how many, by the videos'
    names. What an earlier run has taken stays, and one that was cancelled is gone on with.

    Raises PhotoError where there is no video, or one cannot be read; WorkspaceError where nothing can be written;
    Cancelled.
    """
    videos = find_videos(folder)
    if not videos:
        raise PhotoError(Text("There is no video in {}.", folder),
                         remedy="Choose the folder that holds it.", path=folder)
    taken = {}
    for n, video in enumerate(videos):
        def tell(share: float, done: int = n) -> None:
            reporter.progress(round(1000 * (done + share)), 1000 * len(videos))

        taken[video.name] = _Taking(video, reporter).run(tell)
    return taken


class _Taking:
    """One video on its way into photos."""

    def __init__(self, video: Path, reporter: Reporter) -> None:
        self._video, self._reporter = video, reporter
        self._folder = video.with_name(f"{video.stem}_frames")
        self._done = Frames(_content(video), (), False)
        if (self._folder / _RECORD).is_file():
            earlier = read_record(Frames, self._folder / _RECORD)
            if earlier.content == self._done.content:
                self._done = earlier
        subtitles = next((path for path in video.parent.iterdir()
                          if path.stem == video.stem and path.suffix.lower() == ".srt"), None)
        self._telemetry = read_subtitles(subtitles) if subtitles is not None else None
        if self._telemetry is None and (track := read_track(video)) is not None:
            self._telemetry = telemetry(track)
        if self._telemetry is None:
            reporter.warning(Text("{} has no subtitles (.SRT) that tell positions: its photos have no GPS.",
                                  shown(video)))

    def run(self, tell: Callable[[float], None]) -> int:
        if not self._done.finished:
            with disk_errors(self._folder):
                self._folder.mkdir(exist_ok=True)
            reader = cv2.VideoCapture(str(self._video))
            try:
                self._read(reader, tell)
            finally:
                reader.release()
        tell(1.0)
        if len(self._done.frames) <= STILL:
            self._reporter.warning(
                Text("{} hardly moves: only {} photos were taken of it.", shown(self._video), len(self._done.frames)))
        return len(self._done.frames)

    def _read(self, reader: cv2.VideoCapture, tell: Callable[[float], None]) -> None:
        count, rate = reader.get(cv2.CAP_PROP_FRAME_COUNT), reader.get(cv2.CAP_PROP_FPS)
        if not reader.isOpened() or not 0 < rate < 1000 or not reader.grab():
            raise PhotoError(
                Text("{} is no video that can be read, or it is cut off.", shown(self._video)), path=self._video,
                remedy="Copy it from the drone again, or repair it with a video program.")
        every, number = max(1, round(rate / LOOKED_AT)), 0
        first = self._done.frames[-1] + 1 if self._done.frames else 0
        way = _Way()
        while True:
            if number >= first and (number - first) % every == 0:
                tell(min(number / count, 1.0) if count > 0 else 0.0)
                read, frame = reader.retrieve()
                if not read:
                    break
                chosen = way.look(number, reader.get(cv2.CAP_PROP_POS_MSEC) / 1000, frame)
                if chosen is not None:
                    self._write(chosen)
                if len(self._done.frames) >= MOST_FRAMES:
                    self._reporter.warning(
                        Text("Only the first {:.0f} of {:.0f} minutes of {} were taken: cut it into shorter videos "
                             "for the rest.", number / rate / 60, count / rate / 60, shown(self._video)))
                    break
            if not reader.grab():
                break
            number += 1
        if count > 0 and number < 0.98 * count - 2 and len(self._done.frames) < MOST_FRAMES:
            self._reporter.warning(Text("{} is cut off or damaged after {:.0f} of {:.0f} seconds: what follows is "
                                        "lost.", shown(self._video), number / rate, count / rate))
        self._done = replace(self._done, finished=True)
        write_json(self._folder / _RECORD, asdict(self._done))

    def _write(self, chosen: _Candidate) -> None:
        """Write a frame as a photo with its time and place, and note that it is done."""
        tags, packet = Image.Exif(), b""
        tags[_MODEL] = f"video {chosen.frame.shape[1]}x{chosen.frame.shape[0]}"
        if self._telemetry is not None:
            values, clock = self._telemetry.at(chosen.second)
            _tell_place(tags, values)
            if clock:
                tags.get_ifd(_EXIF)[_TAKEN] = clock
            if self._telemetry.focal is not None:
                tags.get_ifd(_EXIF)[_FILM] = round(self._telemetry.focal)
            if np.isfinite(values[3]):
                packet = _XMP.format(height=values[3]).encode()
        encoded = io.BytesIO()
        picture = Image.fromarray(cv2.cvtColor(chosen.frame, cv2.COLOR_BGR2RGB))
        picture.save(encoded, "JPEG", quality=95, exif=tags, xmp=packet)
        with atomic_write(self._folder / f"{self._video.stem}_{chosen.number:06d}.jpg") as file:
            file.write(encoded.getbuffer())
        self._done = replace(self._done, frames=(*self._done.frames, chosen.number))
        write_json(self._folder / _RECORD, asdict(self._done))


@dataclass(frozen=True)
class _Candidate:
    """A frame (H,W,3) BGR that may become a photo, small and grey, and how sharp it is."""

    number: int
    second: float
    frame: np.ndarray
    small: np.ndarray
    sharpness: float


class _Way:
    """Follows corners from the last photo on, and says when the next one is due."""

    def __init__(self) -> None:
        self._best: _Candidate | None = None
        self._before: np.ndarray | None = None
        self._start: np.ndarray = np.empty((0, 1, 2), np.float32)  # where corners lay in the last photo
        self._now = self._start  # and where they lie
        self._corners = 0

    def look(self, number: int, second: float, frame: np.ndarray) -> _Candidate | None:
        """The next photo, where this frame shows that it is due; the first frame is one."""
        size = SMALL, max(1, round(frame.shape[0] * SMALL / frame.shape[1]))
        small = cv2.cvtColor(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY)
        candidate = _Candidate(number, second, frame, small, float(cv2.Laplacian(small, cv2.CV_32F).var()))
        if self._before is None:
            self._begin(candidate)
            return candidate
        moved = self._follow(small)
        if moved >= WINDOW * STEP * SMALL and (self._best is None or candidate.sharpness > self._best.sharpness):
            self._best = candidate
        if moved < STEP * SMALL:
            return None
        chosen = self._best or candidate
        self._begin(chosen)
        self._follow(small)
        return chosen

    def _begin(self, candidate: _Candidate) -> None:
        found = cv2.goodFeaturesToTrack(candidate.small, CORNERS, 0.01, 8)
        self._start = self._now = np.empty((0, 1, 2), np.float32) if found is None else np.asarray(found)
        self._corners, self._before, self._best = len(self._start), candidate.small, None

    def _follow(self, small: np.ndarray) -> float:
        """Follow the corners into the next frame; returns pixels that they have moved since the last photo, as much as
        a step where too few are still seen."""
        if len(self._now) and self._before is not None:
            now, found, _ = cv2.calcOpticalFlowPyrLK(self._before, small, self._now, np.empty_like(self._now))
            kept = np.asarray(found).ravel() == 1
            self._start, self._now = self._start[kept], np.asarray(now)[kept]
        self._before = small
        if len(self._now) < FEWEST * self._corners or not len(self._now):
            return STEP * SMALL
        return float(np.median(np.linalg.norm(self._now - self._start, axis=2)))


def _content(video: Path) -> str:
    """What tells one video from another: its size and a digest of its ends."""
    with open(video, "rb") as file:
        digest = hashlib.sha256(file.read(_END_BYTES))
        size = file.seek(0, os.SEEK_END)
        file.seek(max(size - _END_BYTES, 0))
        digest.update(file.read(_END_BYTES))
    return f"{size} {digest.hexdigest()}"


def _tell_place(tags: Image.Exif, values: np.ndarray) -> None:
    latitude, longitude, altitude, _ = (float(value) for value in values)
    if not np.isfinite(latitude + longitude):
        return
    gps = tags.get_ifd(_GPS)
    gps[1], gps[2] = "N" if latitude >= 0 else "S", _degrees(abs(latitude))
    gps[3], gps[4] = "E" if longitude >= 0 else "W", _degrees(abs(longitude))
    if np.isfinite(altitude):
        gps[5], gps[6] = b"\x00" if altitude >= 0 else b"\x01", abs(altitude)


def _degrees(value: float) -> tuple[float, float, float]:
    """Degrees, minutes and seconds, to a millimetre."""
    minutes = value % 1 * 60
    return float(int(value)), float(int(minutes)), round(minutes % 1 * 60, 5)
