# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rigs as drones and people fly or walk them.  cam_from_world: x right, y down, z forward; metres."""

from dataclasses import dataclass

import numpy as np

from training.scene import Subject, World

CLEARANCE = 1.2  # metres a camera stays above the ground


@dataclass(frozen=True)
class Rig:
    """K (V,3,3) pixels with centres at .5, cam_from_world (V,3,4)."""

    kind: str
    K: np.ndarray
    cam_from_world: np.ndarray

    @property
    def centres(self) -> np.ndarray:
        """(V,3) camera centres in the world."""
        rotation, translation = self.cam_from_world[:, :, :3], self.cam_from_world[:, :, 3]
        return -np.einsum("vji,vj->vi", rotation, translation)


def look_at(centre: np.ndarray, target: np.ndarray, roll: float) -> np.ndarray:
    """(3,4) cam_from_world of a camera at centre (3,) that looks at target (3,), turned by `roll` radians."""
    forward = target - centre
    forward = forward / np.linalg.norm(forward)
    up = np.array([0.0, 0.0, 1.0])
    if abs(forward[2]) > 0.999:
        up = np.array([0.0, 1.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    cos, sin = np.cos(roll), np.sin(roll)
    rotation = np.stack([cos * right + sin * down, cos * down - sin * right, forward])
    return np.concatenate([rotation, (-rotation @ centre)[:, None]], axis=1)


def _step(rng: np.random.Generator) -> float:
    """Angle between neighbours in radians: mostly 3 to 18 degrees, one in five up to 33."""
    degrees = rng.uniform(18, 33) if rng.random() < 0.2 else rng.uniform(3, 18)
    return float(np.radians(degrees))


def _orbit(rng: np.random.Generator, subject: Subject, views: int, half_fov: float) -> tuple[np.ndarray, np.ndarray]:
    """Oblique orbit, sometimes at two or three heights."""
    size = max(subject.radius, 0.5 * subject.height, 3.0)
    distance = size / np.tan(half_fov) * rng.uniform(0.45, 1.15) + 0.5 * size
    elevation = np.radians(rng.uniform(12, 65))
    rows = int(rng.choice([1, 1, 2, 3]))
    step = _step(rng)
    start = rng.uniform(0, 2 * np.pi)
    index = np.arange(views)
    azimuth = start + (index // rows) * step + rng.normal(0, 0.08 * step, views)
    tilt = elevation + (index % rows - (rows - 1) / 2) * step + rng.normal(0, 0.08 * step, views)
    tilt = np.clip(tilt, np.radians(5), np.radians(80))
    away = distance * (1 + rng.normal(0, 0.03, views))
    target = subject.centre + np.array([0, 0, subject.height * rng.uniform(0.2, 0.6)])
    target = target + np.append(rng.normal(0, 0.25 * subject.radius, 2), 0)
    direction = np.stack([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)], axis=1)
    return target + away[:, None] * direction, target + rng.normal(0, 0.04 * distance, (views, 3))


def _nadir(rng: np.random.Generator, subject: Subject, views: int, half_fov: float) -> tuple[np.ndarray, np.ndarray]:
    """Part of a mapping grid: parallel strips seen straight down or a little oblique."""
    height = subject.height * rng.uniform(1.3, 2.5) + rng.uniform(10, 45)
    step = 2 * np.tan(_step(rng) / 2) * (height - 0.5 * subject.height)
    columns = int(rng.choice([2, 3, views]))
    index = np.arange(views)
    row, column = index // columns, index % columns
    column = np.where(row % 2, columns - 1 - column, column)
    across = rng.uniform(1.0, 1.6)
    grid = np.stack([(column - column.mean()) * step, (row - row.mean()) * step * across], axis=1)
    heading = rng.uniform(0, 2 * np.pi)
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    xy = subject.centre[:2] + rng.normal(0, 0.3 * subject.radius, 2) + grid @ turn.T
    xy = xy + rng.normal(0, 0.05 * step, (views, 2))
    centres = np.column_stack([xy, subject.centre[2] + height + rng.normal(0, 0.01 * height, views)])
    tilt = np.tan(np.radians(rng.choice([0.5, 8.0, 20.0]) * rng.uniform(0.3, 1)))
    direction = np.append(turn @ np.array([0.0, 1.0]) * tilt, -1.0)
    return centres, centres + (direction + rng.normal(0, 0.03, (views, 3))) * height


def _facade(rng: np.random.Generator, subject: Subject, views: int, half_fov: float) -> tuple[np.ndarray, np.ndarray]:
    """A pass along one side, camera square to the wall or a little off, sometimes in two heights."""
    gap = rng.uniform(6, 25)
    distance = gap + subject.radius * rng.uniform(0.6, 0.95)
    heading = rng.uniform(0, 2 * np.pi)
    outward = np.array([np.cos(heading), np.sin(heading), 0.0])
    along = np.array([-outward[1], outward[0], 0.0])
    step = 2 * np.tan(_step(rng) / 2) * gap
    rows = int(rng.choice([1, 1, 2]))
    index = np.arange(views)
    s = (index // rows - (index // rows).mean()) * step + rng.normal(0, 0.05 * step, views)
    s = s + rng.normal(0, 0.3 * subject.radius)
    z = subject.height * rng.uniform(0.3, 1.1) + (index % rows - (rows - 1) / 2) * step + 1.5
    centres = subject.centre + outward * distance + s[:, None] * along
    centres[:, 2] = subject.centre[2] + z + rng.normal(0, 0.1, views)
    yaw, pitch = rng.uniform(-0.5, 0.5), np.radians(rng.uniform(-5, 35))
    forward = -outward * np.cos(yaw) + along * np.sin(yaw)
    forward = forward * np.cos(pitch) - np.array([0, 0, np.sin(pitch)])
    return centres, centres + (forward + rng.normal(0, 0.025, (views, 3))) * distance


def _hand_held(
    rng: np.random.Generator, subject: Subject, views: int, half_fov: float
) -> tuple[np.ndarray, np.ndarray]:
    """A person walking an arc round the subject, looking at its middle or up at it."""
    distance = subject.radius + rng.uniform(5, 20)
    step = _step(rng)
    azimuth = rng.uniform(0, 2 * np.pi) + np.arange(views) * step + rng.normal(0, 0.15 * step, views)
    away = distance * (1 + rng.normal(0, 0.06, views))
    centres = subject.centre + away[:, None] * np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=1)
    centres[:, 2] += rng.uniform(1.4, 3.5) + rng.normal(0, 0.15, views)
    target = subject.centre + np.append(rng.normal(0, 0.2 * subject.radius, 2), subject.height * rng.uniform(0.15, 0.7))
    return centres, target + rng.normal(0, 0.04 * distance, (views, 3))


def _flight(rng: np.random.Generator, subject: Subject, half_fov: float) -> tuple[np.ndarray, np.ndarray]:
    """A whole mission as manuals advise it: two full orbits at different heights and a nadir grid above."""
    size = max(subject.radius, 0.5 * subject.height, 3.0)
    distance = size / np.tan(half_fov) * rng.uniform(0.7, 1.0) + 0.5 * size
    middle = subject.centre + np.array([0, 0, 0.4 * subject.height])
    centres, targets = [], []
    for elevation in np.radians([rng.uniform(18, 35), rng.uniform(40, 60)]):
        photos = int(rng.integers(20, 31))
        azimuth = rng.uniform(0, 2 * np.pi) + np.arange(photos) * 2 * np.pi / photos + rng.normal(0, 0.02, photos)
        tilt = elevation + rng.normal(0, 0.01, photos)
        direction = np.stack([np.cos(azimuth) * np.cos(tilt), np.sin(azimuth) * np.cos(tilt), np.sin(tilt)], axis=1)
        centres.append(middle + distance * direction)
        targets.append(middle + rng.normal(0, 0.03 * distance, (photos, 3)))
    height = subject.height + distance * 0.8
    step = 0.45 * height * np.tan(half_fov)  # about 75 % of the shorter side overlaps
    grid = np.stack(np.meshgrid(*[step * np.arange(-1, 2)] * 2), axis=-1).reshape(-1, 2)
    grid = grid + rng.normal(0, 0.05 * step, grid.shape)
    above = np.column_stack([subject.centre[:2] + grid, np.full(len(grid), subject.centre[2] + height)])
    centres.append(above)
    targets.append(above + np.array([0.01, 0, -1]) * height + rng.normal(0, 0.02 * height, above.shape))
    return np.concatenate(centres), np.concatenate(targets)


def _facade_flight(rng: np.random.Generator, subject: Subject, half_fov: float) -> tuple[np.ndarray, np.ndarray]:
    """A facade as manuals advise it: passes along it from 6 to 15 m at two or three heights, square to the wall and
    aslant to both sides."""
    heading = 0.0 if subject.facing is None else subject.facing
    outward = np.array([np.cos(heading), np.sin(heading), 0.0])
    along = np.array([-outward[1], outward[0], 0.0])
    away, reach = rng.uniform(6, 15), subject.radius
    stops = int(np.clip(2 * reach / (0.5 * away * np.tan(half_fov)), 8, 16))  # three quarters of two pictures overlap
    heights = np.linspace(1.7, max(3.0, subject.height * rng.uniform(0.6, 1.1)), int(rng.integers(2, 4)))
    centres, targets = [], []
    for z, slant in zip(heights, rng.permutation([-0.45, 0.0, 0.45]), strict=False):
        for yaw in (slant, 0.0) if slant else (0.0,):
            s = np.linspace(-reach, reach, stops) + rng.normal(0, 0.03 * reach, stops)
            gap = away * (1 + rng.normal(0, 0.04, stops))
            at = subject.centre + s[:, None] * along + gap[:, None] * outward + np.array([0, 0, z])
            at[:, 2] += rng.normal(0, 0.15, stops)
            middle = subject.centre[2] + z + (0.5 * subject.height - z) * rng.uniform(0.2, 0.8)
            target = at - gap[:, None] * (outward - np.tan(yaw) * along)
            target[:, 2] = middle
            centres.append(at)
            targets.append(target + rng.normal(0, 0.03 * away, (stops, 3)))
    return np.concatenate(centres), np.concatenate(targets)


_RIGS = {"orbit": (_orbit, 0.40), "nadir": (_nadir, 0.22), "facade": (_facade, 0.18), "hand": (_hand_held, 0.20)}


def draw_kind(rng: np.random.Generator) -> str:
    """The name of a kind of rig."""
    kinds = list(_RIGS)
    return str(rng.choice(kinds, p=[_RIGS[k][1] for k in kinds]))


def draw_rig(rng: np.random.Generator, kind: str, world: World, views: int, size: tuple[int, int]) -> Rig:
    """A random rig of a kind for `views` pictures of `size` (W, H) pixels; the caller checks what it sees."""
    focal, half_fov = _draw_lens(rng, size)
    subject = world.subject if rng.random() < 0.7 else world.site
    return _build(rng, kind, world, focal, size, *_RIGS[kind][0](rng, subject, views, half_fov))


def draw_flight(rng: np.random.Generator, world: World, size: tuple[int, int]) -> Rig:
    """A random whole flight about the world's subject; the caller leaves out the photos that see nothing."""
    focal, half_fov = _draw_lens(rng, size)
    kind, fly = ("flight", _flight) if world.subject.facing is None else ("facade flight", _facade_flight)
    return _build(rng, kind, world, focal, size, *fly(rng, world.subject, half_fov))


def _draw_lens(rng: np.random.Generator, size: tuple[int, int]) -> tuple[float, float]:
    """Focal length in pixels, and half of the field of view over the shorter side in radians."""
    focal = size[0] / 2 / np.tan(np.radians(rng.uniform(38, 84)) / 2)
    return float(focal), float(np.arctan(min(size) / 2 / focal))


def _build(
    rng: np.random.Generator, kind: str, world: World, focal: float, size: tuple[int, int], centres: np.ndarray,
    targets: np.ndarray,
) -> Rig:
    """Cameras (V) at centres (V,3) above the ground that look at targets (V,3), none quite like the other."""
    width, height = size
    views = len(centres)
    floor = world.terrain.height(centres[:, :2]) + CLEARANCE
    lift = np.maximum(floor - centres[:, 2], 0)
    centres[:, 2] += lift
    targets[:, 2] += lift
    roll = rng.normal(0, np.radians(rng.choice([0.5, 3.0, 8.0])), views)
    if rng.random() < 0.1:  # portrait
        roll = roll + np.pi / 2 * rng.choice([-1, 1])
    cameras = np.stack([look_at(c, t, r) for c, t, r in zip(centres, targets, roll, strict=True)])
    matrices = np.zeros((views, 3, 3))
    focals = focal * (1 + rng.normal(0, 0.004 if rng.random() < 0.7 else 0.03, views))
    aspect = 1 + rng.normal(0, 0.002)
    centre = np.array([width / 2, height / 2]) + rng.normal(0, 0.01 * width, 2)
    matrices[:, 0, 0], matrices[:, 1, 1] = focals, focals * aspect
    matrices[:, :2, 2] = centre
    matrices[:, 2, 2] = 1
    return Rig(kind, matrices, cameras)
