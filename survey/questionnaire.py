# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The questionnaire as one HTML page with its pictures in it, in English and Chinese; it needs no network.

    python -m survey.questionnaire --out page.html --title "Zhenchenglou" --title-zh "振成楼" --contact "a@b.org"
        --result "CU-Recon" ours_1.png ours_2.png --result "Program B" b_1.png b_2.png [--post ADDRESS]

A result is shown by pictures, or by those of a published site: the folder sites/NAME that `publish` writes. The
page asks for consent first, shows the results without their names in an order of chance, and saves one CSV file an
answer, for `python -m survey`; with --post it sends it to an atlas (`python -m atlas survey`), and saves it where that
does not answer.
"""

from __future__ import annotations

import argparse
import base64
import io
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import urlsplit

from PIL import Image

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.files import atomic_write
from curecon_blender.core.base.images import read_rgb
from curecon_blender.core.base.reading import read_json

from .answers import SurveyError
from .items import LEAST, QUESTIONS, RATINGS, SCALE, Words

TEMPLATE = Path(__file__).with_name("page.html")
MOST_RESULTS, MOST_PIXELS = 6, 1400  # of a picture's longest side
_JPEG = 88


@dataclass(frozen=True)
class Result:
    """A reconstruction to be judged, by pictures of it. All results should have the same views."""

    name: str
    pictures: tuple[Path, ...]


def write_page(path: Path, results: Sequence[Result], title: Words, contact: str, post: str = "") -> None:
    """Write the page; `post` is the address that answers are sent to. Raises SurveyError, PhotoError for a picture,
    WorkspaceError."""
    names = [result.name.strip() for result in results]
    if not 1 <= len(results) <= MOST_RESULTS or len(set(names)) < len(names) or not all(names):
        raise SurveyError(f"A questionnaire needs one to {MOST_RESULTS} results, each with a name of its own.",
                          remedy="Give --result NAME PICTURE ... for each.")
    if ":" in "".join(names) or "：" in "".join(names):
        raise SurveyError("A result's name cannot hold a colon: it parts name and item in the answers.",
                          remedy="Write the name without it.")
    if len({len(result.pictures) for result in results}) > 1:
        raise SurveyError("The results have different numbers of pictures, so that one of them would be shown better.",
                          remedy="Give each the same views.")
    survey = {
        "words": {key: asdict(words) for key, words in _words(title, contact, post).items()},
        "least": LEAST, "post": post,
        "scale": [asdict(words) for words in SCALE],
        "ratings": [asdict(one) for one in RATINGS], "questions": [asdict(one) for one in QUESTIONS],
        "results": [{"name": name, "pictures": [_embedded(picture) for picture in result.pictures]}
                    for name, result in zip(names, results, strict=True)],
    }
    content = json.dumps(survey, ensure_ascii=False).replace("<", "\\u003c")  # a name cannot end the script
    with atomic_write(path) as file:
        file.write(TEMPLATE.read_text(encoding="utf-8").replace("@SURVEY@", content).encode("utf-8"))


def _embedded(picture: Path) -> str:
    out = io.BytesIO()
    Image.fromarray(read_rgb(picture, MOST_PIXELS)).save(out, "JPEG", quality=_JPEG)
    return "data:image/jpeg;base64," + base64.b64encode(out.getvalue()).decode("ascii")


def published_pictures(site: Path) -> tuple[Path, ...]:
    """The pictures of a published site's folder. Raises SurveyError where it has none."""
    try:
        pictures = tuple(site / str(name) for name in read_json(site / "site.json")["pictures"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SurveyError(f"{site} is no published site ({error}).", path=site,
                          remedy="Give a folder of sites/ that Publish Web Pages wrote, or pictures.") from error
    if not pictures or any(not one.resolve().is_relative_to(site.resolve()) for one in pictures):
        raise SurveyError(f"{site} has no pictures.", path=site,
                          remedy="Render stills under Present, and publish the site again.")
    return pictures


def _words(title: Words, contact: str, post: str) -> dict[str, Words]:
    kept = Words("sends nothing: at the end it saves a file on your device, which you pass on yourself",
                 "也不发送任何数据：最后会在您的设备上保存一个文件，由您自行转交")
    if post:
        host = urlsplit(post).netloc
        kept = Words(f"sends your answer, when you save it, to {host}", f"在您保存答案时将其发送至{host}")
    return {
        "title": title,
        "about": Words(
            "You will see pictures of several 3D reconstructions of one building and say how well each shows it. This "
            "takes five to ten minutes. You may stop at any time.",
            "您将看到同一建筑的几个三维重建结果的图片，并评价每个结果的好坏。大约需要五到十分钟。您可以随时停止。"),
        "data": Words(
            "The page keeps your ratings, a few groups that you need not tell (such as an age group), and the "
            f"time taken. It asks for no name and {kept.en}. The answers are used for statistics only. Contact: "
            f"{contact}",
            f"本页记录您的评分、几项可不透露的分组信息（如年龄段）以及用时。不询问姓名，{kept.zh}。"
            f"答案仅用于统计。联系方式：{contact}"),
        "agree": Words("I have read this, I am 18 or older, and I agree to take part.",
                       "我已阅读以上内容，年满18岁，并同意参加。"),
        "begin": Words("Begin", "开始"),
        "you": Words("About you", "关于您"),
        "unknown": Words("cannot tell", "无法判断"),
        "unsaid": Words("rather not say", "不愿透露"),
        "open": Words("Please answer what is marked.", "请回答标出的问题。"),
        "save": Words("Save my answer", "保存我的答案"),
        "sent": Words("Thank you. Your answer has arrived.", "谢谢！您的答案已收到。"),
        "thanks": Words(
            "Thank you. Your answer was saved as a file; please send it to us. If none came, send this text:",
            "谢谢！您的答案已保存为文件，请将其发送给邀请您的人。如未出现文件，请发送以下文字："),
    }


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m survey.questionnaire", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("questionnaire.html"))
    parser.add_argument("--title", default="How good are these reconstructions?")
    parser.add_argument("--title-zh", default="这些重建结果怎么样？")
    parser.add_argument("--contact", required=True, help="whom people may ask, and send their answers to")
    parser.add_argument("--result", nargs="+", action="append", required=True, metavar=("NAME", "PICTURE"),
                        help="its name, and pictures or the folder of a published site")
    parser.add_argument("--post", default="", metavar="ADDRESS", help="where answers are sent to: that of an atlas")
    given = parser.parse_args(arguments)
    try:
        results = [Result(name, tuple(picture for path in map(Path, paths)
                                      for picture in (published_pictures(path) if path.is_dir() else (path,))))
                   for name, *paths in given.result]
        write_page(given.out, results, Words(given.title, given.title_zh), given.contact, given.post)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    print(given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
