# SPDX-License-Identifier: GPL-3.0-or-later
"""A video of the sample site as a small drone would film it: `python samples/site_video.py DEPTHS OUT [--seconds 60]`.

DEPTHS holds the photos' exact depth maps (`make_site.py depth`). One turn around the building, rising, written with
DJI's subtitles as OUT/DJI_0900.MP4 and .SRT. OUT/truth is what evaluation.site wants: where each frame was truly taken,
by the names that `frames` gives them, and the site's true cloud.

No frame is rendered: each pixel's true depth is found by drawing the photos' depth maps into the frame, its colour by
asking the photos that see that place from the nearest directions. Rows are exposed one after another (rolling shutter),
each for a while (motion blur). Needs PyAV beside numpy, numba, opencv and pillow.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import av
import cv2
import numpy as np
from numba import njit
from PIL import Image
from site_flight import ALTITUDE, TAKE_OFF, flight, geodetic, pose
from site_truth import write_model

WIDTH, HEIGHT, FOCAL = 1280, 720, 960.0
RATE, READOUT, EXPOSURE = 4, 0.030, 1 / 60  # frames a second; seconds from the first row to the last, and of each row
NEAREST, COLOURING = 6, 4  # photos that a frame's depth is made of, and its colours
PHOTOS = Path(__file__).resolve().parent / "tulou" / "photos"
SKY = (190, 200, 214)


def at(share: float) -> np.ndarray:
    """cam_from_world (4,4) at a share of the way: a turn and a bit, rising, with a pilot's swaying."""
    angle = 2 * np.pi * 1.08 * share + 0.4
    radius, height = 47 - 9 * share + 0.8 * np.sin(9 * angle), 20 + 24 * share + 0.5 * np.sin(7 * angle + 1)
    eye = np.array([radius * np.sin(angle), radius * np.cos(angle), height])
    look = np.array([1.5 * np.sin(3 * angle), 1.2 * np.cos(4 * angle), 3.5]) - eye
    yaw, pitch = np.arctan2(look[0], look[1]), np.arctan2(look[2], np.hypot(*look[:2]))
    return pose(eye, float(np.degrees(yaw)), float(np.degrees(pitch)), 0.4 * np.sin(11 * angle))


@njit(nogil=True)
def _splat(depth, focal, width, height, to_first, to_last, frame_focal, out):  # type: ignore[no-untyped-def]
    """Draw a photo's depth map into a frame's (H,W), whose first and last rows have different poses (3,4)."""
    rows, columns = out.shape
    for v in range(0, depth.shape[0]):
        for u in range(0, depth.shape[1]):
            z = depth[v, u]
            if z <= 0:
                continue
            right, down = (u + 0.5 - width / 2) / focal * z, (v + 0.5 - height / 2) / focal * z
            share = 0.5
            for _ in range(2):
                a = np.empty(3)
                for i in range(3):
                    m = to_first[i] * (1 - share) + to_last[i] * share
                    a[i] = m[0] * right + m[1] * down + m[2] * z + m[3]
                if a[2] < 1:
                    break
                row = a[1] / a[2] * frame_focal + rows / 2
                share = min(max(row / rows, 0.0), 1.0)
            if a[2] < 1:
                continue
            c, r = int(np.floor(a[0] / a[2] * frame_focal + columns / 2)), int(np.floor(row))
            for dr in range(0, 2):
                for dc in range(0, 2):
                    y, x = r + dr, c + dc
                    if 0 <= y < rows and 0 <= x < columns and (out[y, x] == 0 or a[2] < out[y, x]):
                        out[y, x] = a[2]


@njit(nogil=True)
def _lift(depth, first, last, focal, out):  # type: ignore[no-untyped-def]
    """World places (H,W,3) of a frame's pixels; world_from_cam (3,4) of its first and last rows."""
    rows, columns = depth.shape
    for r in range(rows):
        share = r / rows
        m = first * (1 - share) + last * share
        for c in range(columns):
            z = depth[r, c]
            x, y = (c + 0.5 - columns / 2) / focal * z, (r + 0.5 - rows / 2) / focal * z
            for i in range(3):
                out[r, c, i] = m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + m[i, 3]


