# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The house keeps its order: a room imports what stands above it, nothing goes in circles, nothing grows too long."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from conftest import ROOT

PACKAGE = "curecon_blender"
FLOW = ("base", "photos", "sparse", "adjust", "views", "network", "depth", "cloud", "surface", "texture",
        "report", "deliver", "publish", "compare")
MAY_IMPORT = {room: FLOW[: place + 1] for place, room in enumerate(FLOW)}
MAY_IMPORT |= {room: ("base", room) for room in ("site", "present", "plan")}
MAY_IMPORT |= {"run": (*FLOW, "site", "plan", "run")}
MOST_LINES, MOST_FUNCTION_LINES = 400, 60
# In Blender's own process there are Blender's Python and NumPy; these are the worker's.
WORKER_ONLY = ("torch", "cv2", "pycolmap", "scipy", "PIL", "pillow_heif", "rawpy", "psutil", "numba", "xatlas",
               "fast_simplification", "safetensors", "distributed", "reportlab", "laspy", "lazrs")


@cache
def modules() -> dict[str, Path]:
    """Every module of the package by its dotted name."""
    found = {}
    for file in sorted((ROOT / PACKAGE).rglob("*.py")):
        parts = file.relative_to(ROOT).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    return found


@cache
def imports(name: str) -> tuple[str, ...]:
    """The package's own modules that a module imports anywhere in it, but for types alone."""
    file = modules()[name]
    package = name if file.name == "__init__.py" else name.rpartition(".")[0]
    found = set()
    for node in _run_time(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            source = ".".join([*above, *([node.module] if node.module else [])])
            # What is imported from a package may be one of its modules.
            found |= {f"{source}.{alias.name}" if f"{source}.{alias.name}" in modules() else source
                      for alias in node.names}
    return tuple(sorted(found & modules().keys() - {name}))


def _run_time(tree: ast.AST) -> Iterator[ast.AST]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        yield from _run_time(node)


def room_of(name: str) -> str | None:
    parts = name.split(".")
    return parts[2] if len(parts) > 2 and parts[1] == "core" and parts[2] != "__main__" else None


def test_a_room_imports_what_stands_above_it_and_nothing_else() -> None:
    wrong = [
        f"{name} imports {other}" for name in modules() if (room := room_of(name))
        for other in imports(name)
        if other != f"{PACKAGE}.core" and (room_of(other) is None or room_of(other) not in MAY_IMPORT[room])
    ]
    assert not wrong, "\n".join(wrong)


def test_no_module_imports_itself_by_way_of_others() -> None:
    done: set[str] = set()

    def visit(name: str, way: tuple[str, ...]) -> list[str]:
        if name in way:
            return [" -> ".join([*way[way.index(name):], name])]
        if name in done:
            return []
        circles = [circle for other in imports(name) for circle in visit(other, (*way, name))]
        done.add(name)
        return circles

    circles = [circle for name in modules() for circle in visit(name, ())]
    assert not circles, "\n".join(circles)


def _import_all(names: list[str], *, without: tuple[str, ...]) -> None:
    program = (f"import sys, importlib\nsys.modules.update(dict.fromkeys({without!r}))\n"
               f"for name in {names!r}: importlib.import_module(name)")
    ran = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_every_core_module_imports_without_blender() -> None:
    names = [name for name in modules() if name.startswith(f"{PACKAGE}.core")]
    assert len(names) > 50
    _import_all([*names, f"{PACKAGE}.job"], without=("bpy",))


def test_what_blender_imports_of_core_needs_numpy_alone() -> None:
    used = sorted({other for name in modules() if not name.startswith(f"{PACKAGE}.core")
                   for other in imports(name) if other.startswith(f"{PACKAGE}.core")})
    assert f"{PACKAGE}.core.cloud.ply" in used
    _import_all(used, without=("bpy", *WORKER_ONLY))


@pytest.mark.parametrize("kind", ["files", "functions"])
def test_nothing_grows_too_long_without_a_reason(kind: str) -> None:
    """The reason is a comment that begins with "Long:", in the file, or on the line above a function."""
    long = []
    for name, file in modules().items():
        lines = file.read_text(encoding="utf-8").splitlines()
        if kind == "files":
            if len(lines) > MOST_LINES and not any(line.startswith("# Long:") for line in lines):
                long.append(f"{name}: {len(lines)} lines")
            continue
        for node in ast.walk(ast.parse("\n".join(lines))):
            if isinstance(node, ast.FunctionDef):
                length = (node.end_lineno or 0) - node.lineno + 1
                first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
                if length > MOST_FUNCTION_LINES and not lines[max(first - 2, 0)].lstrip().startswith("# Long:"):
                    long.append(f"{name}.{node.name}: {length} lines")
    assert not long, "\n".join(long)
