# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloud as COPC 1.0: a LAZ file whose chunks are the nodes of an octree, so that a viewer loads what it shows.

A node keeps one point in each of its 128^3 cells and hands the rest down; one of few points keeps them all.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import laspy
import lazrs
import numpy as np

from ..base.files import disk_errors, scratch_folder
from ..base.messages import Reporter
from . import systems
from .laz import CloudSource, extent_of, las_header, packed_file, to_records

_CELLS = 128  # a side of a node
_BELOW_ONE = np.nextafter(np.float32(1), np.float32(0))
_LEAF = 65_536  # points that a node keeps whole
_DEEPEST = 20  # levels; points at one place would be handed down for ever
_ENTRY = struct.Struct("<4iQ2i")  # of the hierarchy: level, x, y, z, offset, bytes, points
_INFO = struct.Struct("<5d2Q2d11Q")
_EXTENDED = struct.Struct("<H16sHQ32s")  # a long record's header
_TABLE_PLACE = 8  # bytes before the first chunk: where the table of chunks is
_FIRST_RECORD = 375 + 54  # where the info record's own bytes begin: behind the header and the record's

@dataclass(frozen=True)
class _Cube:
    corner: np.ndarray
    side: float

@dataclass(frozen=True)
class _Octree:
    """`order` (N,): the points node by node; a node's `key` (4,), level first, and its `end` in that order."""

    order: np.ndarray
    keys: np.ndarray
    ends: np.ndarray

def write_copc(path: Path, source: CloudSource, reporter: Reporter) -> int:
    """Write the cloud; returns its number of points. Raises DeliverError, WorkspaceError, Cancelled."""
    extent = extent_of(source)
    header = las_header(source, extent)
    side = max(float((extent.high - extent.low).max()), 1e-6)
    header.partial_reset()  # its bounds grow with the points
    cube = _Cube((extent.low + extent.high - side) / 2, side)
    with disk_errors(path), scratch_folder(path.with_name(f"{path.name}.points")) as scratch:
        # The points as LAS has them, in a file: a large cloud's must not all be in memory.
        places = np.empty((extent.count, 3), np.float32)  # within the cube, 0 to 1
        done = 0
        with open(scratch / "records", "wb") as file:
            for block, at in source.blocks():
                packed = to_records(block, at, header, extent.has_sigmas)
                header.grow(packed)
                file.write(packed.memoryview())
                places[done : done + len(block)] = np.clip((at - cube.corner) / cube.side, 0, _BELOW_ONE)
                done += len(block)
                reporter.progress(done, 2 * extent.count)
        records = np.memmap(scratch / "records", np.uint8, "r", shape=(extent.count, header.point_format.size))
        tree = _octree(places)
        del places
        _write(path, header, cube, records, tree, reporter)
        del records
    return extent.count

def _octree(places: np.ndarray) -> _Octree:
    """The octree of places (N,3) in [0, 1)."""
    left = np.arange(len(places))
    taken, keys, counts = [], [], []
    for level in range(_DEEPEST + 1):
        cells = (places[left] * (2.0**level * _CELLS)).astype(np.int64)
        node = _packed(cells // _CELLS)
        names, first, which, sizes = _grouped(node)
        keep = sizes[which] <= (len(places) if level == _DEEPEST else _LEAF)
        sparse = np.flatnonzero(~keep)
        if len(sparse):  # the first point of each cell of the others
            cell = cells[sparse] % _CELLS
            code = which[sparse] * _CELLS**3 + (cell[:, 0] * _CELLS + cell[:, 1]) * _CELLS + cell[:, 2]
            keep[sparse[np.unique(code, return_index=True)[1]]] = True
        kept = np.flatnonzero(keep)
        kept = kept[np.argsort(which[kept], kind="stable")]
        taken.append(left[kept])
        counts.append(np.bincount(which[kept], minlength=len(names)))
        node_cells = cells[first] // _CELLS
        keys.append(np.column_stack([np.full(len(names), level), node_cells]))
        left = left[~keep]
        if not len(left):
            break
    return _Octree(np.concatenate(taken), np.concatenate(keys), np.cumsum(np.concatenate(counts)))

def _packed(cells: np.ndarray) -> np.ndarray:
    """A number for each node (N,3)."""
    packed: np.ndarray = (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]
    return packed

def _grouped(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    return np.unique(values, return_index=True, return_inverse=True, return_counts=True)

def _write(
    path: Path, header: laspy.LasHeader, cube: _Cube, records: np.memmap, tree: _Octree, reporter: Reporter
) -> None:
    vlr = lazrs.LazVlr.new_for_compression(7, header.point_format.num_extra_bytes, True)
    header.vlrs.insert(0, laspy.VLR("copc", 1, systems.COPC_INFO, bytes(_INFO.size)))
    header.vlrs.append(laspy.vlrs.known.LasZipVlr(vlr.record_data()))
    header.are_points_compressed = True
    header.number_of_evlrs = 1
    counts = np.diff(tree.ends, prepend=0).tolist()
    with packed_file(path) as file:
        header.write_to(file)
        compressor = lazrs.ParLasZipCompressor(file, vlr)
        compressor.reserve_offset_to_chunk_table()
        for start, count in zip((tree.ends - counts).tolist(), counts, strict=True):
            compressor.compress_chunks([records[tree.order[start : start + count]].tobytes()])
            reporter.progress(len(records) + start, 2 * len(records))
        compressor.done()
        header.start_of_first_evlr = file.tell()
        file.flush()
        with open(file.name, "rb") as written:  # how many bytes a chunk has, only the table at their end tells
            written.seek(header.offset_to_point_data)
            sizes = [size for _, size in lazrs.read_chunk_table(written, vlr)]
        places = header.offset_to_point_data + _TABLE_PLACE + np.cumsum([0, *sizes[:-1]])
        hierarchy = b"".join(_ENTRY.pack(*key, place, size, count) for key, place, size, count in zip(
            tree.keys.tolist(), places.tolist(), sizes, counts, strict=True))
        file.write(_EXTENDED.pack(0, b"copc", 1000, len(hierarchy), b"COPC hierarchy"))
        hierarchy_at = file.tell()
        file.write(hierarchy)
        file.seek(0)
        header.write_to(file, ensure_same_size=True)
        file.seek(_FIRST_RECORD)
        file.write(_INFO.pack(*(cube.corner + cube.side / 2), cube.side / 2, cube.side / _CELLS, hierarchy_at,
                              len(hierarchy), 0.0, 0.0, *[0] * 11))
