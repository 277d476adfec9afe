# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures that are no photos of the job are left out and told of; photos never are."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from little_photos import check, exif, save, scene, sound_folder
from PIL import Image
from test_xmp import PIX4D, packet

from curecon_blender.core.base.messages import Reporter
from curecon_blender.core.photos.check import check_photos, describe

DJI = "http://www.dji.com/drone-dji/1.0/"
GPANO = "http://ns.google.com/photos/1.0/panorama/"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return sound_folder(tmp_path)


def write(path: Path, picture: np.ndarray, **options: object) -> None:
    Image.fromarray(picture).save(path, **options)


def left_out(folder: Path) -> dict[str, str]:
    """The kinds of the pictures left out by name; each kind is warned of once, and all stay if the user asks."""
    photo_set, warnings = check(folder)
    kinds = {skip.path.name: skip.kind for skip in photo_set.skipped}
    warnings = [warning for warning in warnings if "blurred" not in warning]
    assert len(warnings) == len(set(kinds.values()))
    assert all("if you ask for them" in warning for warning in warnings)
    for skip in photo_set.skipped:
        assert skip.path.name in skip.reason and any(skip.path.name in warning for warning in warnings)
    assert all(skip["surplus"] for skip in describe(photo_set)["skipped"])
    everything = check_photos(folder, Reporter(), surplus=True)
    assert (len(everything.photos), everything.skipped) == (len(photo_set.photos) + len(kinds), ())
    return kinds


class TestThermalAndBands:
    @staticmethod
    def add_thermal(folder: Path, xmp: bytes) -> list[str]:
        names = [f"DJI_{number}_T.JPG" for number in range(3)]
        for number, name in enumerate(names):
            tags = exif(main={0x0110: "M3T"}, camera={0xA405: 40})
            save(folder / name, 20 + number, exif=tags, xmp=xmp)
        return names

    @pytest.mark.parametrize("xmp", [
        packet("drone-dji", DJI, 'drone-dji:ImageSource="InfraredCamera"/>'), packet("Camera", PIX4D, (
            "><Camera:BandName><rdf:Seq><rdf:li>LWIR</rdf:li></rdf:Seq></Camera:BandName></rdf:Description>")), b"",
    ], ids=["DJI", "FLIR", "by its name and camera"])
    def test_thermal_pictures_beside_photos(self, folder: Path, xmp: bytes) -> None:
        names = self.add_thermal(folder, xmp)
        assert left_out(folder) == dict.fromkeys(names, "thermal picture")

    def test_a_job_of_thermal_pictures_alone(self, folder: Path) -> None:
        self.add_thermal(folder, packet("drone-dji", DJI, 'drone-dji:ImageSource="InfraredCamera"/>'))
        for number in range(3):
            (folder / f"DJI_{number}.JPG").unlink()
        assert left_out(folder) == {}

    def test_a_photo_is_not_thermal_for_its_name(self, folder: Path) -> None:
        save(folder / "DJI_1_T.JPG", 20, exif=exif())  # the same camera
        save(folder / "DJI_7_T.JPG", 21, exif=exif(main={0x0110: "M3T"}))  # no photo of that number
        assert left_out(folder) == {}

    @pytest.mark.parametrize("band", ["NIR", "Red"])
    def test_single_bands_beside_photos(self, folder: Path, band: str) -> None:
        save(folder / "DJI_11.TIF", 30, tiffinfo={700: packet("Camera", PIX4D, f'Camera:BandName="{band}"/>')})
        colour = packet("Camera", PIX4D, 'Camera:BandName="Red, Green, Blue"/>')
        save(folder / "DJI_12.JPG", 31, exif=exif(), xmp=colour)
        assert left_out(folder) == {"DJI_11.TIF": "single band"}

    def test_a_job_of_bands_alone(self, folder: Path) -> None:
        for number in range(3):
            save(folder / f"DJI_{number}.JPG", number, xmp=packet("Camera", PIX4D, 'Camera:BandName="NIR"/>'))
        assert left_out(folder) == {}


