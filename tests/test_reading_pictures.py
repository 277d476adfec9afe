# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading and writing pictures: every kind, depth and orientation comes out as the same upright 8-bit sRGB."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pillow_heif
import pytest
from little_photos import HEIGHT, WIDTH, exif, save, scene
from PIL import Image, ImageCms

from curecon_blender.core.base import images
from curecon_blender.core.base.errors import PhotoError


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

    @pytest.mark.parametrize("turn", [1, 3, 6, 8])
    def test_heic_of_8_and_10_bits_in_any_orientation(self, tmp_path: Path, turn: int) -> None:
        expected = cv2.GaussianBlur(scene(1), (0, 0), 4)
        tags = Image.Exif()
        tags[0x0112] = turn
        Image.fromarray(expected).save(tmp_path / "x.heic", exif=tags.tobytes(), quality=90)
        upright = np.rot90(expected, {1: 0, 3: 2, 6: 3, 8: 1}[turn])
        self.assert_same(tmp_path / "x.heic", upright, 4)
        deep = pillow_heif.encode  # the plugin's own writer, for what Pillow's pictures cannot hold
        deep("RGB;16", expected.shape[1::-1], (expected.astype(np.uint16) * 257).tobytes(), tmp_path / "deep.heic",
             quality=90, bit_depth=10)
        self.assert_same(tmp_path / "deep.heic", expected, 4)

    def test_the_first_picture_of_a_heic_sequence_is_the_photo(self, tmp_path: Path) -> None:
        first, second = (cv2.GaussianBlur(scene(seed), (0, 0), 4) for seed in (1, 2))
        Image.fromarray(first).save(tmp_path / "x.heic", quality=90, save_all=True,
                                    append_images=[Image.fromarray(second)])
        self.assert_same(tmp_path / "x.heic", first, 4)

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
