# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Search: words of names and texts, alike in SQLite (FTS5) and PostgreSQL. Signs of Chinese, Japanese and Korean are a
word each, as nothing stands between them, and are looked for in their order."""

from __future__ import annotations

import json
import re
import unicodedata
from typing import Any

from curecon_blender.core.base.language import Text

from .database import Database, Transaction
from .problems import Problem

PAGE = 50
_MOST_WORDS, _LONGEST_QUERY, _MOST_PAGES = 12, 200, 100
_RUN = re.compile(r"\w+", re.UNICODE)
_SIGN = re.compile("[\u3040-\u30ff\u3400-\u4dbf\u4e00-\u9fff\uac00-\ud7af\uf900-\ufaff\U00020000-\U0003ffff]")


def _plain(text: str) -> str:
    """Without accents and capitals."""
    parted = unicodedata.normalize("NFKD", text)
    bare = "".join(letter for letter in parted if not unicodedata.combining(letter))
    return unicodedata.normalize("NFKC", bare).casefold().replace("_", " ")


def _cut(run: str) -> list[str]:
    return [part for part in re.split(f"({_SIGN.pattern})", run) if part]


def cut(text: str) -> str:
    """A text's words, parted by spaces."""
    return " ".join(word[:60] for run in _RUN.findall(_plain(text)) for word in _cut(run))


def learn(transaction: Transaction, name: str, *texts: str) -> None:
    """Have a site found by these texts."""
    forget(transaction, name)
    made = "to_tsvector('simple', :words)" if transaction.connection.dialect.name == "postgresql" else ":words"
    transaction.run(f"INSERT INTO words (name, said) VALUES (:name, {made})", name=name,
                    words=" ".join(cut(text) for text in texts)[:200_000])


def learn_site(transaction: Transaction, name: str, record: dict[str, Any], about: dict[str, Any]) -> None:
    """Have a site found by what its newest version says."""
    learn(transaction, name, record["title"], record["place"], record["text"], record["credit"], about["register"],
          *about["tags"])


def forget(transaction: Transaction, name: str) -> None:
    transaction.run("DELETE FROM words WHERE name = :name", name=name)


def _wanted(query: str, postgresql: bool) -> str:
    """What the database is asked for: every word's beginning, and signs in their order. Empty for no word."""
    runs = _RUN.findall(_plain(query))[:_MOST_WORDS]
    parts = []
    for run in runs:
        pieces = _cut(run)[:40]
        if postgresql:
            parts.append(
                "(" + " <-> ".join(f"'{piece}'" if _SIGN.match(piece) else f"'{piece}':*" for piece in pieces) + ")"
            )
        else:
            parts.append('"' + " ".join(pieces) + '"' + ("" if _SIGN.match(pieces[-1]) else " *"))
    return (" & " if postgresql else " AND ").join(parts)


def search(database: Database, asked: dict[str, str]) -> dict[str, Any]:
    """Public sites by `q`, `tag`, `register`, `from` and `to` (years), `box` (west,south,east,north); page `page`, from
    1. Raises Problem."""
    if len(asked.get("q", "")) > _LONGEST_QUERY:
        raise Problem(400, "query", Text("A search has {} letters at most.", _LONGEST_QUERY))
    page = _number(asked.get("page", "1"), 1, _MOST_PAGES)
    where, values = ["state = 'public'"], dict[str, Any]()
    wanted = _wanted(asked.get("q", ""), not database.is_sqlite)
    if wanted:
        values["q"] = wanted
        match = "said MATCH :q" if database.is_sqlite else "said @@ to_tsquery('simple', :q)"
        where.append(f"name IN (SELECT name FROM words WHERE {match})")
    elif asked.get("q", "").strip():
        return {"type": "FeatureCollection", "features": [], "numberMatched": 0, "links": []}
    if "register" in asked:
        where.append("register = :register")
        values["register"] = asked["register"][:80]
    if "tag" in asked:
        where.append("tags LIKE :tag ESCAPE '!'")
        quoted = re.sub(r"([!%_])", r"!\1", json.dumps(asked["tag"][:40], ensure_ascii=False))
        values["tag"] = f"%{quoted}%"
    for name, column, sign in (("from", "period_to", ">="), ("to", "period_from", "<=")):
        if name in asked:
            where.append(f"{column} {sign} :{name}_year")
            values[f"{name}_year"] = _number(asked[name], -10_000, 10_000)
    if "box" in asked:
        box = _box(asked["box"])
        where.append("longitude BETWEEN :west AND :east AND latitude BETWEEN :south AND :north")
        values |= dict(zip(("west", "south", "east", "north"), box, strict=True))
    condition = " AND ".join(where)
    with database.read() as transaction:
        matched = transaction.value(f"SELECT count(*) FROM site WHERE {condition}", **values)
        rows = transaction.all(f"SELECT feature FROM site WHERE {condition} ORDER BY number DESC LIMIT {PAGE} OFFSET "
                               f":first",
                               first=PAGE * (page - 1), **values)
    found: dict[str, Any] = {"type": "FeatureCollection", "features": [json.loads(row.feature) for row in rows],
                             "numberMatched": matched, "links": []}
    return found | {"page": page, "pages": min(_MOST_PAGES, -(-matched // PAGE))}


def _number(text: str, low: int, high: int) -> int:
    if not re.fullmatch(r"-?\d{1,6}", text) or not low <= int(text) <= high:
        raise Problem(400, "query", Text("{} is no number from {} to {}.", repr(text[:20]), low, high))
    return int(text)


def _box(text: str) -> list[float]:
    parts = text.split(",")
    if len(parts) != 4 or not all(re.fullmatch(r"-?\d{1,3}(\.\d{1,9})?", part) for part in parts):
        raise Problem(400, "query", "A box is west,south,east,north in degrees.")
    return [float(part) for part in parts]
