# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The database, SQLite or PostgreSQL by its URL: transactions, and migrations from numbered SQL files."""

from __future__ import annotations

import re
import secrets
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, Row, create_engine, event, text
from sqlalchemy.pool import QueuePool

MIGRATIONS = Path(__file__).parent / "migrations"
_BUSY = 5  # seconds that a statement waits for another's transaction
_MANY = 500  # rows a statement


def now() -> int:
    return int(time.time())


def identity() -> str:
    return secrets.token_hex(10)


class Database:
    """Transactions that read, and such that write: SQLite lets one write at a time, and the others wait."""

    def __init__(self, url: str) -> None:
        self.is_sqlite = url.startswith("sqlite:")
        if self.is_sqlite:
            self._engine = create_engine(url, poolclass=QueuePool, pool_size=20, max_overflow=30, pool_timeout=_BUSY,
                                         connect_args={"timeout": _BUSY, "check_same_thread": False})
            event.listen(self._engine, "connect", _set_up_sqlite)
        else:
            self._engine = create_engine(url, pool_size=20, max_overflow=30, pool_timeout=_BUSY, pool_pre_ping=True,
                                         connect_args={"connect_timeout": _BUSY,
                                                       "options": f"-c lock_timeout={_BUSY}s"})

    @contextmanager
    def read(self) -> Iterator[Transaction]:
        """One state of the database, whatever others write meanwhile."""
        with self._begin("BEGIN" if self.is_sqlite else "REPEATABLE READ") as found:
            yield found

    @contextmanager
    def write(self) -> Iterator[Transaction]:
        """Committed when the block ends well, else rolled back."""
        with self._begin("BEGIN IMMEDIATE" if self.is_sqlite else "READ COMMITTED") as found:
            yield found

    @contextmanager
    def _begin(self, how: str) -> Iterator[Transaction]:
        with self._engine.connect() as connection:
            if self.is_sqlite:
                connection.exec_driver_sql(how)
            else:
                connection = connection.execution_options(isolation_level=how)
            try:
                yield Transaction(connection)
                connection.commit()
            except BaseException:
                connection.rollback()
                raise

    def close(self) -> None:
        self._engine.dispose()

    def migrate(self) -> list[str]:
        """Bring the schema up to date, each step in a transaction of its own; the steps that were made. Machines that
        start at once wait for each other."""
        kind = "sqlite" if self.is_sqlite else "postgresql"
        made = []
        for number in sorted(
            {match[1] for path in MIGRATIONS.glob("*.sql") if (match := re.match(r"(\d+)", path.name))}
        ):
            with self.write() as transaction:
                if not self.is_sqlite:
                    transaction.run("SELECT pg_advisory_xact_lock(8017)")
                transaction.run("CREATE TABLE IF NOT EXISTS migration (number TEXT PRIMARY KEY, made BIGINT NOT NULL)")
                if transaction.one("SELECT number FROM migration WHERE number = :number", number=number):
                    continue
                for name in (f"{number}.sql", f"{number}.{kind}.sql"):
                    for statement in _statements(MIGRATIONS / name):
                        transaction.connection.exec_driver_sql(statement)
                transaction.run("INSERT INTO migration VALUES (:number, :made)", number=number, made=now())
            made.append(number)
        return made


class Transaction:
    def __init__(self, connection: Connection) -> None:
        self.connection = connection

    def alone(self) -> None:
        """Wait until no other transaction that called this is under way; in SQLite every one that writes is alone."""
        if self.connection.dialect.name == "postgresql":
            self.run("SELECT pg_advisory_xact_lock(8018)")

    def run(self, statement: str, **values: Any) -> int:
        """Rows that were changed."""
        return self.connection.execute(text(statement), values).rowcount

    def many(self, statement: str, rows: list[dict[str, Any]]) -> None:
        for first in range(0, len(rows), _MANY):
            self.connection.execute(text(statement), rows[first : first + _MANY])

    def all(self, statement: str, **values: Any) -> list[Row[Any]]:
        return list(self.connection.execute(text(statement), values))

    def one(self, statement: str, **values: Any) -> Row[Any] | None:
        return self.connection.execute(text(statement), values).first()

    def value(self, statement: str, **values: Any) -> Any:
        return self.connection.execute(text(statement), values).scalar()


def _statements(path: Path) -> list[str]:
    if not path.is_file():
        return []
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("--")]
    return [part.strip() for part in "\n".join(lines).split("\n\n") if part.strip()]


def _set_up_sqlite(connection: Any, _: Any) -> None:
    connection.isolation_level = None  # transactions begin where we say so
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON", f"busy_timeout = {1000 * _BUSY}"):
        connection.execute(f"PRAGMA {pragma}")
