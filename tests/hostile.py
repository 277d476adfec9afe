# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tests of hostile files share."""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from curecon_blender.core.base.errors import CuReconError

HUGE = struct.pack("<Q", 1 << 40)


class Harm:
    """What a pickle would run."""

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, ("harmed",)


def refused(kind: type[CuReconError], path: Path, read: Callable[[], object]) -> CuReconError:
    """The reader raises `kind`, which names the file and says what to do, and asks for little memory and time."""
    started = time.process_time()
    with pytest.raises(kind) as caught:
        read()
    assert path.name in str(caught.value) and caught.value.remedy
    assert time.process_time() - started < 5
    return caught.value


def change(path: Path, *keys: Any, value: Any) -> None:
    """Give one place in a JSON file another value."""
    content = json.loads(path.read_text())
    holder = content
    for key in keys[:-1]:
        holder = holder[key]
    holder[keys[-1]] = value
    path.write_text(json.dumps(content))
