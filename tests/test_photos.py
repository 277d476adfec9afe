# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check on small photos made here: what it accepts, what it leaves out and says, what it reads of them."""

from __future__ import annotations

import json
import math
import os
import re
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms
from PIL.PngImagePlugin import PngInfo

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import Cancelled, PhotoError
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.base.records import Gimbal, PhotoSet
from curecon_blender.core.photos.check import check_photos, describe, ground_sampling_distance, write_thumbnails
from curecon_blender.core.photos.metadata import read_metadata

WIDTH, HEIGHT = 320, 240
SAMPLE = Path(__file__).parent.parent / "samples" / "tulou" / "photos"

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


def scene(seed: int, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """(height, width, 3) uint8 with detail at all scales, as ground seen from above has it."""
    rng = np.random.default_rng(seed)
    grids = [rng.random((2 + height // step, 2 + width // step, 3)) for step in (64, 8, 1)]
    layers = [cv2.resize(grid, (width, height)) for grid in grids]
    return np.asarray(255 * np.mean(layers, axis=0), np.uint8)


def exif(
    *, main: dict[int, Any] | None = None, camera: dict[int, Any] | None = None, gps: dict[int, Any] | None = None
) -> Image.Exif:
    """EXIF of a drone's photo; the arguments override tags of its three directories, or take them away with None."""
    tags = Image.Exif()
    settings = {0x9003: "2026:01:26 13:50:17", 0x920A: 8.8, 0xA405: 24, **(camera or {})}
    for directory, values in (
        (tags, {0x010F: "DJI", 0x0110: "FC9999", **(main or {})}), (tags.get_ifd(0x8769), settings),
        (tags.get_ifd(0x8825), gps or {}),
    ):
        directory.update({tag: value for tag, value in values.items() if value is not None})
    return tags


def save(path: Path, seed: int, **options: Any) -> Path:
    Image.fromarray(scene(seed)).save(path, **options)
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three sound photos."""
    folder = tmp_path / "photos"
    folder.mkdir()
    for number in range(3):
        save(folder / f"DJI_{number}.JPG", number, exif=exif())
    return folder


def check(folder: Path) -> tuple[PhotoSet, list[str]]:
    reporter = Reporter()
    return check_photos(folder, reporter), reporter.warnings


class TestFoldersThatCannotBeUsed:
    def test_missing(self, tmp_path: Path) -> None:
        with pytest.raises(PhotoError, match="does not exist") as caught:
            check(tmp_path / "nowhere")
        assert "Choose the folder" in caught.value.remedy

    def test_a_single_file(self, folder: Path) -> None:
        with pytest.raises(PhotoError, match=r"DJI_0\.JPG is a single file"):
            check(folder / "DJI_0.JPG")

    def test_empty(self, tmp_path: Path) -> None:
        with pytest.raises(PhotoError, match="is empty"):
            check(tmp_path)

    def test_only_other_kinds(self, tmp_path: Path) -> None:
        for name in ("DJI_1.DNG", "DJI_2.dng", "DJI_3.MP4"):
            (tmp_path / name).write_bytes(b"not read")
        with pytest.raises(PhotoError, match=r"2 \.DNG, 1 \.MP4") as caught:
            check(tmp_path)
        assert "Export the raw photos" in caught.value.remedy
        assert "Save still frames" in caught.value.remedy

    @pytest.mark.parametrize("count", [1, 2])
    def test_one_or_two_photos(self, folder: Path, count: int) -> None:
        for number in range(count, 3):
            (folder / f"DJI_{number}.JPG").unlink()
        with pytest.raises(PhotoError, match=f"only {count} usable photo.*at least 3"):
            check(folder)

    def test_too_few_says_which_were_left_out_and_why(self, folder: Path) -> None:
        (folder / "DJI_1.JPG").write_text("this is no picture")
        with pytest.raises(PhotoError, match=r"only 2 usable photos.*DJI_1\.JPG is not a JPEG, PNG or TIFF picture"):
            check(folder)


class TestBadPhotosAreLeftOut:
    @staticmethod
    def assert_left_out(folder: Path, bad: Path, reason: str) -> None:
        photo_set, warnings = check(folder)
        assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG"]
        (skip,) = photo_set.skipped
        assert skip.path == bad
        assert re.search(reason, skip.reason)
        assert any(skip.reason in warning for warning in warnings)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
    def test_truncated(self, folder: Path, suffix: str) -> None:
        bad = save(folder / f"cut{suffix}", 7)
        bad.write_bytes(bad.read_bytes()[: bad.stat().st_size * 2 // 3])
        self.assert_left_out(folder, bad, rf"cut\{suffix} is (damaged or cut short|not a JPEG, PNG or TIFF)")

    def test_truncation_is_found_when_reading_scaled_down(self, tmp_path: Path) -> None:
        bad = tmp_path / "big.jpg"
        Image.fromarray(scene(1, 1600, 1200)).save(bad)
        bad.write_bytes(bad.read_bytes()[:-5000])
        with pytest.raises(PhotoError, match=r"big\.jpg is damaged or cut short"):
            images.read_rgb(bad, 200)

    @pytest.mark.parametrize("content", [b"", b"Dear diary", b"\xff\xd8\xff\xe1\x00\x10Exif\x00\x00"])
    def test_not_a_picture(self, folder: Path, content: bytes) -> None:
        bad = folder / "notes.jpg"
        bad.write_bytes(content)
        self.assert_left_out(folder, bad, r"notes\.jpg is")

    @pytest.mark.parametrize("size", [(1, 1), (199, 300)])
    def test_tiny(self, folder: Path, size: tuple[int, int]) -> None:
        bad = folder / "tiny.png"
        Image.fromarray(scene(5, *size)).save(bad)
        self.assert_left_out(folder, bad, f"only {size[0]}x{size[1]} pixels")

    def test_duplicates_even_with_other_metadata(self, folder: Path) -> None:
        (folder / "Z1.jpg").write_bytes((folder / "DJI_1.JPG").read_bytes())
        save(folder / "Z2.jpg", 2, exif=exif(main={0x010F: "Somebody else"}))
        photo_set, warnings = check(folder)
        assert len(photo_set.photos) == 3
        assert [(skip.path.name, skip.reason) for skip in photo_set.skipped] == [
            ("Z1.jpg", "Z1.jpg is the same picture as DJI_1.JPG."),
            ("Z2.jpg", "Z2.jpg is the same picture as DJI_2.JPG."),
        ]
        assert len(warnings) == 2

    @pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="this user may read every file")
    def test_no_permission(self, folder: Path) -> None:
        bad = save(folder / "locked.jpg", 9)
        bad.chmod(0)
        self.assert_left_out(folder, bad, "No permission")

    def test_more_pixels_than_any_camera_has(self, folder: Path) -> None:
        bad = save(folder / "vast.png", 9)
        data = bytearray(bad.read_bytes())
        data[16:24] = (60_000).to_bytes(4, "big") + (50_000).to_bytes(4, "big")
        data[29:33] = zlib.crc32(data[12:29]).to_bytes(4, "big")
        bad.write_bytes(data)
        self.assert_left_out(folder, bad, "3000 megapixels: at most 500")


class TestFindingPhotos:
    def test_suffixes_subfolders_and_natural_order(self, tmp_path: Path) -> None:
        (tmp_path / "101MEDIA").mkdir()
        for seed, name in enumerate(["DJI_10.JPG", "DJI_9.jpeg", "a.Tiff", "b.png", "101MEDIA/DJI_2.JPG"]):
            save(tmp_path / name, seed)
        (tmp_path / "flight.txt").write_text("a log")
        photo_set, warnings = check(tmp_path)
        names = [photo.name for photo in photo_set.photos]
        assert names == ["a.Tiff", "b.png", "DJI_9.jpeg", "DJI_10.JPG", "DJI_2.JPG"]
        assert (photo_set.skipped, warnings) == ((), [])

    def test_hidden_files_and_shadows_are_passed_over(self, folder: Path) -> None:
        (folder / "._DJI_0.JPG").write_bytes(b"\x00\x05\x16\x07macOS")
        (folder / ".thumbnails").mkdir()
        save(folder / ".thumbnails" / "DJI_0.jpg", 50)
        photo_set, _ = check(folder)
        assert len(photo_set.photos) == 3
        assert photo_set.skipped == ()

    def test_results_of_a_job_in_the_photos_folder_are_passed_over(self, folder: Path) -> None:
        (folder / "workspace.json").write_text("{}")
        (folder / "undistorted").mkdir()
        save(folder / "undistorted" / "DJI_0.JPG.jpg", 50)
        photo_set, _ = check(folder)
        assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG"]

    def test_progress_reaches_the_end(self, folder: Path) -> None:
        messages: list[Message] = []
        check_photos(folder, Reporter(messages.append))
        done = [(message.done, message.total) for message in messages if isinstance(message, Progress)]
        assert done == [(1, 3), (2, 3), (3, 3)]

    def test_cancel(self, folder: Path) -> None:
        with pytest.raises(Cancelled):
            check_photos(folder, Reporter(cancelled=lambda: True))


class TestNames:
    @pytest.mark.skipif(os.name == "nt", reason="Windows allows no such file names")
    def test_any_name_works_and_becomes_safe(self, tmp_path: Path) -> None:
        pycolmap = pytest.importorskip("pycolmap")
        originals = ["with space.jpg", "quo\"te's.jpg", "土楼.JPG", "u\u0308ber.png", "line\nbreak.jpg"]
        originals.append("a\\b:c\td.jpg")
        for seed, name in enumerate(originals):
            save(tmp_path / name, seed)
        photo_set, _ = check(tmp_path)
        names = [photo.name for photo in photo_set.photos]
        assert sorted(photo.path.name for photo in photo_set.photos) == sorted(originals)
        assert set(names) == {"with_space.jpg", "quo_te_s.jpg", "土楼.JPG", "über.png", "line_break.jpg", "a_b_c_d.jpg"}
        for photo in photo_set.photos:
            assert images.read_rgb(photo.path).shape == (HEIGHT, WIDTH, 3)

        model = pycolmap.Reconstruction()
        model.add_camera_with_trivial_rig(
            pycolmap.Camera(camera_id=1, model="SIMPLE_PINHOLE", width=WIDTH, height=HEIGHT, params=[300, 160, 120])
        )
        for number, name in enumerate(names, start=1):
            image = pycolmap.Image(name=name, camera_id=1, image_id=number)
            model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for kind, write in (("binary", model.write_binary), ("text", model.write_text)):
            (tmp_path / kind).mkdir()
            write(tmp_path / kind)
            assert {image.name for image in pycolmap.Reconstruction(tmp_path / kind).images.values()} == set(names)

    def test_same_names_in_two_folders(self, folder: Path) -> None:
        (folder / "101MEDIA").mkdir()
        save(folder / "101MEDIA" / "dji_0.jpg", 10)
        save(folder / "101MEDIA" / "DJI_7.JPG", 11)
        photo_set, _ = check(folder)
        names = [photo.name for photo in photo_set.photos]
        assert names == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG", "101MEDIA_dji_0.jpg", "DJI_7.JPG"]

    def test_names_that_become_the_same(self, folder: Path) -> None:
        save(folder / "a b.jpg", 10)
        save(folder / "a;b.jpg", 11)
        save(folder / f"{'long' * 40}1.jpg", 12)
        save(folder / f"{'long' * 40}2.jpg", 13)
        photo_set, _ = check(folder)
        names = [photo.name for photo in photo_set.photos]
        assert len({name.casefold() for name in names}) == 7
        assert all(len(name) < 60 and name.lower().endswith(".jpg") for name in names)


class TestReadingPixels:
    """Every kind is read as the same scene, within what its compression loses."""

    @staticmethod
    def assert_same(path: Path, expected: np.ndarray, tolerance: float) -> None:
        rgb = images.read_rgb(path)
        assert rgb.dtype == np.uint8
        assert rgb.shape == expected.shape
        assert np.abs(rgb.astype(int) - expected).mean() <= tolerance

    @pytest.mark.parametrize(
        ("suffix", "mode", "tolerance"),
        [(".jpg", "RGB", 4), (".png", "RGB", 0), (".tif", "RGB", 0), (".png", "RGBA", 0), (".tif", "RGBA", 0),
         (".jpg", "CMYK", 4), (".tif", "CMYK", 1), (".png", "P", 8)],
    )
    def test_colour(self, tmp_path: Path, suffix: str, mode: str, tolerance: float) -> None:
        # Smooth colour, so that JPEG's halved chroma does not hide swapped or inverted channels.
        expected = cv2.GaussianBlur(scene(1), (0, 0), 4)
        picture = Image.fromarray(expected).convert(mode, palette=Image.Palette.ADAPTIVE)
        if mode == "RGBA":
            picture.putalpha(100)
        picture.save(tmp_path / f"x{suffix}")
        self.assert_same(tmp_path / f"x{suffix}", expected, tolerance)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
    def test_grey(self, tmp_path: Path, suffix: str) -> None:
        grey = cv2.GaussianBlur(scene(1)[..., 0], (0, 0), 2)
        Image.fromarray(grey).save(tmp_path / f"x{suffix}")
        self.assert_same(tmp_path / f"x{suffix}", np.dstack([grey] * 3), 2)

    @pytest.mark.parametrize("suffix", [".png", ".tif"])
    @pytest.mark.parametrize("channels", [1, 3, 4])
    def test_16_bit(self, tmp_path: Path, suffix: str, channels: int) -> None:
        expected = scene(1)
        deep = expected[..., ::-1].astype(np.uint16) * 257  # OpenCV writes BGR
        if channels == 1:
            deep, expected = deep[..., 2], np.dstack([expected[..., 0]] * 3)
        if channels == 4:
            deep = np.dstack([deep, np.full((HEIGHT, WIDTH), 30_000, np.uint16)])
        cv2.imwrite(str(tmp_path / f"x{suffix}"), deep)
        self.assert_same(tmp_path / f"x{suffix}", expected, 0.5)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif"])
    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_orientation(self, tmp_path: Path, suffix: str, orientation: int) -> None:
        upright = cv2.GaussianBlur(scene(1), (0, 0), 4)
        stored = {  # EXIF: where the 0th row and column of what is stored lie in the upright picture
            1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1], 5: upright.transpose(1, 0, 2),
            6: upright.transpose(1, 0, 2)[::-1], 7: upright.transpose(1, 0, 2)[::-1, ::-1],
            8: upright.transpose(1, 0, 2)[:, ::-1],
        }[orientation]
        path = tmp_path / f"x{suffix}"
        Image.fromarray(np.ascontiguousarray(stored)).save(path, exif=exif(main={0x0112: orientation}))
        self.assert_same(path, upright, 4)
        with images.open_image(path) as image:
            assert images.oriented_size(image) == (WIDTH, HEIGHT)

    def test_float_tiff_is_refused(self, tmp_path: Path) -> None:
        Image.fromarray(scene(1)[..., 0].astype(np.float32)).save(tmp_path / "heights.tif")
        with pytest.raises(PhotoError, match=r"heights\.tif.*floating point"):
            images.read_rgb(tmp_path / "heights.tif")

    def test_colour_profile_is_followed(self, tmp_path: Path) -> None:
        # sRGB's own profile with red and green exchanged, under another name.
        profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
        profile = profile.replace(b"rXYZ", b"____", 1).replace(b"gXYZ", b"rXYZ", 1).replace(b"____", b"gXYZ", 1)
        profile = profile.replace("sRGB".encode("utf-16-be"), "test".encode("utf-16-be"))
        path = save(tmp_path / "x.png", 1, icc_profile=profile)
        self.assert_same(path, scene(1)[..., [1, 0, 2]], 1)

    def test_damaged_colour_profile_is_ignored(self, tmp_path: Path) -> None:
        path = save(tmp_path / "x.png", 1, icc_profile=b"no profile")
        self.assert_same(path, scene(1), 0)

    @pytest.mark.parametrize(("width", "height", "max_size"), [(1600, 1200, 400), (1600, 1200, 390), (1501, 1003, 333)])
    def test_scaling_down_averages_areas(self, tmp_path: Path, width: int, height: int, max_size: int) -> None:
        path = tmp_path / "x.jpg"
        picture = scene(1, width, height)
        Image.fromarray(picture).save(path, quality=98, subsampling=0)
        rgb = images.read_rgb(path, max_size)
        size = images.scaled_size(width, height, max_size)
        expected = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        assert rgb.shape == (size[1], size[0], 3)
        assert max(rgb.shape) == max_size
        assert np.abs(rgb.astype(int) - expected).mean() < 1.5

    def test_never_scaled_up(self, tmp_path: Path) -> None:
        assert images.read_rgb(save(tmp_path / "x.png", 1), 5000).shape == (HEIGHT, WIDTH, 3)

    def test_written_jpeg_reads_back(self, tmp_path: Path) -> None:
        expected = cv2.GaussianBlur(scene(1), (0, 0), 4)
        images.write_jpeg(tmp_path / "new" / "土楼.jpg", expected)
        self.assert_same(tmp_path / "new" / "土楼.jpg", expected, 2)
        assert [path.name for path in (tmp_path / "new").iterdir()] == ["土楼.jpg"]


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
        assert photo.camera == "DJI FC9999 8.8 mm 320x240"
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
        "packet", [b"<x:xmpmeta", DJI_ATTRIBUTES.replace(b"/>", b">"), b"\xff\xfe\x00", b"",
                   b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'],
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
                   {1: "X"}, {6: 90_000.0}, {9: "V"}, {2: (33.0, 51.0)}],
        ids=["no fix", "latitude", "longitude", "reference", "altitude", "void", "two parts"],
    )
    def test_gps_nonsense_is_rejected(self, tmp_path: Path, change: dict[int, Any]) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(gps={**SOUTH_WEST, **change})))
        assert told.gps is None
        assert told.focal_px is not None

    def test_below_sea_level(self, tmp_path: Path) -> None:
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(gps={**SOUTH_WEST, 5: b"\x01", 6: 12.5})))
        assert told.gps is not None
        assert told.gps.altitude == -12.5

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

    def test_a_calibration_that_cannot_be_this_lens_is_not_used(self, tmp_path: Path) -> None:
        packet = DJI_ATTRIBUTES.replace(
            b"/>", b' drone-dji:CalibratedFocalLength="9000" drone-dji:CalibratedOpticalCenterX="1600"/>'
        )
        told = read_metadata(save(tmp_path / "x.jpg", 1, exif=exif(), xmp=packet))
        assert told.focal_px == read_metadata(save(tmp_path / "y.jpg", 1, exif=exif())).focal_px


class TestCamerasAndBlur:
    def test_mixed_cameras(self, folder: Path) -> None:
        save(folder / "phone.jpg", 10, exif=exif(main={0x010F: "Apple", 0x0110: "iPhone 15"}))
        save(folder / "zoomed.jpg", 11, exif=exif(camera={0x920A: 20.0, 0xA405: 55}))
        save(folder / "second drone.jpg", 12, exif=exif(camera={0xA431: "SN2"}))
        save(folder / "portrait.jpg", 13, exif=exif(main={0x0112: 6}))
        save(folder / "stripped.png", 14)
        photo_set, _ = check(folder)
        cameras = {photo.name: photo.camera for photo in photo_set.photos}
        assert cameras["DJI_0.JPG"] == cameras["DJI_1.JPG"] == cameras["DJI_2.JPG"]
        assert len(set(cameras.values())) == 6
        assert describe(photo_set)["cameras"] == 6
        portrait = next(photo for photo in photo_set.photos if photo.name == "portrait.jpg")
        assert (portrait.width, portrait.height) == (HEIGHT, WIDTH)

    def test_blurred_photos_are_named_and_used(self, tmp_path: Path) -> None:
        for number in range(8):
            picture = scene(number, 800, 600)
            if number == 5:
                picture = cv2.blur(picture, (5, 1))  # motion along the rows
            Image.fromarray(picture).save(tmp_path / f"DJI_{number}.JPG", quality=95)
        photo_set, warnings = check(tmp_path)
        assert [photo.name for photo in photo_set.photos if photo.blurred] == ["DJI_5.JPG"]
        assert len(photo_set.photos) == 8
        assert describe(photo_set)["doubtful"] == [
            {"name": "DJI_5.JPG", "path": str(tmp_path / "DJI_5.JPG"), "problems": ["blurred"]}
        ]
        (warning,) = warnings
        assert "DJI_5.JPG" in warning

    def test_little_detail_is_not_blur(self, tmp_path: Path) -> None:
        for number in range(6):
            picture = scene(number, 800, 600).astype(float)
            if number == 2:
                picture = 128 + (picture - 128) / 3  # a third of the contrast
            Image.fromarray(picture.astype(np.uint8)).save(tmp_path / f"{number}.png")
        photo_set, _ = check(tmp_path)
        assert not any(photo.blurred for photo in photo_set.photos)

    def test_badly_exposed_photos_are_named_and_used(self, tmp_path: Path) -> None:
        for number in range(6):
            picture = scene(number, 800, 600).astype(float)
            if number == 2:
                picture = 4 * picture
            elif number == 4:
                picture = (picture - 110) / 4
            Image.fromarray(picture.clip(0, 255).astype(np.uint8)).save(tmp_path / f"{number}.png")
        photo_set, warnings = check(tmp_path)
        assert [photo.name for photo in photo_set.photos if photo.overexposed] == ["2.png"]
        assert [photo.name for photo in photo_set.photos if photo.underexposed] == ["4.png"]
        assert len(photo_set.photos) == 6
        assert any("overexposed" in warning and "2.png" in warning for warning in warnings)

    def test_thumbnails_are_of_the_doubtful_photos_only(self, tmp_path: Path) -> None:
        photos, thumbnails = tmp_path / "photos", tmp_path / "thumbnails"
        photos.mkdir()
        for number in range(6):
            picture = scene(number, 800, 600)
            Image.fromarray(cv2.blur(picture, (6, 1)) if number == 3 else picture).save(photos / f"{number}.png")
        files = write_thumbnails(check(photos)[0], thumbnails)
        assert files == {"3.png": thumbnails / "3.png.jpg"}
        assert list(thumbnails.iterdir()) == [files["3.png"]]
        assert images.read_rgb(files["3.png"]).shape == (192, 256, 3)

    def test_the_sample_photos_are_sound(self) -> None:
        photo_set, warnings = check(SAMPLE)
        summary = describe(photo_set)
        assert (summary["photos"], summary["with_gps"], summary["doubtful"], warnings) == (33, 33, [], [])
        assert summary["taken"] == ["2024-09-28T10:48:05+08:00", "2024-09-28T10:51:29+08:00"]
        assert summary["overlap"]["forward"] == pytest.approx(0.81, abs=0.05)
        assert summary["overlap"]["weak"] == []

    def test_ground_sampling_distance_unknown_without_height(self, folder: Path) -> None:
        assert ground_sampling_distance(check(folder)[0]) is None
