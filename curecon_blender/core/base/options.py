# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The one options record that travels from the panel or the command line to the stages.

Each option is declared once: what the command line calls it, what it means, its unit and its range stand beside its
default. The parser (run/command_line.py) reads them, and `arguments` writes a record as the command line that gives it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any

CLOUD_STAGES = ("photos", "sparse", "adjust", "views", "depth", "fusion")
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
class Detail:
    """A level of detail: most faces, and most pixels a side of its texture's page."""

    faces: int
    page_size: int


DETAILS = {  # beside the mesh itself: for phones, for the web, for presentations
    "20k": Detail(faces=20_000, page_size=2048),
    "150k": Detail(faces=150_000, page_size=4096),
    "1m": Detail(faces=1_000_000, page_size=8192),
}


# The worker's commands.
RUN, SURFACE, CHECK, REPORT = "reconstruct", "surface", "check", "report"
CONTROL, EXPORT, PLAN, FRAMES = "control", "export", "plan", "frames"
GAPS, MASK = "gaps", "mask"
SELF_CHECK, LIBRARIES, PUBLISH = "self-check", "libraries", "publish"
COMPARE, UPLOAD = "compare", "upload"
TOKEN_VARIABLE = "CURECON_ATLAS_TOKEN"  # that an upload is made with: no other program sees it in a list

MASKS_FOLDER = "masks"  # of a workspace, NAME.png each: what was marked in Blender
GAPS_FOLDER, GAPS_FILE = "gaps", "gaps.ply"  # what `gaps` writes into a workspace

# What `export` writes, and what its coordinates count from.
POINT_FORMATS = ("laz", "copc", "e57")
SURFACE_FORMATS = ("orthomosaic", "dsm", "facades")  # of the mesh, or of the cloud where there is none
LINE_FORMATS = ("contours", "sections")  # of the mesh
FORMATS = (*POINT_FORMATS, *SURFACE_FORMATS, *LINE_FORMATS)
LOCAL, SITE, UTM = "local", "site", "utm"
PLACEMENTS = (LOCAL, SITE, UTM)
COMPARE_WAYS = ("coordinates", "pairs", "found")  # how `compare` lays another result on ours

# What published pages tell of where a site is.
EXACT, CELL, HIDDEN = "exact", "cell", "hidden"
LOCATIONS = (EXACT, CELL, HIDDEN)

VIDEO_SUFFIXES = (".mp4", ".mov")  # that frames are taken of

