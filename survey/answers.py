# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading answers: tables of one row a respondent, by whatever program they were saved, and which rows are left out.

Columns are `respondent`, `consent`, `seconds`, the questions' keys, and `RESULT: ITEM` for each rating; the names of
questions and items in English or Chinese stand for their keys, and so do the options' words in the cells.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from curecon_blender.core.base.errors import CuReconError
from curecon_blender.core.base.reading import read_bytes

from .items import LEAST, MOST, NOT_SAID, QUESTIONS, RATINGS, SCALE, by_any_name, folded

MOST_BYTES, MOST_ROWS, MOST_COLUMNS, MOST_CELL = 64 << 20, 100_000, 1000, 10_000
STRAIGHT = 8  # ratings that are all alike, from which on they count as given without looking
QUICK = 2.0  # seconds a rating, below which nobody has read it
_META = by_any_name({
    "respondent": ("id", "respondent id", "编号", "序号", "答卷编号"),
    "consent": ("i agree to take part", "同意", "知情同意"),
    "seconds": ("duration", "duration (seconds)", "time taken", "用时", "用时(秒)", "用时（秒）", "所用时间",
                "答题时间"),
    "language": ("语言",), "order": ("顺序",), "started": ("date", "开始时间", "提交答卷时间"),
})
_ITEMS = by_any_name({one.key: (one.name.en, one.name.zh, one.statement.en, one.statement.zh) for one in RATINGS})
_QUESTIONS = by_any_name({one.key: (one.name.en, one.name.zh, one.text.en, one.text.zh) for one in QUESTIONS})
_OPTIONS = {one.key: by_any_name({key: (words.en, words.zh) for key, words in one.options.items()})
            for one in QUESTIONS}
_SCALE = {folded(word): value for value, words in enumerate(SCALE, LEAST) for word in (words.en, words.zh)}
_YES = {"yes", "true", "1", "y", "ja", "是", "同意", "我同意", "i agree"}
_NOTHING = {"", "-", "–", "na", "n/a", "nan", "null", "none", "(跳过)", "(空)"}


class SurveyError(CuReconError):
    """Answers that cannot be read, or a question that they cannot answer."""

    kind = "survey"


@dataclass(frozen=True, kw_only=True)
class Answers:
    """What n respondents said of r results.

    `ratings` (n,r,i) float64 in the order of items.RATINGS, NaN where missing; `seconds` (n,) likewise; `background` by
    a question's key, its options' keys (n,), "not said" where missing. `remarks` say what could not be read.
    """

    ids: tuple[str, ...]
    results: tuple[str, ...]
    ratings: np.ndarray
    seconds: np.ndarray
    background: dict[str, tuple[str, ...]]
    agreed: np.ndarray  # (n,) bool; true for all where nobody was asked
    remarks: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, rows: Sequence[int]) -> Answers:
        which = np.asarray(rows, int)
        return replace(
            self, ids=tuple(self.ids[row] for row in rows), ratings=self.ratings[which], seconds=self.seconds[which],
            background={key: tuple(said[row] for row in rows) for key, said in self.background.items()},
            agreed=self.agreed[which],
        )


@dataclass(frozen=True)
class LeftOut:
    respondent: str
    why: str


@dataclass
class _Remarks:
    """What was read otherwise than it stands, with a limit on how much of it is told."""

    said: list[str] = field(default_factory=list)
    more: int = 0

    def add(self, remark: str) -> None:
        if len(self.said) < 30:
            self.said.append(remark)
        else:
            self.more += 1

    def all(self) -> tuple[str, ...]:
        return (*self.said, *([f"And {self.more} more of that kind."] if self.more else []))


