# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors for people: what happened, to which file, what to do next; each kind has its exit code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .language import Text


class CuReconError(Exception):
    """Base of every error that a user can do something about.

    `str(error)` says what happened (and to which file); `remedy` says what to do next. Both are
    Texts, to be translated.
    """

    exit_code = 1
    kind = "error"

    def __init__(self, message: str, *, remedy: str, path: Path | str | None = None) -> None:
        super().__init__(message)
        self.message = Text(message)
        self.remedy = Text(remedy)
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


class OutOfMemory(CuReconError):
    """A stage needed more memory than the computer, or its graphics card, could give."""

    exit_code = 11
    kind = "memory"

    def __init__(self) -> None:
        super().__init__(
            "The computer ran out of memory.",
            remedy="Close other programs, set a smaller memory budget in the preferences (--memory), or choose a lower "
            "quality. Then run it again: it goes on from the last finished photo.",
        )


class SetupError(CuReconError):
    """The Python that should do the work lacks a library."""

    exit_code = 9
    kind = "setup"


class SurfaceError(CuReconError):
    """No mesh can be made of a cloud, or no texture of a mesh."""

    exit_code = 10
    kind = "surface"


class ControlError(CuReconError):
    """Control points cannot be used: a file that cannot be read, or points and marks that cannot belong to the site."""

    exit_code = 12
    kind = "control"


class PlanError(CuReconError):
    """No flight can be planned: an outline that is no area, a ceiling without room, a battery that does not reach."""

    exit_code = 14
    kind = "plan"


# The many ways in which libraries say that memory could not be had; "primitive" is oneDNN's, whose code needs some too.
NO_MEMORY = re.compile(
    r"out of memory|allocate memory|failed to allocate|insufficient memory|not enough memory|bad_alloc"
    r"|start new thread|thread creation failed|resource temporarily unavailable|failed to map segment"
    r"|could not (create|execute) a (primitive|memory)", re.IGNORECASE
)


def ran_out_of_memory(error: Exception) -> bool:
    """Whether an error says that memory could not be had."""
    return isinstance(error, MemoryError) or (
        not isinstance(error, CuReconError) and NO_MEMORY.search(str(error)) is not None
    )


class Cancelled(CuReconError):
    """The user cancelled; finished work is kept and the job can go on later."""

    exit_code = 130
    kind = "cancelled"

    def __init__(self) -> None:
        super().__init__("Cancelled.", remedy="Run it again: it goes on where it stopped.")