# Coded targets as OpenCV's aruco module calls them, the most usual first.
DICTIONARIES = ("4X4_50", "4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "ARUCO_ORIGINAL", "APRILTAG_36h11")


@dataclass(frozen=True, kw_only=True)
class Argument:
    """How an option is given on the command line, and what a person is told of it.

    A number is at least `least` (above it where `above`), and at most `most`; `parts` names the numbers of a tuple, and
    `many` is for one value or more.
    """

    flag: str
    help: str
    commands: tuple[str, ...] = (RUN,)
    unit: str = ""
    choices: tuple[str, ...] = ()
    least: float | None = None
    above: bool = False
    most: float | None = None
    parts: tuple[str, ...] = ()
    many: bool = False


def _as(flag: str, help: str, **facts: Any) -> dict[str, Argument]:
    return {"argument": Argument(flag=flag, help=help, **facts)}


_SURFACES = (RUN, SURFACE)
_ABOVE_ZERO: dict[str, Any] = {"least": 0, "above": True}


@dataclass(frozen=True, kw_only=True)
class Options:
    """Everything a job depends on. Frozen and hashable: a stage's done-marker is keyed by the fields it used."""

    workspace: Path
    photos: Path | None  # None: only the surface of a workspace whose cloud is finished
    until: str = "fusion"
    quality: str = field(default="standard", metadata=_as(
        "--quality", "how fine the result is, and how long it takes", choices=QUALITIES))
    surplus: bool = field(default=False, metadata=_as(
        "--surplus", "use pictures, too, that are no photos of this job: thermal ones and single bands beside colour "
        "photos, panoramas, maps, screenshots, copies", commands=(RUN, CHECK)))
    model: Path | None = field(default=None, metadata=_as(
        "--model", "a COLMAP model (text or binary) in place of the sparse stage", unit="folder"))
    control: tuple[Path, ...] = field(default=(), metadata=_as(
        "--control", "files of control points and marks, for this and later runs: ODM, Pix4D, Metashape, name,x,y,z",
        unit="file", many=True))
    control_system: str = field(default="", metadata=_as(
        "--control-system", "what the control points are in where their file does not say so: WGS84, 'UTM 50N', "
        "EPSG:2180 or local", unit="system"))
    max_image_size: int | None = field(default=None, metadata=_as(
        "--max-image-size", "longest side of a depth map, in place of the quality's", unit="pixels", least=1))
    views: int | None = field(default=None, metadata=_as(
        "--views", "source views for each photo, in place of the quality's", unit="views", least=1))
    speeds: Path | None = field(default=None, metadata=_as(
        "--speeds", "where this computer's speed is kept, for predictions", unit="file", commands=(RUN, CHECK)))
    memory_gib: float | None = field(default=None, metadata=_as(
        "--memory", "memory for depth maps and fusion (default: 60 % of what is free)", unit="GiB",
        commands=(RUN, CHECK), **_ABOVE_ZERO))
    half_memory: bool = field(default=False, metadata=_as(
        "--half-memory", "half of that memory, where a run before ran out of it"))
    device: str = field(default="auto", metadata=_as(
        "--device", "where the network runs", commands=(RUN, CHECK, SELF_CHECK),
        choices=("auto", "cpu", "cuda", "mps")))
    precision: str = field(default="auto", metadata=_as(
        "--precision", "of the network", choices=("auto", "fp32", "bf16")))
    scheduler: str = field(default="", metadata=_as(
        "--scheduler", "make the depth maps on the workers of the Dask cluster at tcp://HOST:PORT", unit="address"))
    mapper: str = field(default="auto", metadata=_as(
        "--mapper", "how the cameras are found", choices=("auto", "incremental", "global")))
    matches: str = field(default="auto", metadata=_as(
        "--matches", "between photos: by SIFT; by SIFT and a network (both); auto: the network for photos that SIFT "
        "leaves out", choices=("auto", "sift", "both")))
    weights: Path | None = field(default=None, metadata=_as(
        "--weights", "other weights (.safetensors with its .json beside it)", unit="file"))
    min_confidence: float = field(default=0.3, metadata=_as(
        "--min-confidence", "least confidence of a depth that becomes a point", least=0, most=1))
    min_views: int | None = field(default=None, metadata=_as(
        "--min-views", "views that must agree (default: by their confidence and angle)", unit="views", least=1))
    max_reprojection_error: float = field(default=1.0, metadata=_as(
        "--max-reprojection-error", "up to which two views agree on a point", unit="pixels", **_ABOVE_ZERO))
    max_depth_difference: float = field(default=0.01, metadata=_as(
        "--max-depth-difference", "up to which two views agree on a point", unit="relative", **_ABOVE_ZERO))
    fill_holes: bool = field(default=True, metadata=_as(
        "--fill-holes", "close holes in the mesh; what no photo measured is marked as filled", commands=_SURFACES))
    extent: str = field(default="site", metadata=_as(
        "--extent", "of the mesh: the site, without the background that photos saw only from afar, the building that "
        "stands on it, without the ground around and without trees, or everything",
        commands=_SURFACES, choices=("site", "building", "everything")))
    max_faces: int | None = field(default=None, metadata=_as(
        "--max-faces", "most triangles of the mesh, in place of the quality's", unit="faces", commands=_SURFACES))
    region: tuple[float, ...] | None = field(default=None, metadata=_as(
        "--region", "build the mesh of this part of the site only, in its frame", commands=_SURFACES,
        parts=("X0", "Y0", "Z0", "X1", "Y1", "Z1")))
    region_turn: tuple[float, ...] | None = field(default=None, metadata=_as(
        "--region-turn", "a quaternion that turns the site's frame to the axes that --region counts along",
        commands=_SURFACES, parts=("W", "X", "Y", "Z")))
    texture_size: int = field(default=4096, metadata=_as(
        "--texture-size", "side of a page of the texture", unit="pixels", commands=_SURFACES))
    texture_format: str = field(default="png", metadata=_as(
        "--texture-format", "of the texture's pages", commands=_SURFACES, choices=("png", "jpeg")))

    detail: tuple[str, ...] = field(default=(), metadata=_as(
        "--detail", "after the texture, also make the mesh with so many faces, each with a texture of its own",
        commands=_SURFACES, choices=tuple(DETAILS), many=True))

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


def declared(command: str) -> Iterator[tuple[Field[Any], Argument]]:
    """The options that a command of the worker takes, each with what was declared of it."""
    for option in fields(Options):
        argument = option.metadata.get("argument")
        if argument is not None and command in argument.commands:
            yield option, argument


def arguments(options: Options, command: str) -> list[str]:
    """The worker's command line that gives a record: what differs from the defaults, of what the command takes."""
    if command == SURFACE:
        given = [command, str(options.workspace)]
    else:
        given = [command, str(options.photos), "--workspace", str(options.workspace)]
    if command in _SURFACES:
        given += ["--until", options.until]
    for option, argument in declared(command):
        value = getattr(options, option.name)
        if value == option.default:
            continue
        if isinstance(value, bool):
            given.append(argument.flag if value else f"--no-{argument.flag[2:]}")
        elif argument.many:
            given += [argument.flag, *map(str, value)]
        elif isinstance(value, tuple):
            given += [argument.flag, *(f"{number:.9f}" for number in value)]
        else:
            given += [argument.flag, str(value)]
    return given
