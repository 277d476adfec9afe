# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloud as LAZ: LAS 1.4, point format 7, with confidence, confirming views and precision as extra bytes, and the
coordinate system as WKT. Points are read and written in blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import laspy
import lazrs
import numpy as np

from ..base.files import atomic_write
from ..base.messages import Reporter
from ..cloud.edits import edited_blocks
from ..cloud.ply import Cloud
from . import systems
from .placement import DeliverError, Placement

BLOCK = 1 << 20  # points at once: some hundred bytes each
_STEP = 0.001  # metres, of a coordinate as LAS keeps it: in whole numbers
_STEPS = 1e7  # across a cloud of unknown scale
_ROUND = 1e6  # steps that coordinates are counted from whole multiples of
_PERCENT, _MILLIMETRES = 100, 1000  # units of the extra bytes: few programs read their scale
_FULL_COLOUR = 257  # LAS has 16 bits a colour


@dataclass(frozen=True, kw_only=True)
class CloudSource:
    """A component's cloud to be delivered: its file, where its coordinates go, and what its file says besides."""

    path: Path
    placement: Placement
    words: Sequence[str] = ()

    def blocks(self) -> Iterator[tuple[Cloud, np.ndarray]]:
        """The points that were not taken out, in blocks: as they are, and their places (N,3) in the deliverable.
        Raises WorkspaceError."""
        for block in edited_blocks(self.path, BLOCK):
            if len(block):
                yield block, self.placement.to_output(block.points)


@dataclass(frozen=True)
class Extent:
    """`count` points between `low` and `high` (3,), and whether their precision is known."""

    count: int
    low: np.ndarray
    high: np.ndarray
    has_sigmas: bool


def extent_of(source: CloudSource) -> Extent:
    """Raises DeliverError for a cloud without points, and WorkspaceError."""
    count, has_sigmas = 0, False
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for block, places in source.blocks():
        count += len(block)
        low, high = np.minimum(low, places.min(axis=0)), np.maximum(high, places.max(axis=0))
        has_sigmas |= bool(block.sigmas.any())
    if not count:
        raise DeliverError("The cloud has no points.", remedy="Bring points back, or run Reconstruct again.",
                             path=source.path)
    return Extent(count, low, high, has_sigmas)


def write_laz(path: Path, source: CloudSource, reporter: Reporter) -> int:
    """Write the cloud; returns its number of points. Raises DeliverError, WorkspaceError, Cancelled."""
    extent = extent_of(source)
    header = las_header(source, extent)
    done = 0
    with packed_file(path) as file, laspy.open(file, "w", header=header, do_compress=True, closefd=False) as out:
        for block, places in source.blocks():
            out.write_points(to_records(block, places, header, extent.has_sigmas))
            done += len(block)
            reporter.progress(done, extent.count)
    return extent.count


class _Listening:
    """A file that remembers what the system said of it: lazrs tells only that something failed."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.error: OSError | None = None

    def write(self, content: bytes) -> int:
        try:
            return self._file.write(content)
        except OSError as error:
            self.error = error
            raise

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


@contextmanager
def packed_file(path: Path) -> Iterator[Any]:
    """`atomic_write` for lazrs to write to. Raises WorkspaceError."""
    with atomic_write(path) as file:
        listening = _Listening(file)
        try:
            yield listening
        except lazrs.LazrsError:
            if listening.error is None:
                raise
            raise listening.error from None


def las_header(source: CloudSource, extent: Extent) -> laspy.LasHeader:
    """A header for the points of an extent."""
    header = laspy.LasHeader(version="1.4", point_format=7)
    if source.placement.unit:
        step = _STEP
    else:
        step = 10 ** np.floor(np.log10(max(float((extent.high - extent.low).max()), 1e-6) / _STEPS))
    header.scales = np.full(3, step)
    header.offsets = np.rint((extent.low + extent.high) / 2 / (_ROUND * step)) * _ROUND * step
    header.system_identifier = header.generating_software = "CU-Recon"
    header.global_encoding.wkt = True
    extra = [laspy.ExtraBytesParams("confidence", "u1", systems.CONFIDENCE),
             laspy.ExtraBytesParams("views", "u1", systems.VIEWS)]
    if extent.has_sigmas:
        extra += [laspy.ExtraBytesParams(f"sigma_{axis}", "u2", systems.SIGMA) for axis in "xyz"]
    header.add_extra_dims(extra)
    header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(systems.wkt(source.placement)))
    if source.words:
        text = "\n".join(source.words).encode()[:60_000] + b"\0"
        header.vlrs.append(laspy.VLR("LASF_Spec", 3, systems.TEXT_AREA, text))
    return header


def to_records(
    block: Cloud, places: np.ndarray, header: laspy.LasHeader, has_sigmas: bool
) -> laspy.ScaleAwarePointRecord:
    """Points at `places` (N,3) as LAS has them."""
    records = laspy.ScaleAwarePointRecord.zeros(len(block), header=header)
    records.x, records.y, records.z = places.T
    for name, values in zip(("red", "green", "blue"), block.colours.T, strict=True):
        records[name] = values.astype(np.uint16) * _FULL_COLOUR
    records["return_number"] = records["number_of_returns"] = np.ones(len(block), np.uint8)
    records["confidence"] = np.rint(np.clip(block.confidence, 0, 1) * _PERCENT).astype(np.uint8)
    records["views"] = block.views
    if has_sigmas:
        for name, values in zip("xyz", block.sigmas.T, strict=True):
            records[f"sigma_{name}"] = np.rint(np.clip(values * _MILLIMETRES, 0, 65535)).astype(np.uint16)
    return records
