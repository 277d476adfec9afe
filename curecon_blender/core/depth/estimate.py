# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth maps: LCM-MVSNet over every view, in tiles that fit a memory budget, one finished file a photo."""

from __future__ import annotations

from collections import Counter, OrderedDict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..base import images
from ..base.allocator import release
from ..base.errors import DeviceError
from ..base.language import Text
from ..base.messages import Reporter
from ..base.options import Options
from ..base.records import Component, View
from ..network.model import MULTIPLE, Geometry, LCMMVSNet, depth_from_t
from ..network.refinement import rasterise_points
from ..views import sparse_points
from ..views.masks import left_out
from .maps import is_finished, write_depth
from .tiles import Tile, TilePlan, kept_part, memory_budget, plan_tiles

RELEASE_EVERY = 16  # photos: what lies between the features that are kept would else add up, a few MB a photo
FEATURES_KEPT = 2  # times a photo and its sources: so many photos' features are kept
SURE, UNSURE = 0.9, 0.5  # confidence
STEP = 2.0**-20  # of a source's distance
REACH = 1.2  # times the farthest reliable depth: no unsure pixel lies beyond; the margin that depth_range gives


def choose_device(name: str) -> torch.device:
    """The device by its option name. Raises DeviceError when it is not there."""
    available = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        name = next(n for n in ("cuda", "mps", "cpu") if available[n])
    if not available[name]:
        raise DeviceError(
            Text("This computer has no usable {} device for this Python's torch.", name.upper()),
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


def features_kept(options: Options) -> int:
    """Of how many photos the features are kept."""
    return FEATURES_KEPT * (1 + options.source_views)


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
        self._kept = features_kept(options)
        self._features: OrderedDict[str, tuple[Tensor, ...]] = OrderedDict()
        self.left_out = False  # whether parts of the last photo went without some sources, for want of memory

    @torch.inference_mode()
    def estimate(self, view: View, sources: list[tuple[View, float]]) -> tuple[np.ndarray, np.ndarray]:
        """z-depth (H,W) float32 in world units and confidence (H,W) float16 of a view from (source, S_i) pairs.

        Raises DeviceError when the budget is too small, WorkspaceError when the view's sparse points cannot be read.
        """
        depth = np.zeros((view.height, view.width), np.float32)
        confidence = np.zeros((view.height, view.width), np.float16)
        others = [source for source, _ in sources]
        hypotheses = self.coarse_hypotheses(view, others)
        points = sparse_points.read(self._workspace, view)
        plans = plan_tiles(view, others, hypotheses, self.budget)
        self.left_out = any(None in plan.seen for plan in plans)
        for plan in plans:
            if len(plans) > 1:
                release()  # tiles see regions of all sizes: what one leaves lies in pieces that the next cannot use
            tile_depth, tile_confidence = self._tile(view, sources, points, plan, hypotheses, len(plans) == 1)
            tile, kept = plan.tile, kept_part(plan.tile, view)
            place = np.s_[kept.y0 : kept.y1, kept.x0 : kept.x1]
            inner = np.s_[kept.y0 - tile.y0 : kept.y1 - tile.y0, kept.x0 - tile.x0 : kept.x1 - tile.x0]
            depth[place], confidence[place] = tile_depth[inner], tile_confidence[inner]
        return within_reach(depth, confidence, points), confidence

    def coarse_hypotheses(self, view: View, sources: list[View]) -> int:
        """How many hypotheses the coarsest level sweeps for a view, the same in all its tiles."""
        K = _batch(np.stack([v.K for v in (view, *sources)]))
        poses = _batch(np.stack([recentred(v.cam_from_world, view.centre) for v in (view, *sources)]))
        near, far = torch.tensor([view.near]), torch.tensor([view.far])
        return self._network.coarse_hypotheses(K, poses, near, far, (view.width, view.height))

    def _tile(
        self, view: View, sources: list[tuple[View, float]], points: np.ndarray, plan: TilePlan, hypotheses: int,
        whole: bool,
    ) -> tuple[np.ndarray, np.ndarray]:
        tile, (width, height) = plan.tile, plan.tile.size
        used = [(source, score, region) for (source, score), region in zip(sources, plan.seen, strict=True) if region]
        if not used:
            return np.zeros((height, width), np.float32), np.zeros((height, width), np.float16)
        crops = [(view, tile), *((source, region) for source, _, region in used)]
        features = [self._features_of(v, region, whole) for v, region in crops]
        K = np.stack([_shifted(v.K, region) for v, region in crops])
        # Poses relative to the reference's centre keep float32 exact, wherever the site's origin is.
        poses = np.stack([recentred(v.cam_from_world, view.centre) for v, _ in crops])
        near, far = (torch.tensor([d], dtype=torch.float32, device=self.device) for d in (view.near, view.far))
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == torch.bfloat16):
            geometry = Geometry(_batch(K).to(self.device), _batch(poses).to(self.device), near, far,
                                _batch(np.array([score for _, score, _ in used])).to(self.device),
                                _batch(np.array([region.size for _, region in crops[1:]])).to(self.device))
            outputs = self._network.sweep(features[0], features[1:], geometry, hypotheses)
            colours = self._colours(view, tile)
            t, confidence = self._network.estimate(colours, outputs, self._points(view, tile, points, colours))
        depth = depth_from_t(t, near, far)
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
        height, width = rgb.shape[:2]
        rgb = np.pad(rgb, ((0, -height % MULTIPLE), (0, -width % MULTIPLE), (0, 0)), mode="edge")
        return torch.from_numpy(rgb).to(self.device).permute(2, 0, 1).unsqueeze(0).float().div_(255)

    def _features_of(self, view: View, region: Tile, whole: bool) -> tuple[Tensor, ...]:
        """Features of a region; those of the last whole photos are kept (features_kept), within a quarter of the
        budget."""
        if whole and view.name in self._features:
            self._features.move_to_end(view.name)
            return self._features[view.name]
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.dtype == torch.bfloat16):
            features: tuple[Tensor, ...] = self._network.pyramid(self._colours(view, region))
        if not whole:
            release()  # regions differ in size: what each took while computed would add up, in pieces
        else:
            self._features[view.name] = features
            size = sum(f.numel() * f.element_size() for f in features)
            while len(self._features) > max(1, min(self._kept, self.budget // 4 // size)):
                self._features.popitem(last=False)
        return features


def within_reach(depth: np.ndarray, confidence: np.ndarray, points: np.ndarray) -> np.ndarray:
    """A depth map (H,W) whose unsure pixels are held within REACH times the farthest depth (but for 1 %) of the sure
    pixels and of the sparse points (P,4) that the photo has matched.

    The sweep goes on far beyond those, for what can be matched there; a pixel that no source sees must not be thrown
    to its end.
    """
    reliable = depth[confidence > SURE], points[points[:, 3] > 0, 2]
    farthest = max((float(np.percentile(depths, 99)) for depths in reliable if len(depths)), default=np.inf)
    return np.where(confidence < UNSURE, np.minimum(depth, REACH * farthest), depth).astype(np.float32)


def _batch(values: np.ndarray) -> Tensor:
    """A float32 tensor with a batch dimension of 1."""
    return torch.from_numpy(np.ascontiguousarray(values, np.float32)).unsqueeze(0)


def _shifted(K: np.ndarray, region: Tile) -> np.ndarray:
    shifted = K.copy()
    shifted[:2, 2] -= region.x0, region.y0
    return shifted


def recentred(cam_from_world: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """A pose (3,4) whose world begins at `origin` (3,), in steps of STEP of how far off the camera is. Coordinates of a
    grid or of the Earth are rounded by nanometres; in float32 that is another number now and then, from which bf16
    makes other depths. In these steps, a hundredth of a pixel at most, the same cameras give the same depth maps."""
    rotation = cam_from_world[:, :3]
    translation = cam_from_world[:, 3] + rotation @ origin
    if far := float(np.linalg.norm(translation)):
        step = STEP * 2.0 ** np.ceil(np.log2(far))
        translation = step * np.rint(translation / step)
    return np.column_stack([rotation, translation])


def unfinished(components: list[Component], workspace: Path, key: str) -> list[tuple[View, dict[str, View]]]:
    """Every view whose depth map is not there, whole, for `key`; with the views of its component by name."""
    return [
        (view, views) for component in components for views in [{view.name: view for view in component.views}]
        for view in component.views if not is_finished(workspace, view, key)
    ]


def by_neighbours(
    left: list[tuple[View, dict[str, View]]], kept: int
) -> list[tuple[View, dict[str, View]]]:
    """The same photos in an order in which the next is one that asks for most of the `kept` pictures used last, so that
    few features are computed twice. Each photo's result is the same in any order."""
    asked = [(view.name, *(name for name, _ in view.sources)) for view, _ in left]
    asks: dict[str, list[int]] = {}  # for a picture
    for number, names in enumerate(asked):
        for name in names:
            asks.setdefault(name, []).append(number)
    waiting = dict.fromkeys(range(len(left)))
    recent: OrderedDict[str, None] = OrderedDict()
    order = []
    while waiting:
        shared = Counter(number for name in recent for number in asks[name] if number in waiting)
        chosen = max(shared, key=lambda number: (shared[number], -number)) if shared else next(iter(waiting))
        del waiting[chosen]
        order.append(left[chosen])
        for name in asked[chosen]:
            recent[name] = None
            recent.move_to_end(name)
        while len(recent) > kept:
            recent.popitem(last=False)
    return order


def make_depth(estimator: DepthEstimator, view: View, views: dict[str, View], workspace: Path, key: str) -> bool:
    """Estimate one view and write its depth map, whole or not at all; a view without sources gets no depth. Whether
    parts of it went without some sources, for want of memory."""
    if view.sources:
        depth, confidence = estimator.estimate(view, [(views[n], s) for n, s in view.sources])
        if (hidden := left_out(workspace, view)) is not None:
            depth[hidden], confidence[hidden] = 0, 0
    else:
        depth = np.zeros((view.height, view.width), np.float32)
        confidence = np.zeros((view.height, view.width), np.float16)
    write_depth(workspace, view, depth, confidence, key)
    return bool(view.sources) and estimator.left_out


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
            reporter.warning(Text("{} has no suitable neighbour; it gets no depth.", view.name), view.name)
    return done, total


def estimate_depths(
    components: list[Component], network: LCMMVSNet, workspace: Path, options: Options, key: str, reporter: Reporter
) -> None:
    """Write the depth map of every view (maps.py); those already there for `key` are left alone."""
    estimator = DepthEstimator(network, workspace, options)
    left = unfinished(components, workspace, key)
    done, total = start_progress(components, left, reporter)
    left_out = 0
    for view, views in by_neighbours(left, features_kept(options)):
        left_out += make_depth(estimator, view, views, workspace, key)
        done += 1
        if done % RELEASE_EVERY == 0:
            release()
        reporter.progress(done, total)
    tell_left_out(left_out, reporter)


def tell_left_out(photos: int, reporter: Reporter) -> None:
    """Warn of so many photos that went without some of their sources in places."""
    if photos:
        reporter.warning(
            Text("{} photos were matched with fewer of their neighbours in places, because the memory budget is too "
                 "small for all of them. A lower quality, or more memory, uses them all.", photos)
        )
