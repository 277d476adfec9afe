# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what is linked from another .blend may be changed: Blender takes such a change and forgets it when it saves,
so every writer asks here first."""

from __future__ import annotations

from collections.abc import Iterable

import bpy

from ..core.base.errors import CuReconError
from ..core.base.language import Text


class LinkedError(CuReconError):
    """What should be changed belongs to another .blend."""

    kind = "linked"


def require(blocks: Iterable[bpy.types.ID | None]) -> None:
    """Raises LinkedError where one of them, or what it overrides, is linked from another .blend."""
    for block in blocks:
        if block is None:
            continue
        override = block.override_library
        library = block.library or (override.reference.library if override is not None and override.reference else None)
        if library is not None:
            raise LinkedError(
                Text("{} is linked from {}: a change would be lost, and nothing was changed.", block.name,
                     library.filepath),
                remedy="Open that .blend and do it there, or make it local first (Object > Relations > Make Local).",
                path=library.filepath,
            )