def read_answers(paths: Sequence[Path]) -> Answers:
    """The answers in files, or in all .csv, .tsv and .txt of folders. Raises SurveyError."""
    files = [file for path in paths for file in (_files_in(path) if path.is_dir() else [path])]
    rows: list[dict[str, str]] = []
    remarks = _Remarks()
    for file in files:
        rows += _read_table(file, remarks, several=len(files) > 1)
    if not rows:
        raise SurveyError("There is no answer.", remedy="Give a table with one row of headings and a row for each "
                          "respondent.", path=paths[0] if paths else None)
    return _answers_of(rows, remarks)


def _files_in(folder: Path) -> list[Path]:
    return sorted(file for file in folder.iterdir() if file.suffix.lower() in (".csv", ".tsv", ".txt"))


def _read_table(path: Path, remarks: _Remarks, *, several: bool) -> list[dict[str, str]]:
    """Rows as cells by column: a key, or (result, item) as "RESULT: KEY". Each has its place under "row"."""
    try:
        text = _decoded(read_bytes(path, MOST_BYTES))
        lines = _cells(text)
    except (OSError, ValueError, csv.Error) as error:
        raise SurveyError(f"{path} cannot be read as a table: {error}.", path=path,
                          remedy="Save the answers as CSV in UTF-8.") from error
    if not lines:
        return []
    columns = _columns(lines[0], path, remarks)
    rows = []
    for number, line in enumerate(lines[1:], 2):
        place = f"{path.name}, row {number}" if several else f"row {number}"
        if len(line) > len(lines[0]):
            remarks.add(f"{place}: {len(line)} cells under {len(lines[0])} headings; the last were not read.")
        if any(cell.strip() for cell in line):
            cells = {name: cell.strip() for name, cell in zip(columns, line, strict=False) if name}
            rows.append({"row": place} | cells)
    return rows


def _decoded(content: bytes) -> str:
    """UTF-8, UTF-16 as spreadsheets say "Unicode text", or GB 18030, what a Chinese Excel writes."""
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("gb18030")


def _cells(text: str) -> list[list[str]]:
    """Rows of cells; the separator is the one that the headings hold most of. Raises ValueError."""
    if "\0" in text:
        raise ValueError("it holds no text")
    head = text.lstrip().split("\n", 1)[0]
    unquoted = "".join(head.split('"')[::2])
    separator = max(";\t,", key=unquoted.count)
    lines: list[list[str]] = []
    for line in csv.reader(io.StringIO(text.lstrip("\n\r"), newline=""), delimiter=separator):
        if len(lines) > MOST_ROWS:
            raise ValueError(f"it has more than {MOST_ROWS:,} rows")
        if len(line) > MOST_COLUMNS or any(len(cell) > MOST_CELL for cell in line):
            raise ValueError("a row is longer than that of any questionnaire")
        lines.append(line)
    return lines


def _columns(head: list[str], path: Path, remarks: _Remarks) -> list[str]:
    """The column's key for each heading, "" where it is not used. Raises SurveyError."""
    columns = []
    for heading in head:
        said = folded(heading)
        result, _, item = heading.replace("：", ":").strip().lstrip("\ufeff").rpartition(":")
        if said in _META or said in _QUESTIONS:
            columns.append(_META.get(said) or _QUESTIONS[said])
        elif folded(item) in _ITEMS:
            columns.append(f"{' '.join(result.split()) or 'Result'}: {_ITEMS[folded(item)]}")
        else:
            columns.append("")
            if said:
                remarks.add(f"The column “{heading.strip()[:60]}” is none of the questionnaire's and was not read.")
    if doubled := [name for name, count in Counter(columns).items() if name and count > 1]:
        raise SurveyError(f"{path} has the column “{doubled[0]}” {columns.count(doubled[0])} times.", path=path,
                          remedy="Remove or rename all but one of them.")
    if not any(": " in name for name in columns):
        wanted = f"Ours: {RATINGS[0].key}"
        raise SurveyError(
            f"{path} has no column of ratings.", path=path,
            remedy=f"Name each such column by the result and the item, such as “{wanted}”. Items are "
            f"{', '.join(one.key for one in RATINGS)}, or their names in Chinese.")
    return columns


