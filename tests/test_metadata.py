# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What is read of a photo's EXIF and XMP."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from little_photos import HEIGHT, WIDTH, check, exif, save, scene, sound_folder
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from curecon_blender.core.base.records import Gimbal, Lens
from curecon_blender.core.photos.check import describe
from curecon_blender.core.photos.metadata import read_metadata

DJI_ATTRIBUTES = b"""<?xpacket begin="\xef\xbb\xbf" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="DJI Meta Data" xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"
 drone-dji:AbsoluteAltitude="+349.58" drone-dji:RelativeAltitude="+44.47"
 drone-dji:GpsLatitude="45.03159568" drone-dji:GpsLongtitude="-7.62046587"
 drone-dji:GimbalRollDegree="+0.10" drone-dji:GimbalYawDegree="-106.80" drone-dji:GimbalPitchDegree="-89.90"/>
</rdf:RDF></x:xmpmeta>
<?xpacket end="w"?>"""
DJI_ELEMENTS = b"""<x:xmpmeta xmlns:x="adobe:ns:meta/">
<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/">
<drone-dji:AbsoluteAltitude>+349.58</drone-dji:AbsoluteAltitude>
<drone-dji:RelativeAltitude>+44.47</drone-dji:RelativeAltitude>
<drone-dji:GpsLatitude>45.03159568</drone-dji:GpsLatitude>
<drone-dji:GpsLongitude>-7.62046587</drone-dji:GpsLongitude>
<drone-dji:GimbalRollDegree>+0.10</drone-dji:GimbalRollDegree>
<drone-dji:GimbalYawDegree>-106.80</drone-dji:GimbalYawDegree>
<drone-dji:GimbalPitchDegree>-89.90</drone-dji:GimbalPitchDegree>
</rdf:Description></rdf:RDF></x:xmpmeta>\x00\x00"""
SOUTH_WEST = {1: "S", 2: (33.0, 51.0, 21.6), 3: "W", 4: (70.0, 30.0, 9.0), 5: b"\x00", 6: 349.583}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return sound_folder(tmp_path)


