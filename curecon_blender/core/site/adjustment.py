# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""A component's frame put right by what somebody measured on it: one similarity that scales, levels and turns.

It turns and scales about the frame's origin, which it may lift or lower: the origin keeps its latitude and longitude,
and its altitude is known. `adjustment.json` keeps it beside the component's frame.json, so that a model found anew,
whose frame is another, does not inherit it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ..base import rotations
from ..base.errors import CuReconError, WorkspaceError
from ..base.files import disk_errors, write_json
from ..base.language import Text
from ..base.reading import FARTHEST, OneOf, Shape, Within, build, parse_json, read_json
from ..base.records import Frame

FILE_NAME = "adjustment.json"
FORMAT = 1
SCALE, LEVEL, NORTH, GROUND = "scale", "level", "north", "ground"
THINNEST = 0.02  # height of a triangle over its longest side: points more in line than this span no plane
STEEPEST_WALL = 45.0  # degrees that a wall's normal may rise: steeper ones belong to floors
MEDIAN_OF_3D = 1.538  # median distance of a normal deviate in three dimensions, in standard deviations of one


class FrameError(CuReconError):
    """What was picked or typed fixes no scale, level or north."""

    kind = "frame"


@dataclass(frozen=True, kw_only=True)
class Measured:
    """What one step of an adjustment rests on.

    `kind` is SCALE, LEVEL, NORTH or GROUND; `value` the known length (metres), the bearing or the turn (degrees
    clockwise), else 0; `how` says in words what was measured; `points` (x, y, z each) were picked, in the frame as it
    was reconstructed; `sigma` is the relative standard deviation of the scale; `when` is local time, ISO 8601.
    """

    kind: Annotated[str, OneOf(SCALE, LEVEL, NORTH, GROUND)]
    value: Annotated[float, Within(-FARTHEST, FARTHEST)]
    how: str
    when: str
    points: tuple[tuple[float, float, float], ...] = ()
    sigma: Annotated[float, Within(0, FARTHEST)] = 0.0
    valid: bool = True  # False for a turn after which y is not north


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """adjusted = scale * rotation @ reconstructed + (0, 0, lift). `rotation` is (3,3); `lift` is in the unit of the
    adjusted frame; the last measurement of each kind is kept."""

    scale: Annotated[float, Within(1e-9, FARTHEST)] = 1.0
    rotation: Annotated[np.ndarray, Shape(3, 3)] = field(default_factory=lambda: np.eye(3))
    lift: Annotated[float, Within(-FARTHEST, FARTHEST)] = 0.0
    measured: tuple[Measured, ...] = ()

    @property
    def matrix(self) -> np.ndarray:
        """adjusted_from_reconstructed (4,4)."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[2, 3] = self.scale * self.rotation, self.lift
        return matrix

    def of(self, kind: str) -> Measured | None:
        return next((step for step in self.measured if step.kind == kind), None)

    def _with(self, step: Measured, points: np.ndarray, *, scale: float = 1.0, turn: np.ndarray | None = None,
              lift: float = 0.0) -> Adjustment:
        """This one followed by `scale` and `turn` (3,3) about the origin and by `lift`; `points` (N,3) are in the frame
        as adjusted so far."""
        reconstructed = np.linalg.solve(self.scale * self.rotation, (points - [0, 0, self.lift]).T).T
        step = replace(step, points=tuple((float(x), float(y), float(z)) for x, y, z in reconstructed))
        rotation = self.rotation if turn is None else turn @ self.rotation
        u, _, vt = np.linalg.svd(rotation)  # rounding must not add up to a shear
        return Adjustment(
            scale=self.scale * scale, rotation=u @ vt, lift=self.lift * scale + lift,
            measured=(*(kept for kept in self.measured if kept.kind != step.kind), step),
        )


# ---- the steps; points (3,) are in the frame as adjusted so far

def with_length(
    adjustment: Adjustment, first: np.ndarray, second: np.ndarray, length: float, *, sigma: float, when: datetime
) -> Adjustment:
    """Scaled so that `first` and `second` are `length` metres apart; `sigma` is the standard deviation of that, picks
    included, in metres. Raises FrameError for points at one place or no length."""
    found = float(np.linalg.norm(second - first))
    if not length > 0 or not np.isfinite(length):
        raise FrameError("A known distance must be above zero.", remedy="Type the distance in metres, such as 4.20.")
    if found < 1e-9:
        raise FrameError("The two points lie at the same place.", remedy="Pick two points that lie well apart.")
    step = Measured(kind=SCALE, value=length, how="a measured distance", when=_iso(when), sigma=sigma / length)
    return adjustment._with(step, np.stack([first, second]), scale=length / found)


def with_level(
    adjustment: Adjustment, points: np.ndarray, *, wall: bool, above: np.ndarray, when: datetime
) -> Adjustment:
    """Tilted by the smallest turn that lays the plane of `points` (3,3) level or, with `wall`, sets it upright.

    `above` (3,) is a place that lies above the floor, such as the cameras' middle: it tells the floor's upper side.
    Raises FrameError for points in a line, or for a wall that lies.
    """
    normal = _normal(points)
    if wall:
        rise = float(np.degrees(np.arcsin(min(1.0, abs(normal[2])))))
        if rise > STEEPEST_WALL:
            raise FrameError("The three points lie on a floor or a roof, not on a wall.",
                             remedy="Pick three points on a wall, or choose Floor.")
        target = np.array([normal[0], normal[1], 0.0])
        target /= np.linalg.norm(target)
    else:
        normal = normal if normal @ (above - points.mean(axis=0)) >= 0 else -normal
        target = np.array([0.0, 0.0, 1.0])
    how = "three points on a wall" if wall else "three points on a floor"
    step = Measured(kind=LEVEL, value=0.0, how=how, when=_iso(when))
    return adjustment._with(step, points, turn=rotations.between(normal, target))


def with_bearing(
    adjustment: Adjustment, first: np.ndarray, second: np.ndarray, bearing: float, *, when: datetime
) -> Adjustment:
    """Turned about Z so that `second` lies from `first` at `bearing` degrees clockwise from y, north. Raises
    FrameError for points above each other."""
    east, north, up = second - first
    if np.hypot(east, north) < 0.05 * max(abs(up), 1e-9):
        raise FrameError("The two points lie above each other and have no bearing.",
                         remedy="Pick two points that lie apart seen from above, such as a wall's two ends.")
    turn = bearing - float(np.degrees(np.arctan2(east, north)))
    step = Measured(kind=NORTH, value=bearing, how="a bearing", when=_iso(when))
    return adjustment._with(step, np.stack([first, second]), turn=_about_z(turn))


def with_turn(adjustment: Adjustment, degrees: float, *, north: bool, when: datetime) -> Adjustment:
    """Turned about Z by `degrees`, clockwise seen from above; `north` says that y is north then."""
    step = Measured(kind=NORTH, value=degrees, how="a typed turn", when=_iso(when), valid=north)
    return adjustment._with(step, np.zeros((0, 3)), turn=_about_z(degrees))


def with_ground(adjustment: Adjustment, height: float, *, when: datetime) -> Adjustment:
    """Lowered by `height`, of the ground above z = 0 as adjusted so far."""
    step = Measured(kind=GROUND, value=0.0, how="the cloud's lowest wide level", when=_iso(when))
    return adjustment._with(step, np.zeros((0, 3)), lift=-height)


# ---- what is then known

def adjusted_frame(frame: Frame, adjustment: Adjustment) -> Frame:
    """The frame's record with what was measured in place of what the reconstruction knew."""
    scale, level, north, ground = (adjustment.of(kind) for kind in (SCALE, LEVEL, NORTH, GROUND))
    turned = "North from" if north is not None and north.valid else "Turned by"
    said = [f"{lead} {describe(step)}, {step.when[:10]}."
            for lead, step in (("Scale from", scale), ("Level from", level), (turned, north), ("Z = 0 at", ground))
            if step is not None]
    if not said:
        return frame
    origin = frame.origin
    if origin is not None and origin.altitude is not None:
        origin = replace(origin, altitude=origin.altitude - adjustment.lift)
    return replace(
        frame, scale=frame.scale if scale is None else "metres", up=frame.up if level is None else "measured",
        north=frame.north if north is None else north.valid, origin=origin, shift=_shift(frame, adjustment),
        note=" ".join([*said, f"Reconstructed: {frame.note}"]),
    )


