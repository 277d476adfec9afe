# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors for people: what happened, to which file, what to do next; each kind has its exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Any


class CuReconError(Exception):
    """Base of every error that a user can do something about.

    `str(error)` says what happened (and to which file); `remedy` says what to do next.
    """

    exit_code = 1
    kind = "error"

    def __init__(self, message: str, *, remedy: str, path: Path | str | None = None) -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy
        self.path = None if path is None else str(path)

    def __reduce__(self) -> tuple[Any, ...]:  # pickled by its fields: its arguments are not all positional
        return type(self).__new__, (type(self), *self.args), self.__dict__


class PhotoError(CuReconError):
    """The photos cannot be used: none, too few, unreadable, wrong folder."""

    exit_code = 3
    kind = "photos"


class SparseError(CuReconError):
    """The cameras could not be found: the photos do not overlap, or a given model does not fit them."""

    exit_code = 4
    kind = "sparse"


class WorkspaceError(CuReconError):
    """The workspace cannot be used: read-only, full, in use by another job, made by a newer version, damaged."""

    exit_code = 5
    kind = "workspace"


class WeightsError(CuReconError):
    """The network's weights are missing, corrupted or of another network."""

    exit_code = 6
    kind = "weights"


class DeviceError(CuReconError):
    """The chosen device is not there, or its memory budget is too small for one tile."""

    exit_code = 7
    kind = "device"


class SetupError(CuReconError):
    """The Python that should do the work lacks a library."""

    exit_code = 9
    kind = "setup"


class SurfaceError(CuReconError):
    """No mesh can be made of a cloud, or no texture of a mesh."""

    exit_code = 10
    kind = "surface"


class Cancelled(CuReconError):
    """The user cancelled; finished work is kept and the job can go on later."""

    exit_code = 130
    kind = "cancelled"

    def __init__(self) -> None:
        super().__init__("Cancelled.", remedy="Run it again to go on from the last finished photo.")
