# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A photo's place and hour: one source for a whole position, altitudes that are none, and UTC."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from little_photos import exif, save
from PIL.TiffImagePlugin import IFDRational
from test_metadata import DJI_ATTRIBUTES, SOUTH_WEST

from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.photos.capture import to_utc
from curecon_blender.core.photos.metadata import Metadata, read_metadata


def told_by(folder: Path, gps: dict[int, Any] | None, xmp: bytes = b"", **tags: Any) -> Metadata:
    return read_metadata(save(folder / "x.jpg", 1, exif=exif(gps=gps, **tags), xmp=xmp))


DJI = GeoPosition(latitude=45.03159568, longitude=-7.62046587, altitude=349.58)


class TestOneSourceForAWholePosition:
    @pytest.mark.parametrize("gps", [
        {2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0), 6: 0.0}, {2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0), 6: 12.0}, {6: 0.0},
        {5: None, 6: None}, {0xA: "2"}, {6: 90_000.0}, {9: "V"},
    ], ids=["all void", "void place", "void altitude", "no altitude", "two dimensions", "beyond the sky", "no fix"])
    def test_where_exif_s_is_not_whole_all_is_of_xmp(self, tmp_path: Path, gps: dict[int, Any]) -> None:
        assert told_by(tmp_path, {**SOUTH_WEST, **gps}, DJI_ATTRIBUTES).gps == DJI

    def test_a_whole_one_of_exif_takes_nothing_of_xmp(self, tmp_path: Path) -> None:
        gps = told_by(tmp_path, SOUTH_WEST, DJI_ATTRIBUTES).gps
        assert gps is not None and gps.altitude == pytest.approx(349.583) and gps.latitude < 0

    @pytest.mark.parametrize("gps", [{5: None, 6: None}, {6: 0.0}, {6: 90_000.0}, {0xA: "2"}])
    def test_a_place_without_an_altitude_is_a_position(self, tmp_path: Path, gps: dict[int, Any]) -> None:
        told = told_by(tmp_path, {**SOUTH_WEST, **gps}, DJI_ATTRIBUTES.replace(b"drone-dji:Gps", b"drone-dji:Gone")).gps
        assert told is not None
        assert (told.altitude, told.altitude_datum) == (None, "unknown")
        assert told.latitude == pytest.approx(-(33 + 51 / 60 + 21.6 / 3600))


class TestOddReferences:
    @pytest.mark.parametrize("reference", [b"\x01", b"1", b"1\x00", b"Below sea level", b"\x03"])
    def test_below_the_sea(self, tmp_path: Path, reference: Any) -> None:
        gps = told_by(tmp_path, {**SOUTH_WEST, 5: reference, 6: 12.5}).gps
        assert gps is not None and gps.altitude == -12.5

    @pytest.mark.parametrize("reference", [b"0", b"0\x00", b"Above sea level", b"\x09", None])
    def test_above_the_sea(self, tmp_path: Path, reference: Any) -> None:
        gps = told_by(tmp_path, {**SOUTH_WEST, 5: reference, 6: 12.5}).gps
        assert gps is not None and gps.altitude == 12.5

    def test_a_negative_altitude_written_without_a_sign(self, tmp_path: Path) -> None:
        gps = told_by(tmp_path, {**SOUTH_WEST, 6: IFDRational(2**32 - 12_500, 1000)}).gps
        assert gps is not None and gps.altitude == -12.5

    def test_words_for_the_hemispheres(self, tmp_path: Path) -> None:
        gps = told_by(tmp_path, {**SOUTH_WEST, 1: "South", 3: "w"}).gps
        assert gps is not None and gps.latitude < 0 and gps.longitude < 0


class TestUtc:
    @pytest.mark.parametrize(("gps", "camera", "expected"), [
        # The clock reads 13:50:17.
        ({29: "2026:01:26", 7: (5.0, 50.0, 19.0)}, {}, "2026-01-26T13:50:17+08:00"),
        ({29: "2026:01:26", 7: (8.0, 5.0, 17.0)}, {}, "2026-01-26T13:50:17+05:45"),  # Nepal
        ({29: "2026:01:26", 7: (5.0, 50.0, 19.0)}, {0x9011: "+01:00"}, "2026-01-26T13:50:17+08:00"),
        ({29: "2026:01:27", 7: (1.0, 50.0, 17.0)}, {}, "2026-01-26T13:50:17-12:00"),
        ({29: "2026:01:26", 7: (5.0, 56.0, 17.0)}, {}, "2026-01-26T13:50:17+07:54"),  # the clock is six minutes late
        ({29: "2026:03:01", 7: (5.0, 50.0, 19.0)}, {}, "2026-03-01T05:50:19+00:00"),  # the clock was never set
        ({29: "2026:01:26", 7: (25.0, 0.0, 0.0)}, {0x9011: "+01:00"}, "2026-01-26T13:50:17+01:00"),
        ({29: "yesterday", 7: (5.0, 50.0, 19.0)}, {}, "2026-01-26T13:50:17"),
        ({}, {0x9010: "+09:00"}, "2026-01-26T13:50:17+09:00"),
        ({}, {0x9012: "-03:30"}, "2026-01-26T13:50:17-03:30"),
        ({}, {0x9011: "summer", 0x9012: "+02:00"}, "2026-01-26T13:50:17+02:00"),
        ({29: "2026:01:26", 7: (5.0, 50.0, 19.0)}, {0x9003: None}, "2026-01-26T05:50:19+00:00"),
    ])
    def test_gps_first_then_the_camera_s_offset(
        self, tmp_path: Path, gps: dict[int, Any], camera: dict[int, Any], expected: str
    ) -> None:
        assert told_by(tmp_path, {**SOUTH_WEST, **gps}, camera=camera).time == expected

    def test_xmp_s_clock_and_utc(self, tmp_path: Path) -> None:
        exact = DJI_ATTRIBUTES.replace(b"/>", b' drone-dji:UTCAtExposure="2026-01-26T05:50:17.301"/>')
        assert told_by(tmp_path, None, exact).time == "2026-01-26T13:50:17+08:00"
        written = DJI_ATTRIBUTES.replace(
            b"/>", b' xmlns:xmp="http://ns.adobe.com/xap/1.0/" xmp:CreateDate="2026-01-26T13:50:17-05:00"/>')
        assert told_by(tmp_path, None, written).time == "2026-01-26T13:50:17-05:00"

    def test_the_longitude_s_hour_comes_last(self) -> None:
        clock = datetime(2026, 1, 26, 13, 50, 17)
        assert to_utc(clock, 117.0) == datetime(2026, 1, 26, 5, 50, 17, tzinfo=UTC)
        assert to_utc(datetime.fromisoformat("2026-01-26T13:50:17+07:54"), 117.0).hour == 5