def _shift(frame: Frame, adjustment: Adjustment) -> tuple[float, float, float] | None:
    """The way back to given coordinates, which a scaled or turned frame does not have."""
    if frame.shift is None or adjustment.scale != 1 or not np.array_equal(adjustment.rotation, np.eye(3)):
        return None
    x, y, z = frame.shift
    return x, y, z - adjustment.lift


def describe(step: Measured) -> str:
    """In words: "a measured distance of 4.20 m"."""
    if step.kind == SCALE:
        return f"{step.how} of {step.value:.2f} m"
    return f"{step.how} of {step.value:.1f}°" if step.kind == NORTH else step.how


def scale_source(frame: Frame, adjustment: Adjustment) -> str:
    """What the true scale rests on, in words; empty when it is unknown."""
    if (step := adjustment.of(SCALE)) is not None:
        return describe(step)
    if frame.scale != "metres":
        return ""
    if frame.up == "control":
        return "control points"
    return "the photos' GPS" if frame.gps_residual is not None else "the given model"


def gps_scale_sigma(frame: Frame, centres: np.ndarray) -> float | None:
    """Relative standard deviation of a scale that comes from GPS; None when it does not. `centres` (N,3) are the
    cameras' places in the frame as reconstructed.

    It is the deviation of GPS along one axis over the cameras' root-mean-square distance from their middle. GPS errors
    of one flight hang together, so nothing is gained by there being many photos.
    """
    if frame.gps_residual is None or len(centres) < 2:
        return None
    spread = float(np.sqrt(((centres - centres.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return frame.gps_residual / MEDIAN_OF_3D / max(spread, 1e-9)


def angle_between(first: Adjustment, second: Adjustment) -> float:
    """How far the second turns beyond the first, in degrees."""
    cosine = (np.trace(second.rotation @ first.rotation.T) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


# ---- the file

def read(folder: Path) -> Adjustment:
    """The adjustment in a component's folder; one that changes nothing where there is none. Raises WorkspaceError for a
    damaged file."""
    path = folder / FILE_NAME
    try:
        return _built(read_json(path))
    except FileNotFoundError:
        return Adjustment()
    except (OSError, ValueError) as error:
        raise WorkspaceError(
            Text("{} is damaged ({}).", path, Text(str(error))), path=path,
            remedy="Delete that file and import again: the site comes as it was reconstructed.",
        ) from error


def write(folder: Path, adjustment: Adjustment) -> None:
    """Keep the adjustment in a component's folder (atomically); one that changes nothing needs no file. Raises
    WorkspaceError."""
    path = folder / FILE_NAME
    if adjustment.measured:
        write_json(path, _fields(adjustment))
    else:
        with disk_errors(path):
            path.unlink(missing_ok=True)


def to_json(adjustment: Adjustment) -> str:
    return json.dumps(_fields(adjustment))


def from_json(text: str) -> Adjustment:
    """The inverse of `to_json`. Raises ValueError."""
    return _built(parse_json(text))


def _built(fields: Any) -> Adjustment:
    if not isinstance(fields, dict):
        raise ValueError("no record")
    if build(int, fields.get("format"), "format") > FORMAT:
        raise ValueError("written by a newer version of CU-Recon")
    made: Adjustment = build(Adjustment, {name: value for name, value in fields.items() if name != "format"})
    turn = made.rotation
    if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) or np.linalg.det(turn) < 0:
        raise ValueError("not a similarity")
    return made


def _fields(adjustment: Adjustment) -> dict[str, Any]:
    return {"format": FORMAT, "scale": adjustment.scale, "rotation": adjustment.rotation.tolist(),
            "lift": adjustment.lift,
            "measured": [asdict(step) for step in adjustment.measured]}


def _iso(when: datetime) -> str:
    return when.isoformat(timespec="seconds")


def _normal(points: np.ndarray) -> np.ndarray:
    """Unit normal (3,) of the plane through `points` (3,3). Raises FrameError when they are in a line."""
    a, b, c = points
    across = np.cross(b - a, c - a)
    longest = max(float(np.linalg.norm(side)) for side in (b - a, c - a, c - b))
    if float(np.linalg.norm(across)) <= THINNEST * longest**2:
        raise FrameError("The three points lie in one line.",
                         remedy="Pick them as a wide triangle: the farther apart, the more exact.")
    return np.asarray(across / np.linalg.norm(across))


def _about_z(degrees: float) -> np.ndarray:
    """Clockwise seen from above."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
