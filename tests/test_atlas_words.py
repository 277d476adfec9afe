# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What an atlas refuses is said in Chinese to whom asks so, and its pages say all that they say in both languages."""

from __future__ import annotations

import ast
import io
import json
import re
from collections.abc import Iterator

import pytest
from atlas_run import PASSWORD, Asker, Atlas
from conftest import ROOT
from PIL import Image

from atlas import problems
from curecon_blender.core.base.language import load, values

ATLAS = ROOT / "atlas"
CONSOLE = {"__main__.py", "backup.py", "configuration.py", "local.py"}  # for the machine's owner, in English
CHINESE = json.loads((problems.LANGUAGES / "zh_HANS.json").read_text())
FIELDS = {"title", "text", "place", "credit", "licence", "tags", "register", "latitude", "longitude", "period_from",
          "period_to", "exact", "why", "label"}  # that a refusal may name
STATES = {"accepted", "refused", "withdrawn", "removed"}
NAMES = re.compile(r"site\.json|JSON|GLB|JPEG|EXIF|XMP|IPTC|SHA-256|U\+[0-9A-F]{4}|MB|[\w/]+\.(jpg|glb)|'[^']*'")


def _said(node: ast.expr) -> Iterator[str]:
    """The messages that an argument may be. A test fails where one cannot be told from the code."""
    match node:
        case ast.Constant(value=str() as text):
            yield text
        case ast.IfExp():
            yield from (*_said(node.body), *_said(node.orelse))
        case ast.Call(func=ast.Name(id="Text" | "why")) | ast.Name(id="said"):
            return  # a Text is found by itself
        case _:
            raise AssertionError(f"a refusal that nobody can translate: {ast.unparse(node)}")


def _messages() -> dict[str, str]:
    found = {}
    for file in sorted(ATLAS.glob("*.py")):
        if file.name in CONSOLE:
            continue
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                at = {"Problem": 2, "refused": 0, "ValueError": 0, "Text": 0}.get(node.func.id)
                if at is None or (node.func.id == "Text" and not isinstance(node.args[0], ast.Constant)):
                    continue
                found.update(dict.fromkeys(_said(node.args[at]), f"{file.name}:{node.lineno}"))
    return found


def test_every_refusal_has_words_in_both_languages() -> None:
    wanted, known = _messages(), load()["zh_HANS"].words
    assert len(wanted) > 100
    missing = {text: where for text, where in wanted.items() if not CHINESE.get(text) and not known.get(text)}
    assert not missing
    assert not set(CHINESE) - set(wanted) - FIELDS - STATES
    for text, said in CHINESE.items():
        assert values(text) == values(said), text


def test_the_desk_says_the_same_things_in_both_languages() -> None:
    words = (ATLAS / "desk" / "words.js").read_text()
    english, chinese = ({name: text.count("{}") for name, text in re.findall(r'(\w+): "((?:[^"\\]|\\.)*)"', part)}
                        for part in words.split("zh: {"))
    assert len(english) > 80 and english == chinese
    code = "".join((ATLAS / "desk" / name).read_text() for name in ("desk.js", "asking.js", "sending.js", "index.html"))
    states = {"held", "accepted", "refused", "withdrawn", "removed", "public"}
    assert not {name for name in english if not re.search(rf'["\'#]{name}["\']', code)
                and not name.startswith("did_")} - states
    server = "".join(file.read_text() for file in ATLAS.glob("*.py"))
    done = set(re.findall(r'note\(\s*transaction, [\w.]+, "(\w+)"', server)) | {"accepted", "refused"}
    assert {f"did_{action}" for action in done} == {name for name in english if name.startswith("did_")}


@pytest.fixture
def chinese(atlas: Atlas, contributor: Asker) -> Asker:
    class Speaking(Asker):
        def ask(self, *given: object, **more: object):  # type: ignore[no-untyped-def]
            return super().ask(*given, **{"Accept_Language": "zh-Hans", **more})  # type: ignore[arg-type]

    return Speaking(atlas.port, contributor.cookie, contributor.guard)