class TestOtherPictures:
    def test_panoramas(self, folder: Path) -> None:
        write(folder / "a.jpg", scene(40, 600, 300), xmp=packet("GPano", GPANO, 'GPano:ProjectionType="cylindrical"/>'))
        write(folder / "b.jpg", scene(41, 1200, 300), exif=exif())
        write(folder / "c.jpg", scene(42, 800, 400), exif=exif(camera={0xA405: None}))
        assert left_out(folder) == dict.fromkeys(["a.jpg", "b.jpg", "c.jpg"], "panorama")

    def test_wide_photos_are_none(self, folder: Path) -> None:
        write(folder / "phone.jpg", scene(40, 888, 400), exif=exif(main={0x0110: "phone"}))
        write(folder / "two to one.jpg", scene(41, 640, 320), exif=exif())
        write(folder / "upright.jpg", scene(42, 300, 640), exif=exif())
        assert left_out(folder) == {}

    def test_screenshots_and_drawings(self, folder: Path) -> None:
        write(folder / "IMG_7.PNG", scene(43, 240, 500), exif=exif(
            main={0x010F: None, 0x0110: None, 0x0131: "26"},
            camera={0x9286: b"ASCII\0\0\0Screenshot", 0x920A: None, 0xA405: None}))
        save(folder / "Screenshot_2026.png", 44)
        write(folder / "16_1234_777.png", scene(45, 256, 256))
        write(folder / "plan.tif", scene(46, 320, 240), tiffinfo={33550: (0.1, 0.1, 0.0), 33922: (0.0,) * 6})
        assert left_out(folder) == {
            "IMG_7.PNG": "screenshot", "Screenshot_2026.png": "screenshot",
            "16_1234_777.png": "picture without a camera", "plan.tif": "map",
        }

    def test_photos_without_metadata_stay(self, folder: Path) -> None:
        save(folder / "by a messenger.jpg", 44)  # of the photos' shape
        write(folder / "turned.jpg", scene(45, 240, 320))
        write(folder / "with a place.jpg", scene(46, 300, 300), exif=exif(
            main={0x010F: None, 0x0110: None}, camera={0x920A: None, 0xA405: None}))  # and a time
        assert left_out(folder) == {}

    def test_frames_of_a_video_stay_and_a_map_s_tiles_go(self, tmp_path: Path) -> None:
        for number in range(12):
            save(tmp_path / f"DJI_{number}.JPG", number, exif=exif())
        for number in range(3):
            write(tmp_path / f"frame_{number}.png", scene(50 + number, 800, 450))
        assert left_out(tmp_path) == {}
        tiles = [f"{number}.png" for number in range(3)]
        for number, name in enumerate(tiles):
            write(tmp_path / name, scene(60 + number, 256, 256))
        assert left_out(tmp_path) == dict.fromkeys(tiles, "picture without a camera")

    def test_a_folder_without_any_metadata_stays_whole(self, tmp_path: Path) -> None:
        for number, size in enumerate([(320, 240), (256, 256), (400, 240), (500, 400)]):
            write(tmp_path / f"{number}.png", scene(number, *size))
        assert left_out(tmp_path) == {}