class TestMetadata:
    def test_exif_and_xmp_are_read_back_exactly(self, folder: Path) -> None:
        for number in range(3):
            path = folder / f"DJI_{number}.JPG"
            save(path, number, exif=exif(gps=SOUTH_WEST, camera={0x9011: "+08:00"}), xmp=DJI_ATTRIBUTES)
        photo_set, _ = check(folder)
        photo = photo_set.photos[0]
        assert photo.gps is not None
        assert photo.gps.latitude == pytest.approx(-(33 + 51 / 60 + 21.6 / 3600), abs=1e-9)
        assert photo.gps.longitude == pytest.approx(-(70 + 30 / 60 + 9 / 3600), abs=1e-9)
        assert photo.gps.altitude == pytest.approx(349.583, abs=1e-6)
        assert photo.gimbal == Gimbal(yaw=-106.8, pitch=-89.9, roll=0.1)
        assert photo.relative_altitude == 44.47
        assert photo.time == "2026-01-26T13:50:17+08:00"
        assert photo.camera == "DJI FC9999 8.8 mm as 24 mm 320x240"
        # 24 mm on film's diagonal of 43.27 mm; the photo's diagonal is 400 pixels.
        focal_px = 24 * 400 / math.hypot(36, 24)
        assert photo.focal_px == pytest.approx(focal_px)

        summary = describe(photo_set)
        assert (summary["photos"], summary["cameras"], summary["with_gps"], summary["with_gimbal"]) == (3, 1, 3, 3)
        assert summary["size"] == [WIDTH, HEIGHT]
        assert summary["ground_sampling_distance_mm"] == pytest.approx(1000 * 44.47 / focal_px, abs=0.01)
        assert json.loads(json.dumps(summary)) == summary

    @pytest.mark.parametrize("packet", [DJI_ATTRIBUTES, DJI_ELEMENTS], ids=["attributes", "elements"])
    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
    def test_xmp_stands_in_for_missing_exif(self, tmp_path: Path, packet: bytes, suffix: str) -> None:
        path = tmp_path / f"x{suffix}"
        options: dict[str, Any] = {"xmp": packet}
        if suffix == ".png":
            info = PngInfo()
            info.add_itxt("XML:com.adobe.xmp", packet.decode().rstrip("\x00"))
            options = {"pnginfo": info}
        if suffix == ".tif":
            options = {"tiffinfo": {700: packet}}
        told = read_metadata(save(path, 1, **options))
        assert told.gps is not None
        assert (told.gps.latitude, told.gps.longitude, told.gps.altitude) == (45.03159568, -7.62046587, 349.58)
        assert told.gimbal == Gimbal(yaw=-106.8, pitch=-89.9, roll=0.1)
        assert told.relative_altitude == 44.47
        assert (told.camera, told.focal_px, told.time) == ("", None, None)

    @pytest.mark.parametrize(
        "packet", [b"<x:xmpmeta", b"\xff\xfe\x00", b"", b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'],
    )
    def test_malformed_xmp_loses_only_itself(self, tmp_path: Path, packet: bytes) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(gps=SOUTH_WEST), xmp=packet))
        assert told.gimbal is None
        assert told.gps is not None
        assert told.focal_px is not None

    def test_malformed_tag_loses_only_itself(self, tmp_path: Path) -> None:
        packet = DJI_ATTRIBUTES.replace(b"+44.47", b"high")
        wrong = {0x9003: "yesterday", 0xA405: None, 0x920A: "long"}
        tags = exif(camera=wrong, gps={**SOUTH_WEST, 2: (333.0, 0.0, 0.0)})
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=tags, xmp=packet))
        assert (told.relative_altitude, told.time, told.focal_px) == (None, None, None)
        assert told.gimbal == Gimbal(yaw=-106.8, pitch=-89.9, roll=0.1)
        assert told.gps is not None
        assert told.gps.latitude == 45.03159568  # XMP's, as EXIF's is nonsense
        assert told.camera == "DJI FC9999"

    @pytest.mark.parametrize(
        "change", [{2: (0.0, 0.0, 0.0), 4: (0.0, 0.0, 0.0)}, {2: (91.0, 0.0, 0.0)}, {4: (181.0, 0.0, 0.0)},
                   {1: "X"}, {9: "V"}, {2: (33.0, 51.0)}],
        ids=["no fix", "latitude", "longitude", "reference", "void", "two parts"],
    )
    def test_gps_nonsense_is_rejected(self, tmp_path: Path, change: dict[int, Any]) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(gps={**SOUTH_WEST, **change})))
        assert told.gps is None
        assert told.focal_px is not None

    @pytest.mark.parametrize(("version", "reference", "altitude", "datum"), [
        (b"0230", b"\x00", 349.583, "sea level"), (b"0230", b"\x01", -349.583, "sea level"),
        (b"0300", b"\x00", 349.583, "ellipsoid"), (b"0300", b"\x01", -349.583, "ellipsoid"),
        (b"0300", b"\x02", 349.583, "sea level"), (b"0300", b"\x03", -349.583, "sea level"),
        (b"0232", b"\x02", 349.583, "sea level"), (None, b"\x00", 349.583, "sea level"),
        (b"0230", None, 349.583, "unknown"), (b"0230", b"\x09", 349.583, "unknown"),
    ])
    def test_exif_says_what_an_altitude_counts_from(
        self, tmp_path: Path, version: bytes | None, reference: bytes | None, altitude: float, datum: str
    ) -> None:
        tags = exif(camera={0x9000: version}, gps={**SOUTH_WEST, 5: reference})
        gps = read_metadata(save(tmp_path / "x.jpg", 1, exif=tags)).gps
        assert gps is not None
        assert (gps.altitude, gps.altitude_datum) == (pytest.approx(altitude), datum)

    @pytest.mark.parametrize(("tags", "datum"), [
        (b'drone-dji:RtkFlag="50"', "ellipsoid"), (b'drone-dji:AltitudeType="RtkAlt"', "ellipsoid"),
        (b'drone-dji:RtkFlag="34"', "unknown"), (b'drone-dji:RtkFlag="0"', "sea level"), (b"", "sea level"),
        (b'xmlns:Camera="http://pix4d.com/camera/1.0/" Camera:VertCS="ellipsoidal"', "ellipsoid"),
        (b'xmlns:Camera="http://pix4d.com/camera/1.0" Camera:VertCS="EPSG:5773"', "sea level"),
    ])
    def test_the_drone_knows_better_what_an_altitude_counts_from(
        self, tmp_path: Path, tags: bytes, datum: str
    ) -> None:
        packet = DJI_ATTRIBUTES.replace(b"/>", b" " + tags + b"/>")
        gps = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(gps=SOUTH_WEST), xmp=packet)).gps
        assert gps is not None
        assert gps.altitude_datum == datum
        alone = read_metadata(save(tmp_path / "y.jpg", 1, xmp=packet)).gps  # of XMP's altitude, EXIF says nothing
        assert alone is not None
        assert alone.altitude_datum == ("unknown" if b"RtkFlag=\"0\"" in tags or not tags else datum)

    def test_focal_length_by_the_focal_plane(self, tmp_path: Path) -> None:
        # 10 mm at 4000 pixels per 13.2 mm, in a photo since scaled down from 4000 pixels to 320.
        tags = exif(camera={0xA405: None, 0x920A: 10.0, 0xA20E: 4000 / 13.2, 0xA210: 4, 0xA002: 4000, 0xA003: 3000})
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=tags))
        assert told.focal_px == pytest.approx(10 / 13.2 * WIDTH, rel=1e-4)

    def test_focal_length_by_a_known_sensor(self, tmp_path: Path) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(main={0x0110: "FC6310"}, camera={0xA405: None})))
        assert told.focal_px == pytest.approx(8.8 / 13.2 * WIDTH)

    def test_no_focal_length_is_made_up(self, tmp_path: Path) -> None:
        assert read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(camera={0xA405: None}))).focal_px is None

    def test_wide_crop_keeps_the_whole_sensors_focal_length(self, tmp_path: Path) -> None:
        whole = read_metadata(save(tmp_path / "whole.jpg", 1, exif=exif()))
        Image.fromarray(scene(1, 320, 180)).save(tmp_path / "crop.jpg", exif=exif())
        assert read_metadata(tmp_path / "crop.jpg").focal_px == pytest.approx(whole.focal_px)

    @pytest.mark.parametrize(
        ("tags", "expected"),
        [(b'drone-dji:CalibratedFocalLength="1913.33"', 1913.33),
         (b'drone-dji:DewarpData="2022-03-02;1973.0,1955.0,-19,-11,-0.4,0.3,0,0,-0.2"', math.sqrt(1973 * 1955))],
    )
    def test_the_drones_calibration_comes_first_and_follows_scaling(
        self, tmp_path: Path, tags: bytes, expected: float
    ) -> None:
        packet = DJI_ATTRIBUTES.replace(b"/>", b' drone-dji:CalibratedOpticalCenterX="1600" ' + tags + b"/>")
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=packet))
        assert told.focal_px == pytest.approx(expected * WIDTH / 3200)

    def test_two_calibrated_focal_lengths_are_as_unsure_as_they_differ(self, tmp_path: Path) -> None:
        """A Phantom 4 Multispectral tells 1913 pixels beside 1973 and 1955."""
        packet = _calibrated().replace(b"/>", b' drone-dji:CalibratedFocalLength="1913.33"/>')
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=packet))
        assert told.focal_sigma == pytest.approx(1 - 1913.33 / math.sqrt(1973 * 1955), rel=0.05)
        one = read_metadata(save(tmp_path / "y.jpg", 1, exif=exif(), xmp=_calibrated()))
        assert one.focal_sigma is not None and one.focal_sigma < 0.01

    def test_a_calibration_that_cannot_be_this_lens_is_not_used(self, tmp_path: Path) -> None:
        packet = DJI_ATTRIBUTES.replace(
            b"/>", b' drone-dji:CalibratedFocalLength="9000" drone-dji:CalibratedOpticalCenterX="1600"/>'
        )
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=packet))
        assert told.focal_px == read_metadata(save(tmp_path / "y.jpg", 1, exif=exif())).focal_px

    def test_the_makers_lens_and_the_receivers_sigmas_are_read(self, tmp_path: Path) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=_calibrated()))
        scale = WIDTH / 3200
        assert told.lens == Lens(
            f=pytest.approx(1973 * scale), aspect=pytest.approx(1955 / 1973), cx=pytest.approx(WIDTH / 2 - 19 * scale),
            cy=pytest.approx(HEIGHT / 2 - 11 * scale), k1=-0.4, k2=0.3, p1=0.004, p2=0.003, k3=-0.2,
        )
        assert told.gps_sigmas == (0.014, 0.0205)

    @pytest.mark.parametrize("change", [
        (b'DewarpFlag="0"', b'DewarpFlag="1"'),  # the drone has straightened the picture
        (b'CenterY="%d"' % (1600 * HEIGHT // WIDTH), b'CenterY="400"'),  # the picture is cropped
        (b"1973.0,", b"973.0,"), (b",-0.2", b",-0.2,7"), (b",0.3,", b",much,"), (b",0.3,", b",1e9,"),
    ])
    def test_a_lens_that_is_not_this_pictures_is_not_used(self, tmp_path: Path, change: tuple[bytes, bytes]) -> None:
        assert change[0] in _calibrated()
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=_calibrated().replace(*change)))
        assert told.lens is None and told.focal_px is not None

    def test_sigmas_without_a_fix_are_not_believed(self, tmp_path: Path) -> None:
        packet = _calibrated().replace(b'RtkFlag="50"', b'RtkFlag="34"')
        assert read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=packet)).gps_sigmas is None


def _calibrated() -> bytes:
    """The XMP of a drone whose maker has calibrated its lens at 3200 pixels across, with RTK."""
    return DJI_ATTRIBUTES.replace(
        b"/>", b' drone-dji:CalibratedOpticalCenterX="1600" drone-dji:CalibratedOpticalCenterY="%d"'
        b' drone-dji:DewarpData="2022-03-02;1973.0,1955.0,-19,-11,-0.4,0.3,0.004,0.003,-0.2" drone-dji:DewarpFlag="0"'
        b' drone-dji:RtkFlag="50" drone-dji:RtkStdLon="0.0105" drone-dji:RtkStdLat="0.014"'
        b' drone-dji:RtkStdHgt="0.0205"/>'
        % (1600 * HEIGHT // WIDTH)
    )