def _answers_of(rows: list[dict[str, str]], remarks: _Remarks) -> Answers:
    rated = dict.fromkeys(name for row in rows for name in row if ": " in name)
    results = tuple(dict.fromkeys(name.rpartition(": ")[0] for name in rated))
    ratings = np.full((len(rows), len(results), len(RATINGS)), np.nan)
    seconds = np.full(len(rows), np.nan)
    places = {f"{result}: {item.key}": (r, i) for r, result in enumerate(results) for i, item in enumerate(RATINGS)}
    for n, row in enumerate(rows):
        for name in rated:
            ratings[n][places[name]] = _rating(row.get(name, ""), name, row["row"], remarks)
        seconds[n] = _duration(row.get("seconds", ""), row["row"], remarks)
    asked = any("consent" in row for row in rows)
    return Answers(
        ids=tuple(row.get("respondent", "")[:60] or row["row"] for row in rows), results=results, ratings=ratings,
        seconds=seconds, agreed=np.array([not asked or folded(row.get("consent", "")) in _YES for row in rows]),
        background={one.key: tuple(_option(one.key, row, remarks) for row in rows) for one in QUESTIONS
                    if any(one.key in row for row in rows)},
        remarks=remarks.all(),
    )


def number(text: str) -> float | None:
    """A number with a point or a comma before its decimals; None for anything else."""
    try:
        value = float(text.replace(",", ".") if text.count(",") == 1 and "." not in text else text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _rating(cell: str, name: str, place: str, remarks: _Remarks) -> float:
    said = folded(cell)
    if said in _NOTHING:
        return math.nan
    if said in _SCALE:
        return float(_SCALE[said])
    value = number(said)
    if value is not None and LEAST <= value <= MOST:
        return value
    remarks.add(f"{place}, “{name}”: “{cell[:40]}” is no number from {LEAST} to {MOST}; taken as missing.")
    return math.nan


def _duration(cell: str, place: str, remarks: _Remarks) -> float:
    said = folded(cell).removesuffix("秒").removesuffix("s").strip()
    if said in _NOTHING:
        return math.nan
    value = number(said)
    if value is None or value < 0:
        remarks.add(f"{place}: “{cell[:40]}” is no number of seconds; the time is taken as unknown.")
        return math.nan
    return value


def _option(key: str, row: dict[str, str], remarks: _Remarks) -> str:
    said = folded(row.get(key, ""))
    if said in _OPTIONS[key]:  # "none" is an answer, where it is an option
        return _OPTIONS[key][said]
    if said not in _NOTHING and said != NOT_SAID:
        remarks.add(f"{row['row']}, “{key}”: “{row[key][:40]}” is none of the options; taken as not said.")
    return NOT_SAID


def leave_out(answers: Answers, least_seconds: float | None = None) -> tuple[Answers, tuple[LeftOut, ...]]:
    """The answers that count, and those that do not: without consent, doubled, empty, too quick, or with all of at
    least STRAIGHT ratings alike. `least_seconds` defaults to QUICK for each rating given. The first reason counts."""
    kept: list[int] = []
    out: list[LeftOut] = []
    met: set[str] = set()
    for row, respondent in enumerate(answers.ids):
        given = answers.ratings[row][~np.isnan(answers.ratings[row])]
        least = QUICK * len(given) if least_seconds is None else least_seconds
        if not answers.agreed[row]:
            why = "did not agree to take part"
        elif respondent in met:
            why = "answered before: the first answer counts"
        elif not len(given):
            why = "rated nothing"
        elif answers.seconds[row] < least:
            why = f"took {answers.seconds[row]:.0f} s, less than {least:.0f} s"
        elif len(given) >= STRAIGHT and (given == given[0]).all():
            why = f"gave {given[0]:g} to all of {len(given)} ratings"
        else:
            why = ""
            kept.append(row)
        met.add(respondent)
        if why:
            out.append(LeftOut(respondent, why))
    return answers.take(kept), tuple(out)
