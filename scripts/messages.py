# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the add-on says, and which of it a language lacks.

    python scripts/messages.py                   say what is missing, stale or wrongly formatted in each language
    python scripts/messages.py --fill zh_HANS    add what is missing to the file, untranslated, and drop what is stale

A message's id is the English text as it stands in the code, with {} for each value of an f-string. Messages are found
in the syntax trees; names, tooltips and menu items of properties, operators and panels are asked of Blender, since some
are put together as the add-on starts (needs bpy).
"""

from __future__ import annotations

import argparse
import ast
import itertools
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ADDON = ROOT / "curecon_blender"
sys.path.insert(0, str(ROOT))

# For the command line, for developers, or with words of its own: the plan on paper, deliverables.
ENGLISH = {"core/compare/sheet.py", "core/plan/page.py", "core/plan/files.py", "core/deliver/systems.py",
           "core/deliver/write.py", "core/run/command_line.py", "core/base/options.py", "core/__main__.py"}
FOR_DEVELOPERS = {"diagnostics", "described"}  # functions whose text is sent to the developers
SENTENCE = re.compile(
    r"[A-Za-z]{2,}[,.:;)'\"]* +[(\"]?[A-Za-z{]|[}a-z)][.:;]? [a-z]{2,}|^ ?[A-Z][a-z]+[a-z ]*(: | \{\}|\.)"
)
CODE = re.compile(r"[A-Z_0-9]+|[a-z0-9]*[_.][a-z0-9_.]*|points3D\{\}")
NO_WORDS = re.compile(  # shaders, SQL, file formats, columns of tables, what other programs say, scripts, names of data
    r"[\n<>|\\]|^#|void main|PRAGMA|^format |^property |^comment |red green blue|\bK[ads] \d|%[sd]|^end_|^element "
    r"|sigma|ylat|xlong|easting|northing|ellipsoidh|^role type|nx ny|newmtl|map_Kd|filename|pointid|^px |^py "
    r"|^\{\} Depth from|^CU-Recon [A-Zl]|^warning: |^UTM |^Unique name|^\{\} mm$|^not a worker|^shift "
    r"|^(DJI|Autel|Parrot|Skydio) |^(ATTACH|INSERT|DELETE|SELECT) |^CU-Recon \{|\.(ttf|woff2)$"
)
# Functions that translate or show what they are given, arguments that are shown, variables that hold single words.
TRANSLATING = {"iface_", "rpt_", "n_", "pgettext_iface", "pgettext_rpt", "pgettext_n", "counted", "poll_message_set",
               "report", "paragraph", "warn", "translated"}
SHOWN = {"text", "placeholder", "remedy", "bl_label", "task", "prompts"}
WORDS = {"bl_label", "task", "prompts", "STAGE_NAMES", "SIDES", "DIRECTIONS", "problem", "lacking", "side", "up",
         "north", "scale", "gps", "chosen", "found", "missing", "remedy", "said", "points", "way", "ELLIPSOID",
         "_KNOWN_SCALES"}
NOT_SHOWN = {"print", "compile", "ArgumentParser", "add_argument", "new", "debug", "info", "_as", "Argument", "Log",
             "open", "removeprefix", "startswith", "endswith", "split", "replace"}


def messages(folder: Path = ADDON) -> dict[str, str]:
    """Each message's id, and where it stands first."""
    found: dict[str, str] = {}
    for file in sorted(folder.rglob("*.py")):
        name = file.relative_to(folder).as_posix()
        if any(name == part or name.startswith(f"{part}/") for part in ENGLISH):
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for text, line in _Texts(tree, scene=name.startswith(("scene/", "properties/"))).found:
            found.setdefault(text, f"{name}:{line}")
    return found


