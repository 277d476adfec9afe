# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Answers to questionnaires, as their pages post them: kept for moderators, with nothing of who sent them."""

from __future__ import annotations

import csv
import io
import re

from .database import Database, Transaction, now
from .people import note
from .problems import Problem

MOST_BYTES, MOST_COLUMNS, MOST_ANSWERS = 16_384, 100, 5_000
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,59}")
_FORMULA = "=+-@"  # what a cell of a spreadsheet must not begin with
_RESPONDENT = re.compile(r"[0-9a-f]{12}")  # by chance, as the page makes it


def open_survey(transaction: Transaction, name: str, account: str) -> None:
    """Let answers come in. Raises Problem."""
    if not _NAME.fullmatch(name):
        raise Problem(400, "survey", "A survey's name has small letters, digits and hyphens.")
    transaction.run("INSERT INTO survey VALUES (:name, :made) ON CONFLICT (name) DO NOTHING", name=name, made=now())
    note(transaction, account, "survey", name)


def add(database: Database, name: str, content: bytes) -> None:
    """Keep an answer: a table of headings and one row. The same respondent's second one changes nothing. Raises
    Problem."""
    cells = _cells(content)
    with database.write() as transaction:
        if not transaction.one("SELECT name FROM survey WHERE name = :name", name=name):
            raise Problem(404, "unknown", "There is no such survey.")
        if transaction.value("SELECT count(*) FROM answer WHERE survey = :name", name=name) >= MOST_ANSWERS:
            raise Problem(409, "full", "This survey has all the answers that it can hold.")
        transaction.run("INSERT INTO answer VALUES (:survey, :respondent, :content) ON CONFLICT (survey, respondent) "
                        "DO NOTHING", survey=name, respondent=cells["respondent"], content=_line([*cells.items()]))


def answers(database: Database, name: str) -> bytes:
    """All answers as one CSV table. Raises Problem."""
    with database.read() as transaction:
        if not transaction.one("SELECT name FROM survey WHERE name = :name", name=name):
            raise Problem(404, "unknown", "There is no such survey.")
        kept = transaction.all("SELECT content FROM answer WHERE survey = :name ORDER BY respondent", name=name)
    rows = [dict(_pairs(row.content)) for row in kept]
    head = list(dict.fromkeys(column for row in rows for column in row))
    out = io.StringIO(newline="")
    writer = csv.DictWriter(out, head, restval="")
    writer.writeheader()
    writer.writerows(rows)
    return out.getvalue().encode("utf-8-sig")


def _cells(content: bytes) -> dict[str, str]:
    try:
        head, row = csv.reader(io.StringIO(content.decode("utf-8-sig"), newline=""), strict=True)
    except (ValueError, csv.Error) as error:
        raise Problem(400, "answer", "An answer is a table of headings and one row.") from error
    cells = dict(zip(head, row, strict=False))
    texts = [*head, *row]
    if (not len(head) == len(row) == len(cells) <= MOST_COLUMNS or not "".join(texts).isprintable()
            or any(text[:1] in _FORMULA for text in texts if text)):
        raise Problem(400, "answer", "An answer is a table of headings and one row.")
    if cells.get("consent") != "yes" or not _RESPONDENT.fullmatch(cells.get("respondent", "")):
        raise Problem(400, "answer", "An answer tells of its consent, and has a respondent's number by chance.")
    return cells


def _line(pairs: list[tuple[str, str]]) -> str:
    out = io.StringIO(newline="")
    csv.writer(out).writerows(pairs)
    return out.getvalue()


def _pairs(content: str) -> list[tuple[str, str]]:
    return [(name, cell) for name, cell in csv.reader(io.StringIO(content, newline=""))]
