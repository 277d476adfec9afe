# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Photos from a video: sharp frames that overlap, with the place and time of the subtitles, and honest words for what
cannot be taken."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import SITE, curecon
from little_photos import check
from mp4_boxes import changed, table, with_track

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import Cancelled, PhotoError
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.photos import video
from curecon_blender.core.photos.subtitle_track import read_track
from curecon_blender.core.photos.subtitles import read_subtitles
from curecon_blender.core.photos.video import take_frames

RATE, SIZE = 30, (640, 360)
STEP = 6  # pixels that the picture moves from frame to frame
SHARP = (0, 5)  # of every ten frames; the others are blurred


def film(path: Path, frames: int = 150, step: int = STEP) -> Path:
    """A flight along a photo of the sample site."""
    ground = cv2.resize(cv2.imread(str(SITE / "photos" / "DJI_0014.JPG")), (2000, 1500))
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), RATE, SIZE)
    for n in range(frames):
        x = n * step
        frame = ground[600 : 600 + SIZE[1], x : x + SIZE[0]]
        writer.write(frame if n % 10 in SHARP else cv2.GaussianBlur(frame, (0, 0), 4))
    writer.release()
    return path


def subtitles(path: Path, line: str, frames: int = 150) -> Path:
    """One entry a frame; `line` may name n, latitude and longitude."""
    entries = []
    for n in range(frames):
        start = f"00:00:{n // RATE:02d},{n % RATE * 1000 // RATE:03d}"
        span = f"{start} --> {start[:-3]}{n % RATE * 1000 // RATE + 33:03d}"
        told = line.format(n=n, latitude=24.658100 + n * 1e-6, longitude=117.052300, second=n // RATE,
                           altitude=350 + n / 100)
        entries.append(f"{n + 1}\n{span}\n{told}\n")
    path.write_text("\n".join(entries))
    return path


NEWER = ('<font size="28">FrameCnt: {n}, DiffTime: 33ms\n2024-06-18 12:45:{second:02d}.123\n[iso: 100] [fnum: 1.7] '
         "[focal_len: 24.00] [latitude: {latitude:.6f}] [longitude: {longitude:.6f}] "
         "[rel_alt: 10.200 abs_alt: {altitude:.3f}] </font>")
OLDER = "HOME(117.0500,24.6500) 2024.06.18 12:45:{second:02d}\nGPS({longitude:.6f},{latitude:.6f},16) BAROMETER:10.2"
THIRD = "F/2.8, SS 206, ISO 150, EV 0, GPS ({longitude:.6f}, {latitude:.6f}, 15), D 24.26m, H 10.20m, H.S 0.00m/s"


@pytest.fixture
def filmed(tmp_path: Path) -> Path:
    film(tmp_path / "DJI_1.MP4")
    subtitles(tmp_path / "DJI_1.SRT", NEWER)
    return tmp_path


def test_a_video_becomes_sharp_overlapping_photos_with_place_and_time(filmed: Path) -> None:
    run = curecon("frames", filmed)
    assert run.code == 0 and run.summary["warnings"] == []
    photo_set, _ = check(filmed)
    photos = photo_set.photos
    assert len(photos) == run.summary["frames"]["DJI_1.MP4"] > 8
    numbers = np.array([int(re.search(r"_(\d{6})\.jpg", photo.name)[1]) for photo in photos])  # type: ignore[index]
    assert all(number % 10 in SHARP for number in numbers)
    moved = np.diff(numbers) * STEP / SIZE[0]
    assert moved.min() > 0.05 and moved.max() < 0.2  # neighbours overlap by 80 % or more
    for number, photo in zip(numbers, photos, strict=True):
        assert photo.gps is not None and photo.gps.latitude == pytest.approx(24.6581 + number * 1e-6, abs=2e-7)
        assert photo.gps.longitude == pytest.approx(117.0523, abs=1e-8)
        assert photo.gps.altitude == pytest.approx(350 + number / 100, abs=0.01)
        assert photo.relative_altitude == pytest.approx(10.2)
        assert photo.time == f"2024-06-18T12:45:{number // RATE:02d}"
        assert photo.focal_px is not None and photo.focal_px / photo.width == pytest.approx(24 / 36, rel=0.1)


