# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The cloud as E57 (ASTM E2807), by pye57, which is an optional library: requirements-e57.txt."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import SetupError, WorkspaceError
from ..base.files import disk_errors, partial_path
from ..base.language import Text
from ..base.messages import Reporter
from . import systems
from .laz import CloudSource, extent_of

_SCAN = 1 << 24  # points of one scan: all of its arrays are in memory at once
_POINT_BYTES = 20  # that a point takes in the file, at most


def write_e57(path: Path, source: CloudSource, reporter: Reporter) -> int:
    """Write the cloud, with the match's confidence as intensity; returns its number of points. Raises SetupError where
    pye57 is missing, DeliverError, WorkspaceError, Cancelled."""
    try:
        from pye57 import libe57
    except ImportError as error:
        raise SetupError(
            "E57 needs the library pye57, which this Python does not have.",
            remedy="Choose LAZ; or install it in the Worker Python: python -m pip install pye57",
        ) from error
    extent = extent_of(source)
    # The library tells of a full disk by its own errors, without the system's; so room is asked for first.
    need = extent.count * _POINT_BYTES
    partial = partial_path(path)
    with disk_errors(path):
        if shutil.disk_usage(path.parent).free < need:
            raise WorkspaceError(Text("The disk of {} has no room for an E57 of {:.0f} MB.", path.parent, need / 2**20),
                                 remedy="Free some space, or choose LAZ, which is a third as large.", path=path)
        try:
            _write_scans(partial, source, np.floor((extent.low + extent.high) / 2), extent.count, reporter)
            os.replace(partial, path)
        except libe57.E57Exception as error:
            raise WorkspaceError(
                Text("{} could not be written ({}).", path, Text(str(error).splitlines()[0])), path=path,
                remedy="Check the disk's free space and the folder's permissions, then export again.",
            ) from error
        finally:
            partial.unlink(missing_ok=True)
    return extent.count


def _write_scans(path: Path, source: CloudSource, origin: np.ndarray, count: int, reporter: Reporter) -> None:
    """In scans of at most _SCAN points. Coordinates are single precision about `origin` (3,), which is the scans'
    place."""
    done = scans = 0
    held: list[dict[str, np.ndarray]] = []
    file = _open(path, source)
    try:
        for block, places in source.blocks():
            held.append(_fields(block.colours, block.confidence, places - origin))
            done += len(block)
            reporter.progress(done, count)
            if done == count or sum(len(part["intensity"]) for part in held) >= _SCAN:
                scans += 1
                joined = {name: np.concatenate([part[name] for part in held]) for name in held[0]}
                file.write_scan_raw(joined, name=f"cloud_{scans}", translation=origin)
                held = []
    finally:
        file.close()


def _fields(colours: np.ndarray, confidence: np.ndarray, places: np.ndarray) -> dict[str, np.ndarray]:
    fields = {f"cartesian{axis}": places[:, number].astype(np.float32) for number, axis in enumerate("XYZ")}
    fields |= {f"color{name}": colours[:, number] for number, name in enumerate(("Red", "Green", "Blue"))}
    return fields | {"intensity": confidence}


def _open(path: Path, source: CloudSource) -> Any:
    """A new file whose metadata say what its coordinates are: pye57's own header leaves that empty, and nothing in a
    file can be set twice."""
    import pye57
    from pye57 import libe57

    class File(pye57.E57):
        def write_default_header(self) -> None:
            image, root = self.image_file, self.root
            image.extensionsAdd("", libe57.E57_V1_0_URI)
            for name, text in (("formatName", systems.E57_NAME), ("guid", "{CU-Recon}"),
                               ("e57LibraryVersion", libe57.E57_LIBRARY_ID),
                               ("coordinateMetadata", systems.wkt(source.placement))):
                root.set(name, libe57.StringNode(image, text))
            root.set("versionMajor", libe57.IntegerNode(image, libe57.E57_FORMAT_MAJOR))
            root.set("versionMinor", libe57.IntegerNode(image, libe57.E57_FORMAT_MINOR))
            for name in ("data3D", "images2D"):
                root.set(name, libe57.VectorNode(image, True))

    return File(str(path), mode="w")
