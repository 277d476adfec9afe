# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cameras of DTU (as MVSNet has it) or BlendedMVS as a COLMAP model, to reconstruct with.

    python -m evaluation.mvsnet_cameras CAMS PHOTOS MODEL

CAMS holds NAME_cam.txt for photo NAME.jpg or .png in PHOTOS: `extrinsic` with cam_from_world (4,4), `intrinsic` with
K (3,3) for the photo's size. Photos without such a file are left out. MODEL gets cameras.txt, images.txt and an empty
points3D.txt: `python -m curecon_blender.core reconstruct PHOTOS --model MODEL ...` triangulates its own points.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from curecon_blender.core.base.errors import CuReconError, WorkspaceError
from curecon_blender.core.base.images import SUFFIXES


def read_camera(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """K (3,3) in pixels and cam_from_world (3,4) from a cam.txt. Raises WorkspaceError when it is not one."""
    try:
        words = path.read_text().split()
        extrinsic, intrinsic = words.index("extrinsic") + 1, words.index("intrinsic") + 1
        pose = np.array(words[extrinsic : extrinsic + 16], dtype=float).reshape(4, 4)
        return np.array(words[intrinsic : intrinsic + 9], dtype=float).reshape(3, 3), pose[:3]
    except (OSError, ValueError) as error:
        raise WorkspaceError(f"{path} is not a camera file of MVSNet's kind.", path=path,
                             remedy="It needs `extrinsic` with 16 numbers and `intrinsic` with 9.") from error


def convert(cams: Path, photos: Path, model: Path) -> int:
    """Write the COLMAP text model; returns its number of photos. Raises WorkspaceError when there is none."""
    pictures = [path for path in sorted(photos.iterdir()) if path.suffix.lower() in SUFFIXES] if photos.is_dir() else []
    pictures = [path for path in pictures if (cams / f"{path.stem}_cam.txt").exists()]
    if not pictures:
        raise WorkspaceError(f"No photo in {photos} has its NAME_cam.txt in {cams}.", path=cams,
                             remedy="Give the folder of camera files, then that of the photos.")
    model.mkdir(parents=True, exist_ok=True)
    cameras, images = [], []
    for number, path in enumerate(pictures, 1):
        K, pose = read_camera(cams / f"{path.stem}_cam.txt")
        with Image.open(path) as picture:
            width, height = picture.size
        cameras.append(f"{number} PINHOLE {width} {height} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}\n")
        x, y, z, w = Rotation.from_matrix(pose[:, :3]).as_quat()
        values = " ".join(f"{value:.12g}" for value in (w, x, y, z, *pose[:, 3]))
        images.append(f"{number} {values} {number} {path.name}\n\n")
    (model / "cameras.txt").write_text("".join(cameras))
    (model / "images.txt").write_text("".join(images))
    (model / "points3D.txt").write_text("")
    return len(pictures)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m evaluation.mvsnet_cameras", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cams", type=Path)
    parser.add_argument("photos", type=Path)
    parser.add_argument("model", type=Path)
    args = parser.parse_args(arguments)
    try:
        count = convert(args.cams, args.photos, args.model)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    print(f"{args.model}: {count} cameras")
    return 0


if __name__ == "__main__":
    sys.exit(main())
