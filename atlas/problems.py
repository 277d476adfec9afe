# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the server refuses, and why."""

from __future__ import annotations


class Problem(Exception):
    """An answer other than the one that was asked for: `status` of HTTP, a `code` that programs and translations know
    it by, and a text that says what to do."""

    def __init__(self, status: int, code: str, said: str, **facts: object) -> None:
        super().__init__(said)
        self.status, self.code, self.said, self.facts = status, code, said, facts


def refused(said: str) -> Problem:
    """Of an upload's files."""
    return Problem(422, "refused", said)
