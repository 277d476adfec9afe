# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The true places of a model's sparse points, where true cameras and surfaces are known.

Each observation is followed through the photo's true camera to the true surface. Points and truth correspond by that,
not by what lies nearest: a round building laid on its like could turn unseen.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from curecon_blender.core.base.records import GeoPosition
from curecon_blender.core.compare.geometry import Similarity

NEAREST = 10  # true points that tell a surface
EVEN = 0.004  # metres: root mean square distance of these from their plane
FARTHEST = 1.0  # metres from the surface, after the cameras are brought to the true ones; farther, it is another's
BESIDE = 0.15  # metres from where a ray meets a surface to the point that tells it
GRAZING = 0.2  # sine of a ray's angle with the surface, below which it tells no place
AGREE = 3.0  # pixels between an observation and where the true place of its point is seen; farther, it is a wrong match
_ROUNDS = 4


@dataclass(frozen=True, kw_only=True)
class TruePoints:
    """Of a model's points by their ascending numbers, those (K,) on even surfaces: their `index`, true `places` (K,3)
    and unit `normals` (K,3); and how many others were `mismatched`."""

    index: np.ndarray
    places: np.ndarray
    normals: np.ndarray
    mismatched: int


class TrueSite:
    """A site's true cameras and surfaces: a flight's folder `truth`, and a cloud.npz in its frame."""

    def __init__(self, truth: Path, cloud: Path) -> None:
        self.origin = GeoPosition(**json.loads((truth / "origin.json").read_text()))
        self._model = pycolmap.Reconstruction(truth)
        self._images = {str(image.name): image for image in self._model.images.values()}
        with np.load(cloud) as data:
            self._points = data["points"].T * float(data["unit"])
        self._tree = cKDTree(self._points)
        _, index = self._tree.query(self._points, NEAREST)
        about = self._points[index] - self._points[index].mean(axis=1)[:, None]
        values, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", about, about))
        self._normals = vectors[:, :, 0]
        even = np.sqrt(np.maximum(values[:, 0], 0) / NEAREST) < EVEN
        self._even = even & (values[:, 1] > 4 * values[:, 0])

    def centres(self, names: list[str]) -> np.ndarray:
        """(N,3) of photos by name."""
        return np.array([self._images[name].projection_center() for name in names])

    def points(self, model: pycolmap.Reconstruction, to_truth: Similarity) -> TruePoints:
        """The true places of a model's points, which `to_truth` brings near them."""
        numbers = {point: p for p, point in enumerate(sorted(model.point3D_ids()))}
        found = []
        for image in model.images.values():
            observed = [point for point in image.points2D if point.has_point3D()]
            if str(image.name) not in self._images or not observed:
                continue
            near = to_truth.apply(np.array([model.point3D(point.point3D_id).xyz for point in observed]))
            size = self._camera(image.name).width / model.camera(image.camera_id).width
            pixels = np.array([point.xy for point in observed]) * size
            places, normals, sure = self._seen(image.name, pixels, near)
            which = np.array([numbers[point.point3D_id] for point in observed])
            found.append((which[sure], places[sure], normals[sure], pixels[sure], np.full(sure.sum(), image.name)))
        return self._agreed(len(numbers), *(np.concatenate(column) for column in zip(*found, strict=True)))

    def _seen(self, name: str, pixels: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What a photo's pixels (M,2) show of the surface `near` (M,3): places (M,3), unit normals (M,3), and whether
        they are sure."""
        pose = self._images[name].cam_from_world()
        centre, rays = self._images[name].projection_center(), self._camera(name).cam_from_img(pixels)
        rays = np.column_stack([rays, np.ones(len(rays))]) @ pose.rotation.matrix()
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        places, sure = near, np.ones(len(near), bool)
        for _ in range(_ROUNDS):
            distance, index = self._tree.query(places, distance_upper_bound=FARTHEST)
            sure &= np.isfinite(distance)
            index = np.where(sure, index, 0)
            surface, normals = self._points[index], self._normals[index]
            steep = (rays * normals).sum(axis=1)
            sure &= np.abs(steep) > GRAZING
            along = ((surface - centre) * normals).sum(axis=1) / np.where(sure, steep, 1.0)
            places = np.where(sure[:, None], centre + along[:, None] * rays, near)
        sure &= self._even[index] & (np.linalg.norm(places - surface, axis=1) < BESIDE)
        return places, normals, sure

    def _agreed(
        self, count: int, which: np.ndarray, places: np.ndarray, normals: np.ndarray, pixels: np.ndarray,
        names: np.ndarray,
    ) -> TruePoints:
        """The points (count) on whose places most of their observations agree."""
        order = np.argsort(which, kind="stable")
        middle = np.empty_like(places)
        for mine in np.split(order, np.flatnonzero(np.diff(which[order])) + 1):
            middle[mine] = np.median(places[mine], axis=0)
        agree = np.zeros(len(which), bool)
        for name, image in self._images.items():
            mine = names == name
            at = self._camera(name).img_from_cam(image.cam_from_world() * middle[mine])
            agree[mine] = np.linalg.norm(at - pixels[mine], axis=1) < AGREE
        seen, agreeing = np.bincount(which, minlength=count), np.bincount(which[agree], minlength=count)
        sound = (agreeing >= 2) & (2 * agreeing > seen)
        sums = np.zeros((2, count, 3))
        # A normal's sign is by chance: all of one point are turned like its first.
        first = normals[order][np.searchsorted(which[order], which)]
        normals = normals * np.sign((normals * first).sum(axis=1))[:, None]
        for total, values in zip(sums, (places, normals), strict=True):
            np.add.at(total, which[agree], values[agree])
        index = np.flatnonzero(sound)
        return TruePoints(
            index=index, places=sums[0, index] / agreeing[index, None],
            normals=sums[1, index] / np.linalg.norm(sums[1, index], axis=1, keepdims=True),
            mismatched=int(((seen >= 2) & ~sound).sum()),
        )

    def _camera(self, name: str) -> pycolmap.Camera:
        return self._model.cameras[self._images[name].camera_id]
