# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact places of vulnerable sites, sealed by AES-GCM with the key of the configuration: who steals the database alone
cannot read them."""

from __future__ import annotations

import base64
import json
import os
from typing import Any

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from .problems import Problem

_NONCE = 12  # bytes
_LENGTH = 96  # letters of every place, so that a sealed one's length tells nothing


def seal(key: bytes, place: dict[str, float]) -> str:
    nonce = os.urandom(_NONCE)
    return base64.b64encode(
        nonce + AESGCM(key).encrypt(nonce, json.dumps(place).ljust(_LENGTH).encode(), None)
    ).decode()


def opened(key: bytes | None, sealed: str) -> dict[str, Any]:
    """Raises Problem where the key is not the one that it was sealed with."""
    data = base64.b64decode(sealed)
    try:
        found: dict[str, Any] = json.loads(AESGCM(key or b"\0" * 32).decrypt(data[:_NONCE], data[_NONCE:], None))
    except (InvalidTag, ValueError) as error:
        raise Problem(500, "key", "This place was sealed with another key than the configuration's.") from error
    return found