class _Texts(ast.NodeVisitor):
    """The texts of a file that are words for people: what is translated or shown, what an error says, and every other
    text that reads as part of a sentence. In `scene` names of Blender's data read alike, so there only the first two
    count."""

    def __init__(self, tree: ast.Module, *, scene: bool) -> None:
        self.found: list[tuple[str, int]] = []
        self._scene, self._shown = scene, False
        self.visit(tree)

    def visit_Expr(self, node: ast.Expr) -> None:
        if not isinstance(node.value, ast.Constant):  # a docstring; Blender tells those that it shows
            self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        if name in NOT_SHOWN:
            if isinstance(node.func, ast.Attribute) and isinstance(node.func.value, ast.JoinedStr):
                self.visit(node.func.value)
            return
        if name == "join" and isinstance(node.func, ast.Attribute):
            self._within(node.args, shown=self._shown)
            return
        self.visit(node.func)
        if name == "Text":  # what follows are the values
            self._within(node.args[:1], shown=True)
            self._within(node.args[1:], shown=False)
            return
        added = name == "append" and isinstance(node.func.value, ast.Name) and node.func.value.id in WORDS
        self._within(node.args, shown=added or name in TRANSLATING or name.endswith("Error"))
        for keyword in node.keywords:
            self._within([keyword.value], shown=keyword.arg in SHOWN)

    def visit_Assign(self, node: ast.Assign) -> None:
        names = {name.id for target in node.targets for name in ast.walk(target) if isinstance(name, ast.Name)}
        self._within([node.value], shown=bool(names & WORDS))
        for target in node.targets:  # row.operator("...", text="Level Floor").plane = "FLOOR"
            self.visit(target)

    def visit_For(self, node: ast.For) -> None:
        self._within([node.iter], shown=isinstance(node.target, ast.Name) and node.target.id in WORDS)
        for statement in (*node.body, *node.orelse):
            self.visit(statement)

    def visit_Yield(self, node: ast.Yield) -> None:
        if node.value is not None:
            self._within([node.value], shown=True)

    def visit_Return(self, node: ast.Return) -> None:
        if node.value is not None:  # a sentence, at least
            parts = [part for part in ast.walk(node.value) if isinstance(part, ast.expr)] if self._scene else []
            self._within([node.value], shown=any(SENTENCE.search(text) for part in parts for text in _texts(part)))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name not in FOR_DEVELOPERS:
            self.generic_visit(node)

    def visit_Assert(self, node: ast.Assert) -> None:
        pass

    def visit_Dict(self, node: ast.Dict) -> None:
        self._within([key for key in node.keys if key is not None], shown=False)
        for value in node.values:
            self.visit(value)

    def visit_comprehension(self, node: ast.comprehension) -> None:
        self._within([node.iter], shown=isinstance(node.target, ast.Name) and node.target.id in WORDS)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        self.visit(node.value)

    def visit_Compare(self, node: ast.Compare) -> None:
        pass

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str):
            self._take([node.value], node.lineno)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        self._take(list(_texts(node)), node.lineno)
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                self._within([part.value], shown=False)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        texts = list(_texts(node)) if isinstance(node.op, ast.Add) else []
        if any(text.strip("{}") for text in texts):
            self._take(texts, node.lineno)
        else:
            self.generic_visit(node)

    def _within(self, nodes: list[ast.expr], *, shown: bool) -> None:
        before, self._shown = self._shown, shown
        for node in nodes:
            self.visit(node)
        self._shown = before

    def _take(self, texts: list[str], line: int) -> None:
        for text in texts:
            read = not self._scene and SENTENCE.search(text) and not NO_WORDS.search(text)
            if (self._shown or read) and re.search(r"[A-Za-z]{2}", text) and not CODE.fullmatch(text):
                self.found.append((text, line))


def _texts(node: ast.expr) -> Iterator[str]:
    """What a text's expression may become, with {} for values."""
    match node:
        case ast.Constant(value=str() as text):
            yield text
        case ast.JoinedStr():
            parts = [[str(p.value).replace("{", "{{").replace("}", "}}")] if isinstance(p, ast.Constant)
                     else list(_texts(p.value)) if isinstance(p, ast.FormattedValue) else ["{}"] for p in node.values]
            yield from ("".join(chosen) for chosen in itertools.product(*parts))
        case ast.BinOp(op=ast.Add()):
            yield from ("".join(pair) for pair in itertools.product(_texts(node.left), _texts(node.right)))
        case ast.IfExp():
            yield from _texts(node.body)
            yield from _texts(node.orelse)
        case _:
            yield "{}"


def shown_by_blender() -> dict[str, str]:
    """The names, tooltips and items of what the add-on registers, and where each is."""
    import bpy

    import curecon_blender
    from curecon_blender import operators, panels, properties

    curecon_blender.register()
    try:
        found: dict[str, str] = {}
        for cls in (*properties.CLASSES, *operators.CLASSES, *panels.CLASSES):
            operator = getattr(cls, "bl_idname", "").partition(".")
            rna = getattr(getattr(bpy.ops, operator[0]), operator[2]).get_rna_type() if operator[2] else cls.bl_rna
            texts = [getattr(cls, "bl_label", "")]
            if hasattr(cls, "execute"):
                texts.append(getattr(cls, "bl_description", "") or cls.__doc__ or "")
            for name, value in rna.properties.items():
                if name in getattr(cls, "__annotations__", {}):
                    texts += [value.name if value.name != name else "", value.description]
                    items = value.enum_items if value.type == "ENUM" else ()
                    texts += [text for item in items for text in (item.name, item.description)]
            for text in texts:
                if re.search(r"[A-Za-z]{2}", text) and not (text.isupper() or NO_WORDS.match(text)):
                    found.setdefault(text, cls.__name__)
        return found
    finally:
        curecon_blender.unregister()


def faults(translations: dict[str, str], wanted: dict[str, str]) -> list[str]:
    """What is wrong with a language, a line each."""
    from curecon_blender.core.base.language import values

    lines = [f"missing ({where}): {text!r}" for text, where in wanted.items() if not translations.get(text)]
    lines += [f"stale: {text!r}" for text in translations if text not in wanted]
    return lines + [f"other values than the English: {text!r}: {words!r}" for text, words in translations.items()
                    if words and values(words) != values(text)]


def everything() -> dict[str, str]:
    from curecon_blender.core.base.language import JOINTS

    return shown_by_blender() | messages() | dict.fromkeys(JOINTS, "core/base/language.py")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fill", metavar="LANGUAGE")
    chosen = parser.parse_args()
    wanted = everything()
    files = sorted((ADDON / "languages").glob("*.json"))
    if chosen.fill:
        files = [ADDON / "languages" / f"{chosen.fill}.json"]
        held = json.loads(files[0].read_text(encoding="utf-8")) if files[0].is_file() else {}
        filled = {text: held.get(text, "") for text in sorted(wanted)}
        files[0].write_text(json.dumps(filled, ensure_ascii=False, indent=0) + "\n", encoding="utf-8")
    found = [f"{file.stem}: {line}" for file in files
             for line in faults(json.loads(file.read_text(encoding="utf-8")), wanted)]
    print("\n".join([*found, f"{len(wanted)} messages, {len(found)} faults"]))
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
