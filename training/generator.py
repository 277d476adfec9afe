# SPDX-License-Identifier: GPL-3.0-or-later
"""Training scenes: pictures, exact depth, cameras and a sparse model as structure from motion would give it.

python -m training.generator --assets DIR --out DIR --count N --start-seed S --size 512x384 [--views 7] [--held-out]
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from training.assets import Assets
from training.cameras import Rig, draw_flight, draw_kind, draw_rig
from training.renderer import Renderer
from training.scene import compose

PREVIEW = (96, 72)  # pixels of the quick look at a rig
MIN_POINTS, MAX_POINTS = 300, 5000
# Far/near ratios that a scene may have, by rig; looking level, one sees far beyond the subject.
MAX_RATIOS = {"orbit": (5, 8, 25), "nadir": (5, 8, 25), "facade": (8, 20, 50), "hand": (8, 20, 50)}
FEWEST_VIEWS, MOST_VIEWS = 5, 11
FEWEST_IN_FLIGHT = 30
TRIES = 10  # rigs drawn for one world before another world is drawn


@dataclass(frozen=True)
class Scene:
    """One rendered scene.  Frame: Z up, metres; cameras as COLMAP has them, pixel centres at .5."""

    images: np.ndarray  # (V,H,W,3) uint8 RGB
    depth: np.ndarray  # (V,H,W) float32 z-depth in metres, 0 where nothing
    K: np.ndarray  # (V,3,3) float64
    cam_from_world: np.ndarray  # (V,3,4) float64, off by `pose_noise`
    points: np.ndarray  # (P,3) float32 sparse points
    visible: np.ndarray  # (V,P) bool: track membership
    pose_noise: float = 0.0  # pixels (one sigma) by which the given poses miss the true ones
    kind: str = ""  # rig
    complete: bool = True  # where there is no depth, there is nothing; else it is unknown


def project(K: np.ndarray, cam_from_world: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (P,2) and depths (P,) of world points (P,3) in one camera."""
    camera = points @ cam_from_world[:, :3].T + cam_from_world[:, 3]
    depth = camera[:, 2]
    pixels = camera @ K.T
    return pixels[:, :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[:, None], depth


def back_project(K: np.ndarray, cam_from_world: np.ndarray, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """World points (P,3) of pixels (P,2) at z-depths (P,)."""
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
    return (rays * depth[:, None] - cam_from_world[:, 3]) @ cam_from_world[:, :3]


def _sees_enough(depth: np.ndarray, max_ratio: float) -> bool:
    """Whether a depth picture looks like a photo of the site, taken from outside it, with far/near <= max_ratio."""
    seen = depth[depth > 0]
    if len(seen) < 0.5 * depth.size:
        return False
    nearest, near, middle, far = np.percentile(seen, [1, 2, 50, 98])
    return nearest > 1.5 and nearest > 0.12 * middle and middle < 250 and far <= max_ratio * near


class Generator:
    """Makes scenes from seeds; holds the OpenGL context and the asset cache."""

    def __init__(self, assets: Path) -> None:
        self.assets = Assets(assets)
        self.renderer = Renderer(self.assets)

    def generate(
        self, seed: int, size: tuple[int, int], views: int | None = 7, held_out: bool = False, pose_noise: bool = True
    ) -> Scene:
        """The scene of a seed; `size` is (W, H), and None for `views` draws their number.  The same arguments give the
        same scene on one machine."""
        rng = np.random.default_rng([seed, int(held_out)])
        if views is None:
            views = int(rng.integers(FEWEST_VIEWS, MOST_VIEWS + 1))
        while True:
            world = compose(self.assets, rng, held_out)
            self.renderer.upload(world)
            # One kind a world, or the rigs that pass the checks most easily would crowd out the others.
            kind = draw_kind(rng)
            max_ratio = float(rng.choice(MAX_RATIOS[kind]))
            for _ in range(TRIES):
                rig = draw_rig(rng, kind, world, views, size)
                if world.inside(rig.centres) or not self._preview(rig, size, max_ratio):
                    continue
                scene = self._shoot(rng, rig, size, pose_noise)
                if scene is not None:
                    return scene

    def fly(self, seed: int, size: tuple[int, int], held_out: bool = False, facade: bool = False) -> Scene:
        """A scene that a whole flight has taken, round a building or along a `facade` with openings: each photo has
        neighbours to choose its sources from."""
        rng = np.random.default_rng([seed, int(held_out), 1 + int(facade)])
        max_ratio = max(MAX_RATIOS["facade" if facade else "orbit"])
        while True:
            world = compose(self.assets, rng, held_out, facade)
            self.renderer.upload(world)
            rig = draw_flight(rng, world, size)
            good = np.array([self._looks_well(rig, v, size, max_ratio) for v in range(len(rig.K))])
            good &= ~np.array([world.inside(centre[None]) for centre in rig.centres])
            if good.sum() >= FEWEST_IN_FLIGHT:
                scene = self._shoot(rng, Rig(rig.kind, rig.K[good], rig.cam_from_world[good]), size, pose_noise=True)
                if scene is not None:
                    return scene

    def _preview(self, rig: Rig, size: tuple[int, int], max_ratio: float) -> bool:
        views = len(rig.K)
        order = sorted(range(views), key=lambda v: -abs(v - views // 2))  # the ends go wrong most often
        return all(self._looks_well(rig, v, size, max_ratio) for v in order)

    def _looks_well(self, rig: Rig, view: int, size: tuple[int, int], max_ratio: float) -> bool:
        scale = np.diag([PREVIEW[0] / size[0], PREVIEW[1] / size[1], 1])
        depth = self.renderer.render_depth(scale @ rig.K[view], rig.cam_from_world[view], PREVIEW)
        return _sees_enough(depth, max_ratio)

    def _shoot(self, rng: np.random.Generator, rig: Rig, size: tuple[int, int], pose_noise: bool) -> Scene | None:
        """Full pictures of a rig; None when a sparse model of them would be too thin."""
        shots = [self.renderer.render(k, c, size) for k, c in zip(rig.K, rig.cam_from_world, strict=True)]
        depth = np.stack([d for _, d in shots])
        clean = [np.ascontiguousarray(image[..., :3]) for image, _ in shots]
        mirrors = np.stack([image[..., 3] == 0 for image, _ in shots])
        points, visible = sparse_points(rng, clean, np.where(mirrors, 0, depth), rig)
        if len(points) < MIN_POINTS or visible.sum(axis=1).min() < 20:
            return None
        images = np.stack(photograph(rng, clean))
        sigma = float(rng.uniform(0.1, 0.3)) if pose_noise and rng.random() < 0.5 else 0.0
        poses = perturb(rng, rig, depth, sigma) if sigma else rig.cam_from_world
        return Scene(images, depth, rig.K, poses, points.astype(np.float32), visible, sigma, rig.kind)


def perturb(rng: np.random.Generator, rig: Rig, depth: np.ndarray, sigma: float) -> np.ndarray:
    """Poses (V,3,4) moved so that points of middle depth shift by about `sigma` pixels."""
    poses = rig.cam_from_world.copy()
    for v, pose in enumerate(poses):
        focal = rig.K[v, 0, 0]
        middle = float(np.median(depth[v][depth[v] > 0]))
        turn, _ = cv2.Rodrigues(rng.normal(0, 0.7 * sigma / focal, 3))
        shift = rng.normal(0, 0.7 * sigma / focal * middle, 3)
        pose[:] = turn @ pose
        pose[:, 3] += shift
    return poses


def sparse_points(
    rng: np.random.Generator, images: list[np.ndarray], depth: np.ndarray, rig: Rig
) -> tuple[np.ndarray, np.ndarray]:
    """Points (P,3) and tracks (V,P) bool from SIFT features of the pictures, as matching them would leave them."""
    views, height, width = depth.shape
    # The threshold of COLMAP, whose features also reach calm grounds: a depth range must cover those.
    detector = cv2.SIFT.create(2 * MAX_POINTS, contrastThreshold=0.02)
    centres = rig.centres
    budget = int(rng.integers(MIN_POINTS * 2, MAX_POINTS)) * max(1, views // MOST_VIEWS)
    found, tracks = [], []
    for v, image in enumerate(images):
        features = detector.detect(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
        if not features:
            continue
        column, row = np.array([feature.pt for feature in features]).astype(int).T
        z = depth[v, row, column].astype(np.float64)
        pixels = np.column_stack([column, row])[z > 0] + 0.5
        points = back_project(rig.K[v], rig.cam_from_world[v], pixels, z[z > 0])
        rays = centres[v] - points
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        track = np.zeros((views, len(points)), bool)
        track[v] = True
        widest = np.zeros(len(points))
        for other in range(views):
            if other == v:
                continue
            uv, ahead = project(rig.K[other], rig.cam_from_world[other], points)
            inside = (ahead > 0) & (uv > 2).all(axis=1) & (uv[:, 0] < width - 2) & (uv[:, 1] < height - 2)
            index = np.where(inside[:, None], uv, 0).astype(int)
            there = depth[other, index[:, 1], index[:, 0]]
            agrees = inside & (np.abs(there - ahead) < 0.01 * ahead)
            ray = centres[other] - points
            ray /= np.linalg.norm(ray, axis=1, keepdims=True)
            angle = np.degrees(np.arccos(np.clip((ray * rays).sum(axis=1), -1, 1)))
            # Matching of features falls off with the angle between the views.
            track[other] = agrees & (rng.random(len(points)) < 0.85 * np.exp(-((angle / 24) ** 2)))
            widest = np.maximum(widest, np.where(track[other], angle, 0))
        keep = track.sum(axis=0) >= 2
        points, track, widest = points[keep], track[:, keep], widest[keep]
        # Triangulation error lies along the ray and grows as the rays become parallel.
        error = 0.35 / rig.K[v, 0, 0] / np.sin(np.radians(np.maximum(widest, 1.0)))
        stretch = rng.normal(0, np.minimum(error, 0.02))
        outlier = rng.random(len(points)) < 0.015
        stretch[outlier] = rng.uniform(-0.4, 0.8, outlier.sum())
        found.append(points + (points - centres[v]) * stretch[:, None])
        tracks.append(track)
    if not found:
        return np.zeros((0, 3)), np.zeros((views, 0), bool)
    points, visible = np.concatenate(found), np.concatenate(tracks, axis=1)
    chosen = rng.permutation(len(points))[:budget]
    return points[chosen], visible[:, chosen]


def photograph(rng: np.random.Generator, images: list[np.ndarray]) -> list[np.ndarray]:
    """What a camera does to the pictures: exposure, white balance, gamma, blur, noise and JPEG, a little each view."""
    strength = rng.choice([0.0, 0.5, 1.0])
    noise = rng.choice([0.0, 1.0, 2.5]) * rng.uniform(0.5, 1.5)
    quality = int(rng.uniform(72, 97))
    blur = rng.uniform(0.3, 0.8) if rng.random() < 0.4 else 0.0
    ramp = np.linspace(0, 1, 256)
    cv2.setRNGSeed(int(rng.integers(2**31 - 1)))  # cv2.randn is several times as fast as numpy's
    out = []
    for image in images:
        gain = np.exp(rng.normal(0, 0.08 * strength)) * np.exp(rng.normal(0, 0.03 * strength, 3))
        gamma = np.exp(rng.normal(0, 0.08 * strength))
        table = np.clip(255 * gain * ramp[:, None] ** gamma, 0, 255).astype(np.uint8)
        image = cv2.LUT(image, table[:, None, :])
        if blur and rng.random() < 0.7:
            image = cv2.GaussianBlur(image, (0, 0), blur * rng.uniform(0.7, 1.3))
        if noise:
            grain = np.empty(image.shape, np.int16)
            cv2.randn(grain, np.zeros(3), np.full(3, noise))
            image = np.clip(image + grain, 0, 255).astype(np.uint8)
        code = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        out.append(cv2.imdecode(code, cv2.IMREAD_COLOR)[..., ::-1])
    return out


def save(scene: Scene, path: Path) -> None:
    """One .npz: pictures as JPEG, depth as 16-bit logarithm (relative error below 1e-4) in PNG."""
    arrays: dict[str, np.ndarray] = {
        name: getattr(scene, name) for name in ("K", "cam_from_world", "points", "pose_noise", "kind", "complete")
    }
    arrays["visible"] = np.packbits(scene.visible, axis=1)
    ranges = []
    for v, (image, depth) in enumerate(zip(scene.images, scene.depth, strict=True)):
        code = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 96])[1]
        arrays[f"image{v}"] = code.ravel()
        seen = depth > 0
        low, high = np.log(depth[seen].min()), np.log(depth[seen].max()) + 1e-6
        steps = np.where(seen, 1 + 65534 * (np.log(np.where(seen, depth, 1)) - low) / (high - low), 0)
        arrays[f"depth{v}"] = cv2.imencode(".png", np.round(steps).astype(np.uint16))[1].ravel()
        ranges.append((low, high))
    arrays["ranges"] = np.array(ranges, np.float64)
    partial = path.with_suffix(".part")
    with partial.open("wb") as file:
        np.savez(file, **arrays)
    partial.replace(path)


def load(path: Path) -> Scene:
    """A scene written by `save`."""
    with np.load(path) as data:
        images, depths = [], []
        for v, (low, high) in enumerate(data["ranges"]):
            images.append(cv2.imdecode(data[f"image{v}"], cv2.IMREAD_COLOR)[..., ::-1])
            steps = cv2.imdecode(data[f"depth{v}"], cv2.IMREAD_UNCHANGED).astype(np.float64)
            depth = np.exp(low + (steps - 1) / 65534 * (high - low))
            depths.append(np.where(steps > 0, depth, 0).astype(np.float32))
        points = data["points"]
        visible = np.unpackbits(data["visible"], axis=1, count=len(points)).astype(bool)
        return Scene(
            np.stack(images),
            np.stack(depths),
            data["K"],
            data["cam_from_world"],
            points,
            visible,
            float(data["pose_noise"]),
            str(data["kind"]),
            bool(data["complete"]),
        )


_GENERATORS: dict[Path, Generator] = {}


def generate(
    assets: Path, seed: int, size: tuple[int, int], views: int | None = 7, held_out: bool = False,
    pose_noise: bool = True,
) -> Scene:
    """The scene of a seed, with one Generator kept for each asset folder."""
    key = Path(assets).resolve()
    if key not in _GENERATORS:
        _GENERATORS[key] = Generator(key)
    return _GENERATORS[key].generate(seed, size, views, held_out, pose_noise)


def main() -> None:
    parser = argparse.ArgumentParser(description="Render training scenes.")
    parser.add_argument("--assets", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--count", type=int, default=10)
    parser.add_argument("--start-seed", type=int, default=0)
    parser.add_argument("--size", default="512x384", help="WIDTHxHEIGHT in pixels")
    parser.add_argument("--views", type=int, help=f"photos a scene (default: drawn, {FEWEST_VIEWS} to {MOST_VIEWS})")
    parser.add_argument("--flight", action="store_true", help="whole flights of 30 to 70 photos; --views is not used")
    parser.add_argument("--facades", action="store_true", help="of --flight: along walls with openings, at 6 to 15 m")
    parser.add_argument("--held-out", action="store_true", help="use only the buildings kept for evaluation")
    options = parser.parse_args()
    width, height = (int(n) for n in options.size.split("x"))
    options.out.mkdir(parents=True, exist_ok=True)
    generator = Generator(options.assets)
    began = time.perf_counter()
    made = images = 0
    for seed in range(options.start_seed, options.start_seed + options.count):
        path = options.out / f"{seed}.npz"
        if path.exists():
            continue
        if options.flight:
            scene = generator.fly(seed, (width, height), options.held_out, options.facades)
        else:
            scene = generator.generate(seed, (width, height), options.views, options.held_out)
        save(scene, path)
        made, images = made + 1, images + len(scene.images)
        seconds = time.perf_counter() - began
        print(f"{path.name}: {made / seconds:.2f} scenes/s, {images / seconds:.1f} images/s", flush=True)


if __name__ == "__main__":
    main()
