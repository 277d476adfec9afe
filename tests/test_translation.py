# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on says can be translated: no sentence of the interface is put together before it could be looked up."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ADDON = Path(__file__).resolve().parent.parent / "curecon_blender"
FILES = sorted([*(ADDON / "operators").glob("*.py"), *(ADDON / "panels").glob("*.py")])
WORDS = re.compile(r"[A-Za-z]{2,}[,.:;]? |[,.:;]? [A-Za-z]{2,}")
UNITS = {" GiB", " MiB"}
ENGLISH = {"diagnostics", "described"}  # text to send to the developers


def assembled(file: Path) -> list[str]:
    """The f-strings of a file with words of a sentence in them, but for what the console or an error says."""
    found = []

    class Visitor(ast.NodeVisitor):
        def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
            if node.name not in ENGLISH:
                self.generic_visit(node)

        def visit_Call(self, node: ast.Call) -> None:
            name = node.func.id if isinstance(node.func, ast.Name) else ""
            if name != "print" and not name.endswith("Error"):
                self.generic_visit(node)

        def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
            literals = [part.value for part in node.values if isinstance(part, ast.Constant)]
            if any(WORDS.search(text) for text in literals if text not in UNITS):
                found.append(f"{file.name}:{node.lineno} {ast.unparse(node)}")

    Visitor().visit(ast.parse(file.read_text(encoding="utf-8")))
    return found


@pytest.mark.parametrize("file", FILES, ids=lambda file: f"{file.parent.name}/{file.name}")
def test_no_sentence_is_put_together_before_it_is_translated(file: Path) -> None:
    assert not assembled(file), "use pgettext_iface or pgettext_rpt of a plain text, then .format"
