# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one options record that travels from the panel or the command line to the stages."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

CLOUD_STAGES = ("photos", "sparse", "views", "depth", "fusion")
SURFACE_STAGES = ("mesh", "texture")  # they need a finished cloud and nothing else
STAGES = (*CLOUD_STAGES, *SURFACE_STAGES)
QUALITIES = ("preview", "standard", "high", "ultra")


@dataclass(frozen=True, kw_only=True)
class Preset:
    """What a quality stands for: longest image side for SfM and for depth maps (pixels), source views, most features
    a photo, and most faces of the mesh."""

    sfm_image_size: int
    image_size: int
    source_views: int
    max_features: int = 8192
    mesh_faces: int = 1_000_000


PRESETS = {
    "preview": Preset(sfm_image_size=1200, image_size=800, source_views=4, max_features=4096, mesh_faces=250_000),
    "standard": Preset(sfm_image_size=1600, image_size=1600, source_views=4),
    "high": Preset(sfm_image_size=2400, image_size=2400, source_views=6),
    "ultra": Preset(sfm_image_size=3200, image_size=100_000, source_views=8),
}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Everything a job depends on. Frozen: a stage's done-marker is keyed by the fields it used."""

    workspace: Path
    photos: Path | None  # None: only the surface of a workspace whose cloud is finished
    quality: str = "standard"
    model: Path | None = None  # a COLMAP model used in place of the sparse stage
    max_image_size: int | None = None  # pixels; overrides the preset's depth-map size
    views: int | None = None  # source views per reference; overrides the preset's
    until: str = "fusion"
    speeds: Path | None = None  # file where this computer's speed is kept, for predictions of later jobs
    memory_gib: float | None = None  # budget for the depth stage; None: 60 % of what is free
    half_memory: bool = False  # take half of that budget: memory ran out before
    device: str = "auto"  # auto, cpu, cuda, mps
    precision: str = "auto"  # auto, fp32, bf16
    scheduler: str = ""  # address of a Dask scheduler whose workers make the depth maps; "": this process does
    mapper: str = "auto"  # auto, incremental, global
    weights: Path | None = None  # None: the shipped weights
    min_confidence: float = 0.3  # tau
    min_views: int | None = None  # N_c: confirming views; None: three, or two that are sure (fusion.py)
    max_reprojection_error: float = 1.0  # pixels
    max_depth_difference: float = 0.01  # relative
    fill_holes: bool = True  # close holes in the mesh, marked as filled; False leaves them open
    max_faces: int | None = None  # of the mesh; overrides the preset's
    region: tuple[float, ...] | None = None  # the mesh's bounds in the site frame: x0, y0, z0, x1, y1, z1
    region_turn: tuple[float, ...] | None = None  # quaternion w, x, y, z: turns the site frame to the region's axes
    texture_size: int = 4096  # pixels, side of a page
    texture_format: str = "png"  # png, jpeg

    @property
    def preset(self) -> Preset:
        return PRESETS[self.quality]

    @property
    def image_size(self) -> int:
        """Longest side of a depth map, in pixels."""
        return self.max_image_size or self.preset.image_size

    @property
    def source_views(self) -> int:
        """Source views per reference (N)."""
        return self.views or self.preset.source_views

    @property
    def mesh_faces(self) -> int:
        """Most faces of the mesh."""
        return self.preset.mesh_faces if self.max_faces is None else self.max_faces
