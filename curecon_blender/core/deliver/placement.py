# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a deliverable's coordinates count from.

LOCAL is the adjusted site frame alone: no byte of a file tells where the site is, how high, or when it was taken. SITE
has the same coordinates and says where their origin lies, as a transverse Mercator grid about it, so that a GIS puts
them in their place. UTM has easting, northing, altitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.errors import CuReconError
from ..base.geodesy import enu_to_geodetic, geodetic_to_utm, utm_zone
from ..base.language import Text
from ..base.options import LOCAL, UTM
from ..base.records import Frame, GeoPosition


class DeliverError(CuReconError):
    """A deliverable cannot be made: of this site, in this frame, or of these figures."""

    exit_code = 13
    kind = "deliver"


@dataclass(frozen=True, kw_only=True)
class Placement:
    """How a component's own frame becomes a deliverable's coordinates.

    `matrix` (4,4) takes the frame as reconstructed to the adjusted site frame, which `frame` describes; `kind` is
    LOCAL, SITE or UTM. Raises DeliverError where the frame does not know what the kind needs.
    """

    kind: str
    frame: Frame
    matrix: np.ndarray

    def __post_init__(self) -> None:
        frame = self.frame
        if self.kind == LOCAL or (frame.scale == "metres" and frame.north and frame.origin is not None):
            return
        lacks = ("its scale" if frame.scale != "metres" else "its place on Earth" if frame.origin is None
                 else "where north is")
        raise DeliverError(
            Text("The site cannot be placed on Earth: {} is unknown.", Text(lacks)),
            remedy="Choose the local frame, or give the photos' GPS, control points or a measured scale and north "
            "first.",
        )

    @property
    def unit(self) -> str:
        """What one of the coordinates is: "m", or nothing where the scale is unknown."""
        return "m" if self.frame.scale == "metres" else ""

    @cached_property
    def zone(self) -> tuple[int, bool]:
        """The UTM zone's number, and whether it is in the south."""
        return utm_zone(self.origin.longitude), self.origin.latitude < 0

    @property
    def origin(self) -> GeoPosition:
        """Of every kind but LOCAL."""
        assert self.frame.origin is not None
        return self.frame.origin

    def to_site(self, points: np.ndarray) -> np.ndarray:
        """(N,3) in the frame as reconstructed -> (N,3) float64 in the adjusted site frame."""
        placed: np.ndarray = points.astype(np.float64) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        return placed

    def to_output(self, points: np.ndarray) -> np.ndarray:
        """(N,3) in the frame as reconstructed -> (N,3) float64 as the deliverable has them.

        An altitude that is unknown counts from the site's ground in UTM, too.
        """
        placed = self.to_site(points)
        if self.kind != UTM:
            return placed
        places = enu_to_geodetic(placed, self.origin)
        zone, south = self.zone
        return np.column_stack([geodetic_to_utm(places[:, :2], zone, south=south), places[:, 2]])
