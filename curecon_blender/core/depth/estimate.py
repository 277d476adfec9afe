# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps: LCM-MVSNet over every view, in tiles that fit a memory budget, one finished file a photo."""

from __future__ import annotations

import io
from collections import OrderedDict
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import psutil
import torch
import torch.nn.functional as F
from torch import Tensor

from ..base import images
from ..base.allocator import release
from ..base.errors import DeviceError
from ..base.files import atomic_write
from ..base.messages import Reporter
from ..base.options import Options
from ..base.reading import Expected, read_arrays
from ..base.records import Component, View
from ..network.model import MAX_HYPOTHESES, MIN_HYPOTHESES, MULTIPLE, Geometry, LCMMVSNet, depth_from_t
from ..network.refinement import rasterise_points
from ..views import sparse_points

TILE_OVERLAP = 64  # pixels that neighbouring tiles share; half of it on each side is thrown away
RELEASE_EVERY = 16  # photos: what lies between the features that are kept would else add up, a few MB a photo
FEATURE_BYTES = 1 << 30  # of photos' features kept: a photo's neighbours, some dozens
SOURCE_MARGIN = 32  # pixels of context kept around what a tile can see in a source
# Peak memory of one tile, measured on a CPU (benchmarks/depth.py): fixed, per pixel of the tile, and per pixel of
# each of its sources.
BASE_BYTES = 500 << 20
LEAST_BUDGET = BASE_BYTES + (400 << 20)  # of the whole stage: one small tile
BYTES_PER_HYPOTHESIS = 60  # and pixel of the photo
BYTES_PER_SOURCE_PIXEL = 80


@dataclass(frozen=True)
class Tile:
    """A rectangle of the reference: computed over [x0, x1) x [y0, y1), kept inside the margins only."""

    x0: int
    y0: int
    x1: int
    y1: int


def choose_device(name: str) -> torch.device:
    """The device by its option name. Raises DeviceError when it is not there."""
    available = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        name = next(n for n in ("cuda", "mps", "cpu") if available[n])
    if not available[name]:
        raise DeviceError(
            f"This computer has no usable {name.upper()} device for this Python's torch.",
            remedy="Choose the device 'auto' or 'cpu', or a worker Python whose torch supports your graphics card.",
        )
    return torch.device(name)


def choose_precision(name: str, device: torch.device) -> torch.dtype:
    """bf16 where the option says so or the device is made for it, else fp32."""
    if name == "auto":
        fast = {"cuda": device.type == "cuda" and torch.cuda.is_bf16_supported(), "mps": False,
                "cpu": torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()}
        name = "bf16" if fast[device.type] else "fp32"
    return torch.bfloat16 if name == "bf16" else torch.float32


def memory_budget(options: Options, device: torch.device) -> int:
    """Bytes that the depth stage may use: the option, or 60 % of what the device has free; or half of that."""
    share = 0.5 if options.half_memory else 1.0
    if options.memory_gib is not None:
        return int(share * options.memory_gib * 2**30)
    if device.type == "cuda":
        return int(share * 0.6 * torch.cuda.mem_get_info(device)[0])
    return int(share * 0.6 * psutil.virtual_memory().available)


