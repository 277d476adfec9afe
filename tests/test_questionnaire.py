# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The questionnaire is one page that needs nothing else, asks for consent first, and saves what the statistics read."""

from __future__ import annotations

import html
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from survey.answers import SurveyError, leave_out, read_answers
from survey.items import RATINGS, Words
from survey.questionnaire import Result, main, write_page
from survey.sections import column

# A person who agrees, rates every second result's items 5 and the others 2, and tells a few groups.
# A browser without a window waits for ever for a download, so none begins.
PERSON = """<script>
let offered = "";
HTMLAnchorElement.prototype.click = function () { offered = this.download; };
const shown = [...document.querySelectorAll("#consent [lang=en]")].map(one => one.textContent).join(" ");
const early = document.getElementById("form").hidden && document.getElementById("begin").disabled;
document.getElementById("agree").click();
document.getElementById("begin").click();
document.querySelector("form button").click();
const asked = document.querySelectorAll(".open").length;
for (const set of document.querySelectorAll("fieldset")) {
  const place = set.id.split(":")[0], options = [...set.querySelectorAll("input")];
  (place === "0" ? options[4] : place === "1" ? options[1] : options[0]).click();
}
document.querySelector("form button").click();
const found = document.createElement("pre");
found.id = "found";
found.textContent = [early, asked, offered, document.getElementById("row").value].join("\\n");
document.body.append(found);
</script></html>"""


@pytest.fixture
def page(tmp_path: Path) -> Path:
    Image.fromarray(np.full((40, 60, 3), 120, np.uint8)).save(tmp_path / "a.png")
    results = [Result(name, (tmp_path / "a.png",)) for name in ("CU-Recon", 'B, "beta" </script>')]
    write_page(tmp_path / "page.html", results, Words("Zhenchenglou", "振成楼"), "a@b.org")
    return tmp_path / "page.html"


def test_the_page_stands_alone_and_speaks_both_languages(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not re.search(r"(src|href)=[\"']?(https?:)?//|https?://", text)
    assert text.count("</script>") == 2 and "data:image/jpeg;base64," in text
    assert "strongly agree" in text and "非常同意" in text and "a@b.org" in text


def test_an_answer_given_in_a_browser_is_what_the_statistics_read(page: Path, tmp_path: Path) -> None:
    chromium = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        pytest.skip("NOT TESTED in a browser: no chromium; apt-get install chromium, or set CHROMIUM")
    page.write_text(page.read_text(encoding="utf-8").replace("</html>", PERSON), encoding="utf-8")
    ran = subprocess.run(
        [chromium, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
         f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()],
        capture_output=True, text=True, timeout=60, check=False)
    found = re.search(r'<pre id="found">(.*?)</pre>', ran.stdout, re.DOTALL)
    assert found, ran.stderr[-2000:]
    early, asked, offered, *rows = html.unescape(found[1]).split("\n")
    assert early == "true", "the form was there before the consent"
    assert int(asked) == 2 * len(RATINGS) + 5, "what was left open was not asked for"
    assert re.fullmatch(r"answer-[0-9a-f]{12}\.csv", offered), "the answer is not offered as a file"
    (tmp_path / "answer.csv").write_text("\n".join(rows), encoding="utf-8-sig")
    answers = read_answers([tmp_path / "answer.csv"])
    assert set(answers.results) == {"CU-Recon", 'B, "beta" </script>'} and not answers.remarks
    assert column(answers, "clearness")[0].tolist() == [5, 2] and answers.agreed.all()
    assert answers.background["role"] == ("conservation",)
    assert [one.why for one in leave_out(answers)[1]] == ["took 0 s, less than 24 s"]


def test_a_published_site_is_shown_by_its_pictures_and_answers_may_be_sent(tmp_path: Path) -> None:
    site = tmp_path / "sites" / "gate"
    (site / "pictures").mkdir(parents=True)
    for number in (1, 2):
        Image.fromarray(np.full((30, 40, 3), 90 * number, np.uint8)).save(site / "pictures" / f"{number}.jpg")
    (site / "site.json").write_text('{"pictures": ["pictures/1.jpg", "pictures/2.jpg"]}')
    arguments = ["--out", str(tmp_path / "page.html"), "--contact", "a@b.org", "--result", "Ours", str(site)]
    assert main([*arguments, "--post", "https://atlas.example/api/surveys/gate/answers"]) == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert text.count("data:image/jpeg;base64,") == 2
    assert "sends your answer, when you save it, to atlas.example" in text and "sends nothing" not in text
    for content in ('{"pictures": []}', '{"pictures": ["../../secret.jpg"]}', "[]"):
        (site / "site.json").write_text(content)
        assert main(arguments) != 0


@pytest.mark.parametrize(("results", "word"), [
    ([["A", "a.png"], ["A", "a.png"]], "name of its own"), ([["A: x", "a.png"]], "colon"),
    ([["A", "a.png"], ["B", "a.png", "a.png"]], "different numbers"), ([["A", "no.png"]], "no.png"),
])
def test_a_page_that_would_mislead_is_refused(
    results: list[list[str]], word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    Image.fromarray(np.zeros((9, 9, 3), np.uint8)).save(tmp_path / "a.png")
    given = [argument for name, *files in results
             for argument in ("--result", name, *(str(tmp_path / file) for file in files))]
    assert main(["--out", str(tmp_path / "page.html"), "--contact", "a@b.org", *given]) != 0
    assert word in capsys.readouterr().err and not (tmp_path / "page.html").exists()


def test_too_many_results_are_refused() -> None:
    with pytest.raises(SurveyError, match="one to 6"):
        write_page(Path("never.html"), [Result(f"R{n}", ()) for n in range(7)], Words("", ""), "")
