# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The statistics of a survey, from its answers.

    python -m survey ANSWERS [ANSWERS ...] [--out FOLDER] [--of RESULT] [--least-minutes 5] [--report report.json]

ANSWERS are CSV files, or folders of them: one row a respondent, as the page of `python -m survey.questionnaire` saves
it. Writes report.html, report.pdf, report.json and a CSV for each table.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.files import atomic_write, disk_errors, write_json
from curecon_blender.core.base.language import Language, Text
from curecon_blender.core.base.reading import read_json
from curecon_blender.core.report.document import Section
from curecon_blender.core.report.fonts import LATIN, letters_of
from curecon_blender.core.report.pages import write_html, write_pdf

from .answers import Answers, LeftOut, SurveyError, leave_out, read_answers
from .items import ASPECTS
from .sections import Told, sections_of

_FORMULA = "=+-@\t\r"  # what a cell of a spreadsheet must not begin with, unless it is a number


def write_report(
    answers: Answers, left_out: tuple[LeftOut, ...], folder: Path, *, of: str = "",
    measured: dict[str, str] | None = None, font: Path | None = None,
) -> Told:
    """Write the report into a folder. Raises SurveyError where nobody's answer counts, WorkspaceError."""
    if not len(answers):
        why = "; ".join(f"{one.respondent} {one.why}" for one in left_out[:5])
        raise SurveyError(f"No answer counts: {why}.", remedy="Lower --least-minutes, or look at the answers.")
    of = of or answers.results[0]
    if of not in answers.results:
        raise SurveyError(f"Nobody rated “{of}”.", remedy=f"Rated are {', '.join(answers.results)}.")
    names = {*answers.results, *(one.respondent for one in left_out), *answers.remarks, *(measured or {}).values()}
    letters = letters_of(set(LATIN).union(*names) | set("−²ö"), font)
    told = sections_of(answers, left_out, of, measured, letters)
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    title, subtitle = Text("Survey: {}", ", ".join(answers.results)), f"{len(answers)} people"
    write_html(folder / "report.html", title, subtitle, told.sections, Language({}), letters)
    write_pdf(folder / "report.pdf", title, subtitle, told.sections, Language({}), letters)
    write_json(folder / "report.json", _record(answers, left_out, told))
    for section in told.sections:
        _write_tables(folder, section)
    return told


def _record(answers: Answers, left_out: tuple[LeftOut, ...], told: Told) -> dict[str, Any]:
    """Every figure that the report gives, unrounded where a regression gives it."""
    return {
        "people": len(answers), "results": answers.results, "left_out": [asdict(one) for one in left_out],
        "remarks": answers.remarks,
        "sections": [{"title": one.title, "sentences": one.sentences, "rows": one.rows,
                      "tables": [asdict(table) for table in one.tables]} for one in told.sections],
        "regressions": {name: _finite({key: value for key, value in asdict(fit).items()
                                       if not isinstance(value, np.ndarray)}) for name, fit in told.fits.items()},
    }


def _finite(value: Any) -> Any:
    """JSON knows no NaN."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _write_tables(folder: Path, section: Section) -> None:
    for table in section.tables:
        words = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in table.title.casefold())
        part = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in section.title.casefold())
        out = io.StringIO(newline="")
        writer = csv.writer(out)
        writer.writerows([_harmless(cell) for cell in row] for row in (table.head, *table.rows))
        with atomic_write(folder / f"{part[:40].strip('_')}_{words[:40].strip('_')}.csv") as file:
            file.write(out.getvalue().encode("utf-8-sig"))


def _harmless(cell: str) -> str:
    if cell[:1] and cell[0] in _FORMULA:
        try:
            float(cell)
        except ValueError:
            return f"'{cell}"
    return cell


def _measured(path: Path) -> dict[str, str]:
    """What an accuracy report (report/report.json of a workspace) says of each aspect. Raises SurveyError."""
    try:
        sentences = read_json(path)["sentences"]
        found = {item: str(text) for item in ASPECTS for title, text in sentences.items()
                 if title.casefold().startswith(item)}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SurveyError(f"{path} is no accuracy report ({error}).", path=path,
                          remedy="Give the report.json that `report` writes into a workspace.") from error
    return found


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m survey", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("answers", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, default=Path("survey-report"), help="folder of the report")
    parser.add_argument("--of", default="", metavar="RESULT", help="whose satisfaction to explain; default: the first")
    parser.add_argument("--least-minutes", type=float, metavar="MINUTES",
                        help="quicker answers are left out; default: 2 seconds a rating")
    parser.add_argument("--report", type=Path, help="report.json of that result's accuracy report, to stand beside")
    parser.add_argument("--font", type=Path, help="TrueType, OpenType or WOFF2, for names not in Latin letters")
    parser.add_argument("--json", action="store_true", help="print JSON instead of words")
    given = parser.parse_args(arguments)
    try:
        least = None if given.least_minutes is None else 60 * given.least_minutes
        answers, left_out = leave_out(read_answers(given.answers), least)
        told = write_report(answers, left_out, given.out, of=given.of, font=given.font,
                            measured=_measured(given.report) if given.report else None)
    except CuReconError as error:
        print(f"{error.message}\n{error.remedy}", file=sys.stderr)
        return error.exit_code
    if given.json:
        print(json.dumps(_record(answers, left_out, told), ensure_ascii=False))
    else:
        for section in told.sections:
            print(f"{section.title}:", *section.sentences)
        print(f"Written: {given.out / 'report.html'}, report.pdf, report.json and tables as CSV.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