def bytes_per_pixel(hypotheses: int) -> int:
    """Peak memory for each pixel of a tile, with so many hypotheses at the coarsest level (a sixteenth of the pixels,
    where the middle one has 16 for a quarter and the finest 8 for all of them)."""
    return BYTES_PER_HYPOTHESIS * (8 + 4 + hypotheses // 16)


def typical_hypotheses(size: int) -> int:
    """What the coarsest level wants of a photo of so many pixels on its longer side, before its sources are known:
    between two photos of an orbit, things move by half a photo's width at most."""
    return min(max(size // 8, MIN_HYPOTHESES), MAX_HYPOTHESES)


def plan_tiles(width: int, height: int, sources: int, hypotheses: int, budget: int) -> list[Tile]:
    """The fewest equal tiles, as square as can be, that each fit `budget` bytes with so many hypotheses at the coarsest
    level. Raises DeviceError when not even a small tile fits."""
    for columns, rows in sorted(product(range(1, 65), repeat=2), key=lambda n: (n[0] * n[1], abs(n[0] - n[1]))):
        tile_width, tile_height = _tile_side(width, columns), _tile_side(height, rows)
        # A tile of a cut-up photo sees, in each source, more than its own area: its whole epipolar band.
        seen = min(width * height, 3 * tile_width * tile_height) if columns * rows > 1 else width * height
        own = tile_width * tile_height * bytes_per_pixel(hypotheses)
        if BASE_BYTES + own + sources * seen * BYTES_PER_SOURCE_PIXEL <= budget:
            return [
                Tile(x, y, min(x + tile_width, width), min(y + tile_height, height))
                for y in _starts(height, tile_height, rows) for x in _starts(width, tile_width, columns)
            ]
        if tile_width <= 2 * TILE_OVERLAP and tile_height <= 2 * TILE_OVERLAP:
            break
    raise DeviceError(
        f"A memory budget of {budget / 2**30:.2f} GiB is too small for even one tile of a depth map.",
        remedy=f"Give it at least {LEAST_BUDGET / 2**30:.1f} GiB, or close other programs.",
    )


def _tile_side(length: int, count: int) -> int:
    side = -(-(length + (count - 1) * TILE_OVERLAP) // count)
    return -(-side // MULTIPLE) * MULTIPLE


def _starts(length: int, side: int, count: int) -> list[int]:
    if count == 1:
        return [0]
    return [round(i * (length - side) / (count - 1)) for i in range(count)]


class DepthEstimator:
    """The network on its device, with the features of whole photos kept while they serve as sources."""

    def __init__(self, network: LCMMVSNet, workspace: Path, options: Options) -> None:
        self.device = choose_device(options.device)
        self.dtype = choose_precision(options.precision, self.device)
        self.budget = memory_budget(options, self.device)
        self._workspace = workspace
        self._network = network.to(self.device).eval().fold_batch_norm()
        if self.dtype == torch.bfloat16 or self.device.type == "cpu":
            self._network.channels_last()
        self._features: OrderedDict[str, tuple[Tensor, ...]] = OrderedDict()

    @torch.inference_mode()
    def estimate(self, view: View, sources: list[tuple[View, float]]) -> tuple[np.ndarray, np.ndarray]:
        """z-depth (H,W) float32 in world units and confidence (H,W) float16 of a view from (source, S_i) pairs.

        Raises DeviceError when the budget is too small, WorkspaceError when the view's sparse points cannot be read.
        """
        depth = np.zeros((view.height, view.width), np.float32)
        confidence = np.zeros((view.height, view.width), np.float16)
        largest = max((v.width * v.height for v, _ in sources), default=0)
        scale = max(1.0, largest / (view.width * view.height))
        hypotheses = self.coarse_hypotheses(view, [source for source, _ in sources])
        points = sparse_points.read(self._workspace, view)
        tiles = plan_tiles(view.width, view.height, max(1, round(len(sources) * scale)), hypotheses, self.budget)
        for tile in tiles:
            tile_depth, tile_confidence = self._tile(view, sources, points, tile, hypotheses, len(tiles) == 1)
            # Only the inner part of a tile is kept, except at the photo's own edges.
            half = TILE_OVERLAP // 2
            x0, y0 = tile.x0 + half * (tile.x0 > 0), tile.y0 + half * (tile.y0 > 0)
            x1, y1 = tile.x1 - half * (tile.x1 < view.width), tile.y1 - half * (tile.y1 < view.height)
            inner = np.s_[y0 - tile.y0 : y1 - tile.y0, x0 - tile.x0 : x1 - tile.x0]
            depth[y0:y1, x0:x1] = tile_depth[inner]
            confidence[y0:y1, x0:x1] = tile_confidence[inner]
        return depth, confidence

    def coarse_hypotheses(self, view: View, sources: list[View]) -> int:
        """How many hypotheses the coarsest level sweeps for a view, the same in all its tiles."""
        K = _batch(np.stack([v.K for v in (view, *sources)]))
        poses = _batch(np.stack([_recentred(v.cam_from_world, view.centre) for v in (view, *sources)]))
        near, far = torch.tensor([view.near]), torch.tensor([view.far])
        return self._network.coarse_hypotheses(K, poses, near, far, (view.width, view.height))

    def _tile(
        self, view: View, sources: list[tuple[View, float]], points: np.ndarray, tile: Tile, hypotheses: int,
        whole: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        crops = [(view, tile)] + [
            (s, Tile(0, 0, s.width, s.height) if whole else visible_region(view, tile, s)) for s, _ in sources
        ]
        features = [self._features_of(v, region, whole) for v, region in crops]
        K = np.stack([_shifted(v.K, region) for v, region in crops])
        # Poses relative to the reference's centre keep float32 exact, wherever the site's origin is.
        poses = np.stack([_recentred(v.cam_from_world, view.centre) for v, _ in crops])
        near, far = (torch.tensor([d], dtype=torch.float32, device=self.device) for d in (view.near, view.far))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == torch.bfloat16):
            geometry = Geometry(_batch(K).to(self.device), _batch(poses).to(self.device), near, far,
                                _batch(np.array([score for _, score in sources])).to(self.device))
            outputs = self._network.sweep(features[0], features[1:], geometry, hypotheses)
            colours = self._colours(view, tile)
            t, confidence = self._network.estimate(colours, outputs, self._points(view, tile, points, colours))
        depth = depth_from_t(t, near, far)
        height, width = tile.y1 - tile.y0, tile.x1 - tile.x0
        return (depth[0, 0, :height, :width].cpu().numpy(),
                confidence[0, 0, :height, :width].cpu().numpy().astype(np.float16))

    def _points(self, view: View, region: Tile, points: np.ndarray, colours: Tensor) -> Tensor:
        """The sparse points (P,4) of a view as the refinement of a region with these colours takes them."""
        shift = np.array([region.x0, region.y0, 0, 0], np.float32)
        grid = rasterise_points(points - shift, view.near, view.far, (colours.shape[3], colours.shape[2]))
        return torch.from_numpy(grid).unsqueeze(0).to(self.device)

    def _colours(self, view: View, region: Tile) -> Tensor:
        """A region's colours (1,3,h,w) in [0, 1], its last column and row repeated up to the sides that the network
        takes."""
        rgb = images.read_rgb(self._workspace / view.image)[region.y0 : region.y1, region.x0 : region.x1]
        x = torch.from_numpy(np.ascontiguousarray(rgb)).to(self.device).permute(2, 0, 1).unsqueeze(0).float() / 255
        return F.pad(x, (0, -x.shape[3] % MULTIPLE, 0, -x.shape[2] % MULTIPLE), mode="replicate")

    def _features_of(self, view: View, region: Tile, whole: bool) -> tuple[Tensor, ...]:
        """Features of a region; those of whole photos are kept within FEATURE_BYTES and a quarter of the budget."""
        if whole and view.name in self._features:
            self._features.move_to_end(view.name)
            return self._features[view.name]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == torch.bfloat16):
            features: tuple[Tensor, ...] = self._network.pyramid(self._colours(view, region))
        if whole:
            self._features[view.name] = features
            size = sum(f.numel() * f.element_size() for f in features)
            while len(self._features) > max(1, min(FEATURE_BYTES, self.budget // 4) // size):
                self._features.popitem(last=False)
        return features


def visible_region(view: View, tile: Tile, source: View) -> Tile:
    """What a tile can see of a source between near and far, with some context; the whole source when in doubt."""
    xs = np.linspace(tile.x0, tile.x1, 9)
    ys = np.linspace(tile.y0, tile.y1, 9)
    pixels = np.stack([*np.meshgrid(xs, ys), np.ones((9, 9))]).reshape(3, -1)
    rays = np.linalg.inv(view.K) @ pixels
    inverse_depths = np.linspace(1 / view.far, 1 / view.near, 16)
    camera = np.concatenate([rays / w for w in inverse_depths], axis=1)
    world = view.cam_from_world[:, :3].T @ (camera - view.cam_from_world[:, 3:])
    seen = source.K @ (source.cam_from_world[:, :3] @ world + source.cam_from_world[:, 3:])
    if (seen[2] <= 0).any():
        return Tile(0, 0, source.width, source.height)
    u, v = seen[:2] / seen[2]
    x0, x1 = _clipped(u, source.width)
    y0, y1 = _clipped(v, source.height)
    return Tile(x0, y0, x1, y1)


def _clipped(values: np.ndarray, length: int) -> tuple[int, int]:
    """First and last pixel of a span within a picture, with the margin, never narrower than MULTIPLE."""
    first = int(np.clip(values.min() - SOURCE_MARGIN, 0, max(0, length - MULTIPLE)))
    last = int(np.clip(values.max() + SOURCE_MARGIN, first + MULTIPLE, max(length, first + MULTIPLE)))
    return first, min(last, length)


def _batch(values: np.ndarray) -> Tensor:
    """A float32 tensor with a batch dimension of 1."""
    return torch.from_numpy(np.ascontiguousarray(values, np.float32)).unsqueeze(0)


def _shifted(K: np.ndarray, region: Tile) -> np.ndarray:
    shifted = K.copy()
    shifted[:2, 2] -= region.x0, region.y0
    return shifted


def _recentred(cam_from_world: np.ndarray, origin: np.ndarray) -> np.ndarray:
    rotation = cam_from_world[:, :3]
    return np.column_stack([rotation, cam_from_world[:, 3] + rotation @ origin])


def depth_path(workspace: Path, name: str) -> Path:
    return workspace / "depth" / f"{name}.npz"


def unfinished(components: list[Component], workspace: Path, key: str) -> list[tuple[View, dict[str, View]]]:
    """Every view whose `depth/NAME.npz` is not there, whole, for `key`; with the views of its component by name."""
    return [
        (view, views) for component in components for views in [{view.name: view for view in component.views}]
        for view in component.views if not _is_finished(depth_path(workspace, view.name), view, key)
    ]


def make_depth(estimator: DepthEstimator, view: View, views: dict[str, View], workspace: Path, key: str) -> None:
    """Estimate one view and write its file, whole or not at all; see `estimate_depths` for what it holds."""
    if view.sources:
        depth, confidence = estimator.estimate(view, [(views[n], s) for n, s in view.sources])
    else:
        depth = np.zeros((view.height, view.width), np.float32)
        confidence = np.zeros((view.height, view.width), np.float16)
    # By way of memory: a zip that meets a full disk half-way complains a second time when it is closed.
    content = io.BytesIO()
    np.savez(content, depth=depth, confidence=confidence, K=view.K, cam_from_world=view.cam_from_world,
             key=np.array(key))
    with atomic_write(depth_path(workspace, view.name)) as file:
        file.write(content.getbuffer())


def start_progress(
    components: list[Component], left: list[tuple[View, dict[str, View]]], reporter: Reporter
) -> tuple[int, int]:
    """Tell of what is finished from an earlier run, and of photos that get no depth; how many are done, and of how
    many."""
    total = sum(len(component.views) for component in components)
    done = total - len(left)
    if done:
        reporter.progress(done, total, fresh=False)
    for view, _ in left:
        if not view.sources:
            reporter.warning(f"{view.name} has no suitable neighbour; it gets no depth.", view.name)
    return done, total


def estimate_depths(
    components: list[Component], network: LCMMVSNet, workspace: Path, options: Options, key: str, reporter: Reporter
) -> None:
    """Write `depth/NAME.npz` of every view; files already there for `key` are left alone.

    A file holds depth (H,W) float32 z-depth in world units (0: none), confidence (H,W) float16 in [0, 1], K (3,3),
    cam_from_world (3,4), and the key it was made for.
    """
    estimator = DepthEstimator(network, workspace, options)
    left = unfinished(components, workspace, key)
    done, total = start_progress(components, left, reporter)
    for view, views in left:
        make_depth(estimator, view, views, workspace, key)
        done += 1
        if done % RELEASE_EVERY == 0:
            release()
        reporter.progress(done, total)


def _is_finished(path: Path, view: View, key: str) -> bool:
    """Whether a photo's depth is there, whole, and made for the same options, inputs and camera."""
    try:
        arrays = read_arrays(path, {
            "key": Expected((), "U"), "K": Expected((3, 3), "f"), "cam_from_world": Expected((3, 4), "f"),
        })
    except (OSError, ValueError):
        return False
    return (str(arrays["key"]) == key and np.array_equal(arrays["K"], view.K)
            and np.array_equal(arrays["cam_from_world"], view.cam_from_world))