def test_frames_are_taken_once_and_a_cancelled_video_is_gone_on_with(filmed: Path) -> None:
    asked = [0]

    def cancelled() -> bool:
        asked[0] += 1
        return asked[0] > 12

    with pytest.raises(Cancelled):
        take_frames(filmed, Reporter(cancelled=cancelled))
    folder = filmed / "DJI_1_frames"
    first = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.jpg")}
    assert 1 <= len(first) < 8
    told: list[Progress] = []

    def sink(message: Message) -> None:
        if isinstance(message, Progress):
            told.append(message)

    taken = take_frames(filmed, Reporter(sink))
    after = {path.name: path.stat().st_mtime_ns for path in folder.glob("*.jpg")}
    assert first.items() <= after.items() and len(after) == taken["DJI_1.MP4"] > 8
    assert told[-1].done == told[-1].total
    assert take_frames(filmed, Reporter()) == taken
    assert {path.name: path.stat().st_mtime_ns for path in folder.glob("*.jpg")} == after
    film(filmed / "DJI_1.MP4", frames=60)  # another video under the name
    assert take_frames(filmed, Reporter())["DJI_1.MP4"] < len(after)


@pytest.mark.parametrize("line", [NEWER, OLDER, THIRD])
def test_the_dialects_of_subtitles(tmp_path: Path, line: str) -> None:
    told = read_subtitles(subtitles(tmp_path / "a.srt", line))
    assert told is not None
    values, clock = told.at(2.0)
    assert values[:2] == pytest.approx([24.6581 + 60e-6, 117.0523], abs=1e-6) and values[3] == pytest.approx(10.2)
    assert clock == ("" if line is THIRD else "2024:06:18 12:45:02")
    assert np.isnan(told.at(60.0)[0]).all()


def test_subtitles_that_tell_no_place_are_said_to(tmp_path: Path) -> None:
    film(tmp_path / "a.mov", frames=60)
    subtitles(tmp_path / "a.srt", "Hello, this is a film", frames=60)
    reporter = Reporter()
    take_frames(tmp_path, reporter)
    assert any("no GPS" in warning for warning in reporter.warnings)
    assert read_subtitles(subtitles(tmp_path / "void.srt", "[latitude: 0.0] [longitude: 0.0]")) is None


