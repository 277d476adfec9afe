# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The photo check on small photos made here: what it finds, what it leaves out and says."""

from __future__ import annotations

import os
import re
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from little_photos import HEIGHT, WIDTH, check, exif, save, scene, sound_folder
from PIL import Image, ImageFile

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import Cancelled, OutOfMemory, PhotoError
from curecon_blender.core.base.messages import Message, Progress, Reporter
from curecon_blender.core.base.options import Options
from curecon_blender.core.photos.check import check_photos, describe, ground_sampling_distance, write_thumbnails
from curecon_blender.core.photos.find import find_photos
from curecon_blender.core.run import pipeline
from curecon_blender.core.run.workspace import Workspace

SAMPLE = Path(__file__).parent.parent / "samples" / "tulou" / "photos"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return sound_folder(tmp_path)


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
        with pytest.raises(PhotoError, match=r"no usable photo.*DJI_1\.DNG is damaged.*DJI_3\.MP4 is a video"):
            check(tmp_path)
        for name in ("DJI_1.DNG", "DJI_2.dng"):
            (tmp_path / name).unlink()
        (tmp_path / "a.bmp").write_bytes(b"not read")
        with pytest.raises(PhotoError, match=r"1 \.BMP, 1 \.MP4") as caught:
            check(tmp_path)
        assert "Export them as JPEG." in caught.value.remedy and "Frames from Video" in caught.value.remedy

    @pytest.mark.parametrize("count", [1, 2])
    def test_one_or_two_photos(self, folder: Path, count: int) -> None:
        for number in range(count, 3):
            (folder / f"DJI_{number}.JPG").unlink()
        with pytest.raises(PhotoError, match=f"only {count} usable photo.*at least 3"):
            check(folder)

    def test_too_few_says_which_were_left_out_and_why(self, folder: Path) -> None:
        (folder / "DJI_1.JPG").write_text("this is no picture")
        with pytest.raises(PhotoError, match=r"only 2 usable photos.*DJI_1\.JPG is not a JPEG, PNG"):
            check(folder)

    def test_memory_that_all_photos_were_refused_is_not_blamed_on_them(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def refuse(_: object) -> None:
            raise OSError("out of memory error when reading image file")  # Pillow's word for it

        monkeypatch.setattr(ImageFile.ImageFile, "load", refuse)
        with pytest.raises(OutOfMemory):
            check_photos(folder, Reporter())


class TestBadPhotosAreLeftOut:
    @staticmethod
    def assert_left_out(folder: Path, bad: Path, reason: str) -> None:
        photo_set, warnings = check(folder)
        assert [photo.name for photo in photo_set.photos] == ["DJI_0.JPG", "DJI_1.JPG", "DJI_2.JPG"]
        (skip,) = photo_set.skipped
        assert skip.path == bad
        assert re.search(reason, skip.reason)
        assert any(skip.reason in warning for warning in warnings)

    @pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".heic"])
    def test_truncated(self, folder: Path, suffix: str) -> None:
        bad = save(folder / f"cut{suffix}", 7)
        bad.write_bytes(bad.read_bytes()[: bad.stat().st_size * 2 // 3])
        self.assert_left_out(folder, bad, rf"cut\{suffix} is (damaged or cut short|not a JPEG, PNG, TIFF or HEIC)")

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

    def test_a_memory_card_is_looked_into(self, tmp_path: Path) -> None:
        for number, name in enumerate(("100MEDIA/DJI_1.JPG", "100MEDIA/DJI_2.JPG", "101MEDIA/DJI_1.JPG")):
            (tmp_path / "DCIM" / name).parent.mkdir(parents=True, exist_ok=True)
            save(tmp_path / "DCIM" / name, number, exif=exif())
        (tmp_path / "MISC").mkdir()
        photo_set, warnings = check(tmp_path)
        names = [photo.name for photo in photo_set.photos]
        assert (names, warnings) == (["100MEDIA_DJI_1.JPG", "DJI_2.JPG", "101MEDIA_DJI_1.JPG"], [])

    @pytest.mark.parametrize("deeper", ["a/b", "2026/Tulou/flight 2"])
    def test_photos_that_lie_deeper_are_named(self, tmp_path: Path, deeper: str) -> None:
        (tmp_path / deeper).mkdir(parents=True)
        for number in range(2):
            save(tmp_path / deeper / f"DJI_{number}.JPG", number)
        with pytest.raises(PhotoError, match="2 photos lie deeper") as caught:
            check(tmp_path)
        assert str(tmp_path / deeper) in caught.value.remedy

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

    def test_photos_one_level_down_are_found_though_their_folder_is_the_workspace(self, tmp_path: Path) -> None:
        (tmp_path / "100MEDIA").mkdir()
        for number in range(3):
            save(tmp_path / "100MEDIA" / f"DJI_{number}.JPG", number, exif=exif())
        options = Options(photos=tmp_path, workspace=tmp_path, device="cpu", until="photos")
        told = pipeline.check(options, None, Reporter())
        for name in ("undistorted", "textured_1", "presentation"):  # what an earlier job and renders have left
            (tmp_path / name).mkdir()
            save(tmp_path / name / "ours.jpg", 50)
        done = pipeline.reconstruct(options, Reporter())
        assert told["photos"] == done["photos"] == 3
        assert pipeline.check(options, None, Reporter())["photos"] == 3

    def test_photos_that_come_and_go_while_the_folder_is_read(self, folder: Path) -> None:
        save(folder / "DJI_3.JPG", 3, exif=exif())
        found = find_photos(folder)
        save(folder / "DJI_4.JPG", 4, exif=exif())
        (folder / "DJI_0.JPG").unlink()
        reporter = Reporter()
        photo_set = check_photos(folder, reporter, found)
        assert [photo.name for photo in photo_set.photos] == ["DJI_1.JPG", "DJI_2.JPG", "DJI_3.JPG"]
        assert [skip.reason for skip in photo_set.skipped] == ["DJI_0.JPG does not exist."]
        assert reporter.warnings == ["Left out: DJI_0.JPG does not exist."]

    def test_a_photo_that_arrives_as_a_job_begins_waits_for_the_next_one(
        self, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reopen = Workspace.reopen

        def reopen_late(workspace: Workspace, stage: str) -> None:  # once the folder has been listed
            save(folder / "DJI_9.JPG", 9, exif=exif())
            reopen(workspace, stage)

        monkeypatch.setattr(Workspace, "reopen", reopen_late)
        options = Options(photos=folder, workspace=tmp_path / "w", device="cpu", until="photos")
        assert pipeline.reconstruct(options, Reporter())["photos"] == 3
        assert pipeline.reconstruct(options, Reporter())["photos"] == 4

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

    @pytest.mark.parametrize(("tags", "times"), [
        ({0xA405: 48, 0xA404: 2.0}, 2.0),  # the equivalent has the zoom in it
        ({0xA404: 2.0}, 2.0),  # and here it has not
        ({0xA404: 3.5, 0xA405: None, 0xA20E: 320 / 13.2, 0xA210: 4}, 3.5 * 8.8 / 13.2 / (24 / 34.61)),
        ({0xA405: 48}, 2.0), ({0xA434: "50 mm F1.8", 0xA405: 48}, 2.0), ({0xA434: "24 mm F2"}, 1.0),
        ({0x920A: 8.9, 0xA405: 24}, 1.0),  # a step of the focus
    ])
    def test_each_photo_has_its_own_lens_and_zoom(self, folder: Path, tags: dict[int, object], times: float) -> None:
        plain = check(folder)[0].photos[0]
        for number in (5, 6):
            save(folder / f"DJI_{number}.JPG", number, exif=exif(camera=tags))
        photo_set, _ = check(folder)
        zoomed = [photo for photo in photo_set.photos if photo.path.name in ("DJI_5.JPG", "DJI_6.JPG")]
        assert plain.focal_px is not None
        assert [photo.focal_px for photo in zoomed] == [pytest.approx(times * plain.focal_px, rel=1e-3)] * 2
        assert len({photo.camera for photo in zoomed}) == 1 and zoomed[0].camera != plain.camera
        assert describe(photo_set)["cameras"] == 2

    @pytest.mark.parametrize("ratio", [0.0, 1.0])
    def test_no_zoom_is_none(self, folder: Path, ratio: float) -> None:
        save(folder / "DJI_5.JPG", 5, exif=exif(camera={0xA404: ratio}))
        assert describe(check(folder)[0])["cameras"] == 1

    def test_altitudes_that_are_all_the_same_are_not_used(self, tmp_path: Path) -> None:
        for number in range(4):
            gps = {1: "N", 2: (24.0, 39.0, float(number)), 3: "E", 4: (117.0, 3.0, 7.0), 5: b"\x00", 6: 520.25}
            save(tmp_path / f"DJI_{number}.JPG", number, exif=exif(gps=gps))
        photo_set, warnings = check(tmp_path)
        assert all(photo.gps is not None and photo.gps.altitude is None for photo in photo_set.photos)
        assert any("same GPS altitude (520.2 m)" in warning for warning in warnings)

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
