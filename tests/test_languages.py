# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every language says all that the code says, with the same values, and knows formatted texts again."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from curecon_blender.core.adjust import control_files
from curecon_blender.core.adjust.control import ControlSet
from curecon_blender.core.base import images
from curecon_blender.core.base import messages as messages_of_workers
from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.language import Language, Text, load, values
from curecon_blender.core.photos.find import find_photos
from curecon_blender.core.site.adjustment import Adjustment, with_length
from curecon_blender.job import duration

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "scripts"))
import messages  # noqa: E402 - a script

LANGUAGES = load()
CHINESE = LANGUAGES["zh_HANS"]
NAMES = r"\S*|JPEG|PNG|TIFF|HEIC|\S+\.(csv|jpg)|photo,name|name,x,y,z|ODM|x y z px py photo name"
ENGLISH = re.compile(r"[A-Za-z]{3,}")
PYTHONS = {"ValueError", "TypeError", "RuntimeError", "OSError", "FileNotFoundError"}  # its own, for the code around


def test_no_message_is_missing_stale_or_wrongly_formatted() -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy, which knows the names and tooltips, is not installed in this Python")
    command = [sys.executable, ROOT / "scripts" / "messages.py"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, f"{ran.stdout}\n{ran.stderr}\nAdd them: python scripts/messages.py --fill LANGUAGE"


def test_a_faulty_language_is_told() -> None:
    said = {"{} of {} photos": "{} 张照片", "Old words": "旧词", "{:,} points": "{} 个点", "At {:%H:%M}": "{0:%H}时"}
    wanted = dict.fromkeys(("{} of {} photos", "{:,} points", "Not yet", "At {:%H:%M}"), "a.py:1")
    found = messages.faults(said, wanted)
    assert [line.partition(":")[0] for line in found] == [
        "missing (a.py", "stale", "other values than the English", "other values than the English"]
    assert "Not yet" in found[0] and "Old words" in found[1] and "points" in found[3]


def test_values_may_change_their_order_and_dates_their_form() -> None:
    assert values("{} of {:,}") == values("{1:,} / {0}")
    assert values("{0.day} {0:%B %Y}") == values("{0:%Y}年{0.month}月")
    assert values("{:.1f} m") != values("{:.2f} m")


def test_what_core_raises_is_told_in_chinese(tmp_path: Path) -> None:
    folder = tmp_path / "照片"
    folder.mkdir()
    (folder / "notes.txt").write_text("x")
    text = folder / "1.jpg"
    text.write_text("no picture")
    control = tmp_path / "2.csv"
    control.write_text("? ?\n")
    for raising in (
        lambda: images.read_rgb(folder / "3.jpg"), lambda: images.read_rgb(text), lambda: find_photos(folder / "4"),
        lambda: control_files.import_files([control], ControlSet(), ()),
        lambda: with_length(Adjustment(), np.zeros(3), np.ones(3), -1.0, sigma=0.1, when=datetime.now()),
    ):
        with pytest.raises(CuReconError) as caught:
            raising()
        for sentence in (caught.value.message, caught.value.remedy):
            said = CHINESE.translated(sentence)
            assert not ENGLISH.search(re.sub(re.escape(str(tmp_path)) + NAMES, "", said)), f"{sentence} -> {said}"


def test_warnings_notes_and_names_are_found_again_with_their_values() -> None:
    for text, said in (
        ("12 of 30 photos could not be placed and are not used: a.jpg, b and c.jpg. They overlap too little with the "
         "others.", "12 / 30 张照片无法定位，未采用：a.jpg, b and c.jpg。它们与其他照片重叠太少。"),
        ("3 photos look blurred and will still be used: a, b.", "3 张照片模糊，仍会采用：a, b。"),
        ("a.jpg: The disk is full: /x/y could not be written.", "a.jpg：磁盘已满：无法写入 /x/y。"),
        ("No GPS in the photos: scale and north are unknown (set them with a scale bar); Z up comes from the drone's "
         "gimbal angles.", "照片没有 GPS：比例和北向未知（请用已知距离设定）；Z 轴向上来自无人机的云台角。"),
        ("my photo 1_T.JPG is a thermal picture beside colour photos.",
         "my photo 1_T.JPG 是与彩色照片并存的热红外图。"),
        ("What nobody translated of the photos, Put it back", "What nobody translated of the photos, Put it back"),
        ("blurred, overexposed", "模糊、曝光过度"), ("From the north-east", "自东北看"),
        (duration(3900), "1 小时 05 分钟"), (duration(30), "不到一分钟"),
        ("/home/a and b/The disk.jpg", "/home/a and b/The disk.jpg"),
    ):
        assert CHINESE.translated(text) == said


def test_a_text_of_many_parts_is_translated_at_once() -> None:
    names = ", ".join(f"DJI_{number:04}.JPG" for number in range(200))
    assert CHINESE.translated(f"Left out: {names}") == f"未采用：{names}"


def test_what_is_not_translated_yet_stays_english() -> None:
    assert Language({"Mesh": ""}).translated("Mesh") == "Mesh"


def test_a_picture_of_16_bits_is_no_word(tmp_path: Path) -> None:
    Image.new("F", (64, 64)).save(tmp_path / "a.tif")
    with pytest.raises(CuReconError) as caught:
        images.read_rgb(tmp_path / "a.tif")
    assert "浮点" in CHINESE.translated(caught.value.message)


def test_a_text_is_translated_by_its_message_and_keeps_names() -> None:
    words = Language({"{} of the {}": "{1}的 {0}", "walls": "墙面", " and ": "和", ". ": "。"})
    text = Text("{} of the {}", "walls", Text("walls"))
    assert text == "walls of the walls" and words.said(text) == "墙面的 walls"
    assert words.said(Text("{} and {}", Text("walls"), "{}")) == "墙面和{}"  # put together of what is known
    assert words.said("walls") == "walls"  # a name
    assert words.joined([Text("walls"), "x"]) == "墙面x" and Language({}).joined([text, text]) == f"{text} {text}"


def test_what_a_worker_says_keeps_its_message_and_names_on_the_way() -> None:
    photo = "No GPS in the photos.jpg"
    for text, said in (
        (Text("{} is damaged or cut short ({}).", photo, Text("the disk is full")),
         f"{photo} 损坏或不完整（磁盘已满）"),
        (Text("{} of {} photos lie far from their GPS, against a median of {:.1f} m: {}. Their GPS is wrong, or they "
              "were joined to the wrong place: check them.", np.int64(2), 30, np.float32(4.25), "a.jpg, walls"), "4.2"),
        (Text("Placement{}: {}", Text(" of part {}", 2), Text("blurred")), "定位（部分 2）：模糊"),
        (Text("{}: {}", Path("x/y.csv"), Text("Cancelled.")), "x"),
    ):
        sent = messages_of_workers.decode(messages_of_workers.encode(messages_of_workers.Warning(text=text)))
        assert isinstance(sent, messages_of_workers.Warning) and sent.text == text
        assert sent.text.message.format(*sent.text.values) == text
        assert said in CHINESE.translated(sent.text) and CHINESE.translated(sent.text) == CHINESE.translated(text)
    failed = messages_of_workers.Failure(kind="disk", message=Text("No permission to write {}.", "The disk.jpg"),
                                         remedy=Text("Cancelled."), path="/a b")
    sent = messages_of_workers.decode(messages_of_workers.encode(failed))
    assert sent == failed and "The disk.jpg" in CHINESE.translated(sent.message)


@pytest.mark.parametrize("text", ['["{} {}", "one"]', "[]", "[1]", '["{0.x}", 1]', '["{:d}", "a"]', "{}"])
def test_what_is_no_text_is_no_message(text: str) -> None:
    with pytest.raises(ValueError, match="not a worker message"):
        messages_of_workers.decode(f'{{"type": "log", "text": {text}}}')


def test_errors_and_warnings_carry_their_message_and_values() -> None:
    """What a worker tells is no f-string, of which only the English words are left."""
    found = []
    for path in sorted((ROOT / "curecon_blender" / "core").rglob("*.py")):
        if path.name == "command_line.py":  # argparse's own
            continue
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(call, ast.Call):
                continue
            name = call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")
            if name == "warning" or (name.endswith("Error") and name not in PYTHONS):
                told = [*call.args, *(keyword.value for keyword in call.keywords if keyword.arg == "remedy")]
                found += [f"{path.name}:{text.lineno}" for text in told if isinstance(text, ast.JoinedStr)]
    assert not found, f"Say it with Text(message, values): {found}"