class Site:
    """The photos with their depth maps."""

    def __init__(self, depths: Path) -> None:
        self.shots = flight()
        self.poses = [shot.cam_from_world for shot in self.shots]
        self.depths = [np.load(depths / f"{Path(shot.name).stem}.npz")["depth"] for shot in self.shots]
        self.pictures = [np.asarray(Image.open(PHOTOS / shot.name)) for shot in self.shots]
        self.height, self.width = self.depths[0].shape
        self.focal = float((PHOTOS.parent / "truth" / "cameras.txt").read_text().split("PINHOLE")[1].split()[2])

    def frame(self, first: np.ndarray, last: np.ndarray) -> np.ndarray:
        """The picture (H,W,3) float32 whose first and last rows are exposed at these poses (4,4)."""
        back = np.linalg.inv(first), np.linalg.inv(last)
        eye, forward = back[0][:3, 3], first[2, :3]
        off = [np.degrees(np.arccos(np.clip(pose[2, :3] @ forward, -1, 1)))
               + np.linalg.norm(np.linalg.inv(pose)[:3, 3] - eye) for pose in self.poses]
        near = np.argsort(off)[:NEAREST]
        depth = np.zeros((HEIGHT, WIDTH), np.float32)
        for i in near:
            world = np.linalg.inv(self.poses[i])
            _splat(self.depths[i], self.focal, self.width, self.height, (first @ world)[:3], (last @ world)[:3],
                   FOCAL, depth)
        lacking = (depth == 0).astype(np.uint8)
        nearby = cv2.dilate(depth, np.ones((5, 5), np.uint8))
        depth = np.where((lacking > 0) & (nearby > 0), nearby, depth)
        places = np.empty((HEIGHT, WIDTH, 3), np.float32)
        _lift(depth, back[0][:3], back[1][:3], FOCAL, places)
        total, weight = np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.float32)
        last_resort = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        for rank, i in enumerate(near[COLOURING - 1 :: -1]):
            seen = places @ self.poses[i][:3, :3].T.astype(np.float32) + self.poses[i][:3, 3].astype(np.float32)
            z = np.maximum(seen[..., 2], 0.1)
            u = (seen[..., 0] / z * self.focal + self.width / 2 - 0.5).astype(np.float32)
            v = (seen[..., 1] / z * self.focal + self.height / 2 - 0.5).astype(np.float32)
            there = cv2.remap(self.depths[i], u, v, cv2.INTER_NEAREST, borderValue=0)
            colour = cv2.remap(self.pictures[i], u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            shown = (depth > 0) & (there > 0) & (np.abs(there - seen[..., 2]) < 0.01 * seen[..., 2] + 0.05)
            share = np.where(shown, np.float32(5.0 ** rank), 0).astype(np.float32)
            total += share[..., None] * colour
            weight += share
            last_resort = np.where((u > 0)[..., None] & (u < self.width)[..., None], colour, last_resort)
        picture = np.where(weight[..., None] > 0, total / np.maximum(weight, 1e-6)[..., None], last_resort)
        picture = np.where(depth[..., None] > 0, picture, np.array(SKY)).astype(np.float32)
        return _blurred(picture, places, depth, first, last)


def _blurred(
    picture: np.ndarray, places: np.ndarray, depth: np.ndarray, first: np.ndarray, last: np.ndarray
) -> np.ndarray:
    """The mean of three moments of the exposure: what is seen moves on as from the first row to the last."""
    was, comes = (places @ pose[:3, :3].T + pose[:3, 3] for pose in (first.astype(np.float32), last.astype(np.float32)))
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = FOCAL * (comes[..., :2] / comes[..., 2:] - was[..., :2] / was[..., 2:]) * (EXPOSURE / READOUT)
    moved = np.where(depth[..., None] > 0, np.nan_to_num(moved), 0).astype(np.float32)
    x, y = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    parts = [cv2.remap(picture, x - s * moved[..., 0], y - s * moved[..., 1], cv2.INTER_LINEAR,
                       borderMode=cv2.BORDER_REPLICATE) for s in (-0.4, 0.0, 0.4)]
    return np.mean(parts, axis=0)




def film(site: Site, out: Path, seconds: float, rate: int, codec: str) -> None:
    out.mkdir(parents=True, exist_ok=True)
    container = av.open(str(out / "DJI_0900.MP4"), "w")
    stream = container.add_stream(codec, rate=rate)
    stream.width, stream.height, stream.pix_fmt, stream.bit_rate = WIDTH, HEIGHT, "yuv420p", 8_000_000
    count, rng, lines, shots = round(seconds * rate), np.random.default_rng(3), [], []
    drift = np.cumsum(rng.normal(0, 0.02, (count, 3)), axis=0)
    for n in range(count):
        start = n / rate
        picture = site.frame(at(start / seconds), at((start + READOUT) / seconds))
        picture = picture + rng.normal(0, 2.0, (HEIGHT, WIDTH, 1))
        middle = at((start + READOUT / 2) / seconds)
        eye = np.linalg.inv(middle)[:3, 3]
        latitude, longitude, altitude = geodetic((eye + drift[n] + rng.normal(0, 0.1, 3))[None])[0]
        shots.append(replace(site.shots[0], name=f"DJI_0900_{n:06d}.jpg", cam_from_world=middle))
        lines.append(_subtitle(n, rate, latitude, longitude, altitude))
        frame = av.VideoFrame.from_ndarray(np.clip(picture, 0, 255).astype(np.uint8), format="rgb24")
        for packet in stream.encode(frame):
            container.mux(packet)
        if n % rate == 0:
            print(f"{n} of {count}", flush=True)
    for packet in stream.encode():
        container.mux(packet)
    container.close()
    (out / "DJI_0900.SRT").write_text("\n".join(lines))
    write_model(shots, f"PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}", out / "truth")
    for name in ("cloud.npz", "origin.json"):
        shutil.copy(PHOTOS.parent / "truth" / name, out / "truth")


def _subtitle(n: int, rate: int, latitude: float, longitude: float, altitude: float) -> str:
    def clock(seconds: float) -> str:
        return f"00:00:{int(seconds):02d},{round(seconds % 1 * 1000):03d}"

    when = TAKE_OFF + timedelta(seconds=n / rate)
    return (f"{n + 1}\n{clock(n / rate)} --> {clock((n + 1) / rate - 0.001)}\n"
            f"<font size=\"28\">FrameCnt: {n + 1}, DiffTime: {round(1000 / rate)}ms\n{when:%Y-%m-%d %H:%M:%S}.000\n"
            f"[iso: 100] [shutter: 1/60.0] [fnum: 2.8] [latitude: {latitude:.7f}] [longitude: {longitude:.7f}] "
            f"[rel_alt: {altitude - ALTITUDE:.3f} abs_alt: {altitude:.3f}] </font>\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("depths", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--rate", type=int, default=RATE)
    parser.add_argument("--codec", default="libx264", choices=("libx264", "libx265"))
    given = parser.parse_args()
    film(Site(given.depths), given.out, given.seconds, given.rate, given.codec)


if __name__ == "__main__":
    main()