class TestCopies:
    def test_edited_cropped_and_small_ones(self, folder: Path) -> None:
        times = ["2026:01:26 13:50:17", "2026:01:26 13:50:20", "2026:01:26 13:50:23"]
        pictures = [scene(number) for number in range(3)]
        tags = [exif(camera={0x9003: time, 0x829A: 0.002}) for time in times]
        for number in range(3):
            write(folder / f"DJI_{number}.JPG", pictures[number], exif=tags[number])
        brighter = np.clip(1.3 * pictures[0].astype(float) + 10, 0, 255).astype(np.uint8)
        write(folder / "DJI_0_lr.JPG", brighter, exif=exif(main={0x0131: "a photo editor"}, camera={
            0x9003: times[0], 0x829A: 0.002}))
        write(folder / "DJI_0-edited.JPG", brighter // 2 + 40)  # nothing but its name and its content
        write(folder / "DJI_1 crop.png", cv2.resize(pictures[1][40:220, 20:260], (480, 360)))
        write(folder / "DJI_2 (2).JPG", pictures[2][:200, :300], exif=tags[2])
        write(folder / "9f3c.jpg", cv2.resize(scene(60, 900, 675), (300, 225), interpolation=cv2.INTER_AREA))
        for seed in (60, 61, 62, 63, 64, 65, 66, 67):
            write(folder / f"IMG_{seed}.JPG", scene(seed, 900, 675), exif=exif(), quality=95)
        write(folder / "IMG_E61.JPG", np.clip(0.8 * scene(61, 900, 675).astype(float), 0, 255).astype(np.uint8))
        assert left_out(folder) == dict.fromkeys(
            ["DJI_0_lr.JPG", "DJI_0-edited.JPG", "DJI_1 crop.png", "DJI_2 (2).JPG", "9f3c.jpg", "IMG_E61.JPG"], "copy")

    def test_photos_of_one_second_and_names_alike_stay(self, folder: Path) -> None:
        view = scene(70, 400, 300)
        for number, shift in enumerate((0, 3, 6)):  # a burst, and exposures in a row
            write(folder / f"IMG_{number + 1}.JPG", view[:240, shift : 320 + shift], exif=exif(camera={0x829A: 0.002}))
            write(folder / f"AEB_{number}.JPG", view[10:250, :320] // (number + 1), exif=exif(
                camera={0x829A: 0.002 / (number + 1)}))
        save(folder / "DJI_1 (1).JPG", 71, exif=exif())  # from a second card
        save(folder / "DJI_10.JPG", 72, exif=exif())
        save(folder / "DJI_2_web cam.JPG", 73, exif=exif())
        write(folder / "low.JPG", scene(74, 210, 200), exif=exif(main={0x0110: "a small camera"}))
        assert left_out(folder) == {}


class TestFilesBesideThePhotos:
    def test_what_cannot_be_read_is_counted_and_told(self, folder: Path) -> None:
        for number in range(12):
            (folder / f"IMG_{number}.CR2").write_bytes(b"not read")
        for name in ("IMG.JXL", "DJI_0.DNG", "flight.MP4", "flight.SRT", "notes.txt", "DJI_1.nef"):
            (folder / name).write_bytes(b"not read")
        photo_set, warnings = check(folder)
        assert len(photo_set.photos) == 3
        kinds = [skip["kind"] for skip in describe(photo_set)["skipped"]]
        # DJI_0 and DJI_1 lie there as JPEG, too.
        assert (kinds.count("raw"), kinds.count("other picture"), kinds.count("video"), len(kinds)) == (12, 1, 1, 14)
        assert len(warnings) == 3
        assert any("12 raw files that cannot be developed here" in warning and "as JPEG" in warning
                   for warning in warnings)

    def test_a_photo_that_lies_there_as_heic_and_as_jpeg_is_one(self, folder: Path) -> None:
        save(folder / "DJI_1.heic", 1, exif=exif())
        save(folder / "DJI_7.HEIC", 7, exif=exif())
        photo_set, _ = check(folder)
        assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG", "DJI_7.HEIC"]
        assert describe(photo_set)["skipped"] == []
        assert photo_set.photos[-1].camera == photo_set.photos[0].camera

    @pytest.mark.parametrize("behind", [b"\xff\xda" * 5000, b"\0\0\0\x1cftypmp42" + bytes(range(256)) * 200])
    def test_a_video_behind_a_photo_s_end(self, folder: Path, behind: bytes) -> None:
        path = save(folder / "MVIMG_1.jpg", 80, exif=exif())
        path.write_bytes(path.read_bytes() + behind)
        assert left_out(folder) == {}
        assert len(check(folder)[0].photos) == 4