def test_a_video_without_motion_gives_one_photo_and_says_so(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", step=0)
    reporter = Reporter()
    assert take_frames(tmp_path, reporter) == {"a.mp4": 1}
    assert any("hardly moves" in warning for warning in reporter.warnings)


def test_a_video_that_is_cut_off_or_none_at_all(tmp_path: Path) -> None:
    with pytest.raises(PhotoError, match="no video in"):
        take_frames(tmp_path, Reporter())
    whole = film(tmp_path / "a.mp4").read_bytes()
    (tmp_path / "a.mp4").write_bytes(whole[: len(whole) // 2])  # its index stands at the end
    with pytest.raises(PhotoError, match="cut off"):
        take_frames(tmp_path, Reporter())
    (tmp_path / "a.mp4").write_bytes(b"no video")
    with pytest.raises(PhotoError, match="cut off"):
        take_frames(tmp_path, Reporter())


def test_a_video_of_hours_is_bounded(filmed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "MOST_FRAMES", 4)
    reporter = Reporter()
    assert take_frames(filmed, reporter) == {"DJI_1.MP4": 4}
    assert any("Only the first 0 of 0 minutes of DJI_1.MP4 were taken" in warning for warning in reporter.warnings)


def test_the_record_of_taken_frames_may_be_damaged(filmed: Path) -> None:
    run = curecon("frames", filmed)
    (filmed / "DJI_1_frames" / "frames.json").write_text(json.dumps({"size": "x"}))
    again = curecon("frames", filmed)
    assert again.code == 5 and "frames.json is missing or damaged" in again.said, run.said


def test_photos_of_a_video_are_as_large_as_its_picture(filmed: Path) -> None:
    take_frames(filmed, Reporter())
    picture = images.read_rgb(next((filmed / "DJI_1_frames").glob("*.jpg")))
    assert picture.shape[:2] == SIZE[::-1]


# ---- videos whose index is changed, as no writer here can make them


def test_subtitles_inside_the_video_tell_the_place_too(tmp_path: Path) -> None:
    path = film(tmp_path / "DJI_1.MP4")
    with_track(path, [NEWER.format(n=n, latitude=24.6581 + n * 1e-5, longitude=117.0523, second=n, altitude=350 + n)
                       for n in range(6)])
    reporter = Reporter()
    assert take_frames(tmp_path, reporter)["DJI_1.MP4"] > 8 and not reporter.warnings
    for photo in check(tmp_path)[0].photos:
        second = int(photo.name[-10:-4]) / RATE
        assert photo.gps is not None and photo.gps.altitude == pytest.approx(350 + second, abs=0.05)
        assert photo.time == f"2024-06-18T12:45:{int(second):02d}"


@pytest.mark.parametrize("spoil", ["handler", "short", "far"])
def test_a_track_that_is_none_or_damaged_tells_nothing(tmp_path: Path, spoil: str) -> None:
    path = film(tmp_path / "DJI_1.MP4", frames=40)
    assert read_track(path) is None
    with_track(path, ["[latitude: 24.6] [longitude: 117.0]"] * 3, b"vide" if spoil == "handler" else b"sbtl")
    assert (read_track(path) is None) == (spoil == "handler")
    content = path.read_bytes()
    place = content.rindex(b"stsz") + 4
    lie = table(0, 0, 2**31 if spoil == "short" else 3, 2**31 - 1)
    path.write_bytes(content[:place] + lie + content[place + len(lie) :])
    assert read_track(path) is None


def test_each_frame_of_a_varying_rate_has_the_place_of_its_own_moment(tmp_path: Path) -> None:
    path = film(tmp_path / "DJI_1.MP4")
    subtitles(tmp_path / "DJI_1.SRT", NEWER, frames=300)

    def slower(inner: bytes) -> bytes:  # from the 50th frame on half as fast
        count, step = struct.unpack_from(">II", inner, 8)
        return table(0, 2, 50, step, count - 50, 2 * step)

    content = path.read_bytes()
    index = content.rindex(b"moov") - 4
    moov = changed(content[index:], (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"), slower)
    path.write_bytes(content[:index] + moov)
    take_frames(tmp_path, Reporter())
    photos = check(tmp_path)[0].photos
    assert len(photos) > 5
    for photo in photos:
        number = int(photo.name[-10:-4])
        shown = number if number <= 50 else 50 + 2 * (number - 50)  # in frames of the subtitles
        assert photo.gps is not None and photo.gps.latitude == pytest.approx(24.6581 + shown * 1e-6, abs=2.1e-6)


def test_a_walk_towards_a_wall_gives_photos_that_overlap(tmp_path: Path) -> None:
    ground = cv2.imread(str(SITE / "photos" / "DJI_0014.JPG"))
    writer = cv2.VideoWriter(str(tmp_path / "walk.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), RATE, SIZE)
    for n in range(150):  # 20 metres off at first, 8 at last, with the sway of steps
        scale = 20 / (20 - 12 * n / 149)
        middle = np.array([600.0 + 6 * np.sin(n / 4), 450 + 4 * np.sin(n / 2)])
        matrix = np.array([[scale, 0, SIZE[0] / 2 - scale * middle[0]], [0, scale, SIZE[1] / 2 - scale * middle[1]]])
        writer.write(cv2.warpAffine(ground, matrix, SIZE))
    writer.release()
    reporter = Reporter()
    assert 3 < take_frames(tmp_path, reporter)["walk.mp4"] < 25
    assert any("no GPS" in warning for warning in reporter.warnings)