def _in_chinese(said: str) -> str:
    assert re.search("[\u4e00-\u9fff]", said) and not re.search("[A-Za-z]{2,}", NAMES.sub("", said)), said
    return said


def test_refusals_are_chinese_for_whom_asks_so(
    atlas: Atlas, chinese: Asker, moderator: Asker, titled: dict[str, bytes]
) -> None:
    wrong = {"name": "Conrad", "password": "no password at all"}
    assert atlas.visitor.ask("POST", "/api/session", wrong).said["said"] == "The name or the password is wrong."
    answer = chinese.ask("POST", "/api/session", wrong)
    assert answer.said["code"] == "sign_in" and answer.headers["content-language"] == "zh-HANS"
    assert _in_chinese(answer.said["said"]) == "名称或密码错误。"
    token = {"token": "x", "name": "A B", "password": PASSWORD}
    for method, path, value in (
        ("POST", "/api/join", token), ("POST", "/api/join", {**token, "name": "<b>"}),
        ("POST", "/api/join", {**token, "password": "short"}), ("GET", "/api/held", None),
        ("POST", "/api/versions/x/accept", {}), ("DELETE", "/api/versions/x", None), ("GET", "/api/uploads/x", None),
        ("POST", "/api/sites/x/remove", {"why": ""}), ("POST", "/api/sites/x/remove", {"why": "x" * 3000}),
        ("POST", "/api/tokens", {"label": "a\u202eb"}),
        ("GET", "/api/search?from=a1", None), ("POST", "/api/password", {"old": PASSWORD, "new": "x"}),
    ):
        answer = chinese.ask(method, path, value)
        assert answer.status >= 400
        _in_chinese(answer.said["said"])
    record = json.loads(titled["site.json"])
    told = io.BytesIO()
    Image.new("RGB", (64, 48)).save(told, "JPEG", comment=b"24.65 117.05")
    tile = titled["surface/0.glb"]
    for changed, said in (
        ({"site.json": json.dumps({**record, "title": "a\u202eb"}).encode()}, "标题：含不可见字符 U+202E"),
        ({"site.json": json.dumps({**record, "text": "x" * 6000}).encode()}, "说明：6000 个字符；最多 5000 个"),
        ({"site.json": json.dumps({**record, "evil": 1}).encode()}, "未知字段 'evil'"),
        ({"site.json": b"{"}, "不是 JSON"), ({"thumbnail.jpg": told.getvalue()}, "带有注释，可能透露位置"),
        ({"surface/0.glb": tile[:-4]}, "surface/0.glb"), ({"pictures/1.jpg": tile}, "遗址没有提到的文件"),
        ({"surface/0.glb": tile + bytes(17_000_000)}, "最多 16.8 MB"), ({"index.html": b"x"}, "不是已发布遗址的文件"),
    ):
        assert said in _in_chinese(chinese.upload({**titled, **changed}).said["said"])
    assert "结束年份" in _in_chinese(chinese.begin(titled, period_from=5).said["said"])
    doubted = json.dumps({**record, "text": "24.658307, 117.052089"}).encode()
    version = chinese.upload({**titled, "site.json": doubted}).said["version"]
    speaking = type(chinese)(atlas.port, moderator.cookie, moderator.guard)
    (held,) = [one for one in speaking.ask("GET", "/api/held").said["held"] if one["id"] == version]
    assert held["doubts"] == ["说明中是否有坐标？"]
    assert moderator.ask("POST", f"/api/versions/{version}/refuse", {"why": "x"}).status == 200
    assert _in_chinese(NAMES.sub("", speaking.ask("POST", f"/api/versions/{version}/accept", {}).said["said"])
                       .replace("Moira", "")) == "此版本已由  拒绝。"
