# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Accounts by invitation, sessions, tokens for uploads, rates, and the audit log."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
import threading
from dataclasses import dataclass
from typing import Any

from curecon_blender.core.base.language import Text

from .database import Database, Transaction, identity, now
from .problems import Problem

CONTRIBUTOR, MODERATOR, OFFICIAL = ROLES = ("contributor", "moderator", "official")
SESSION, UPLOAD = "session", "upload"
_SESSION_SECONDS, _UPLOAD_SECONDS, _INVITATION_SECONDS = 12 * 3600, 365 * 86400, 14 * 86400
_COST, _BLOCK, _PARALLEL = 1 << 15, 8, 3  # scrypt: 32 MiB and some 0.3 s
_SHORTEST, _LONGEST = 10, 200  # of a password
_NAME = re.compile(r"[\w][\w .@-]{0,58}[\w]", re.UNICODE)
_at_once = threading.Semaphore(2)  # so that many sign-ins ask for no more memory than two


@dataclass(frozen=True)
class Person:
    """Who asks: `kind` is how they showed it. A token for uploads may upload, whatever its owner's role."""

    id: str
    name: str
    role: str
    kind: str

    def require(self, *roles: str) -> None:
        if self.kind != SESSION or (roles and self.role not in roles):
            raise Problem(403, "forbidden", "Your account may not do that.")


def digest(token: str) -> str:
    return hashlib.sha256(token.encode("utf-8", "replace")).hexdigest()


def hashed(password: str, salt: bytes, cost: int = _COST, block: int = _BLOCK, parallel: int = _PARALLEL) -> str:
    with _at_once:
        found = hashlib.scrypt(password[:_LONGEST].encode("utf-8", "replace"), salt=salt, n=cost, r=block, p=parallel,
                               maxmem=256 * cost * block, dklen=32)
    return f"scrypt${cost}${block}${parallel}${salt.hex()}${found.hex()}"


def _fits(password: str, kept: str) -> bool:
    """Whether it is the password that `hashed` made `kept` of, at whatever cost."""
    _, cost, block, parallel, salt, _ = kept.split("$")
    return hmac.compare_digest(hashed(password, bytes.fromhex(salt), int(cost), int(block), int(parallel)), kept)


# Nobody's, so that an unknown name takes as long as a known one.
_NOBODYS = f"scrypt${_COST}${_BLOCK}${_PARALLEL}${'00' * 16}${'00' * 32}"


def note(transaction: Transaction, account: str, action: str, subject: str = "", detail: str = "") -> None:
    """Add to the audit log."""
    transaction.run("INSERT INTO audit (at, account, action, subject, detail) VALUES (:at, :account, :action, "
                    ":subject, "
                    ":detail)", at=now(), account=account, action=action, subject=subject, detail=detail[:2000])


def rate(database: Database, what: str, most: int, seconds: int) -> None:
    """Count one more of `what`. Raises Problem when there were more than `most` in this span of time."""
    began = now() // seconds * seconds
    with database.write() as transaction:
        transaction.run("INSERT INTO rate VALUES (:what, :began, 1) ON CONFLICT (what, began) DO UPDATE SET count = "
                        "rate.count + 1", what=what, began=began)
        count = transaction.value(
            "SELECT count FROM rate WHERE what = :what AND began = :began", what=what, began=began
        )
    if count > most:
        raise Problem(429, "too_many", "That was tried too often. Wait a while, then try again.",
                      wait=began + seconds - now())


def invite(transaction: Transaction, role: str, by: str) -> str:
    """A new invitation's token."""
    if role not in ROLES:
        raise Problem(400, "role", Text("A role is one of {}.", ", ".join(ROLES)))
    token = secrets.token_urlsafe(24)
    transaction.run("INSERT INTO invitation VALUES (:digest, :role, :by, :made, :ends, NULL)", digest=digest(token),
                    role=role, by=by, made=now(), ends=now() + _INVITATION_SECONDS)
    note(transaction, by, "invite", role)
    return token


def join(database: Database, token: str, name: str, password: str) -> str:
    """Make an account of an invitation; its id."""
    name = " ".join(name.split())
    if not _NAME.fullmatch(name):
        raise Problem(400, "name", "A name has 2 to 60 letters, figures, spaces, dots, @ or hyphens.")
    if not _SHORTEST <= len(password) <= _LONGEST:
        raise Problem(400, "password", Text("A password has {} to {} letters.", _SHORTEST, _LONGEST))
    kept, account = hashed(password, secrets.token_bytes(16)), identity()
    with database.write() as transaction:
        if not transaction.run("UPDATE invitation SET used_by = :account WHERE digest = :digest AND used_by IS NULL "
                               "AND ends >= :now", account=account, digest=digest(token), now=now()):
            raise Problem(403, "invitation", "This invitation was used, has run out, or never was. Ask for another.")
        if transaction.one("SELECT id FROM account WHERE lower(name) = lower(:name)", name=name):
            raise Problem(409, "taken", "Somebody has that name. Choose another.")
        role = transaction.value("SELECT role FROM invitation WHERE digest = :digest", digest=digest(token))
        transaction.run("INSERT INTO account VALUES (:id, :name, :role, :password, :made, NULL)", id=account, name=name,
                        role=role, password=kept, made=now())
        note(transaction, account, "join", role)
    return account


def sign_in(database: Database, name: str, password: str) -> str:
    """A new session's token."""
    with database.read() as transaction:
        row = transaction.one("SELECT id, password FROM account WHERE lower(name) = lower(:name) AND closed IS NULL",
                              name=" ".join(name.split()))
    if not _fits(password, row.password if row else _NOBODYS) or row is None:
        raise Problem(403, "sign_in", "The name or the password is wrong.")
    with database.write() as transaction:
        note(transaction, row.id, "sign_in")
        return give(transaction, row.id, SESSION, "")


def give(transaction: Transaction, account: str, kind: str, label: str) -> str:
    """A new token of an account."""
    token = f"{'atlas_' if kind == UPLOAD else ''}{secrets.token_urlsafe(32)}"
    lasts = _UPLOAD_SECONDS if kind == UPLOAD else _SESSION_SECONDS
    transaction.run("INSERT INTO token VALUES (:digest, :account, :kind, :label, :made, :ends)", digest=digest(token),
                    account=account, kind=kind, label=label, made=now(), ends=now() + lasts)
    return token


def who(database: Database, token: str, kind: str) -> Person | None:
    """Whose token it is, while it holds."""
    with database.read() as transaction:
        row = transaction.one(
            "SELECT account.id, name, role FROM token JOIN account ON account.id = token.account WHERE digest = "
            ":digest AND kind = :kind AND ends > :now AND closed IS NULL", digest=digest(token), kind=kind, now=now())
    return Person(row.id, row.name, row.role, kind) if row else None


def guard(token: str) -> str:
    """What a session's own pages send with each change, and no other page can know."""
    return hmac.new(token.encode("utf-8", "replace"), b"csrf", hashlib.sha256).hexdigest()


def tokens(transaction: Transaction, account: str) -> list[dict[str, Any]]:
    rows = transaction.all("SELECT digest, label, made, ends FROM token WHERE account = :account AND kind = :kind "
                           "ORDER BY made", account=account, kind=UPLOAD)
    return [{"id": row.digest[:16], "label": row.label, "made": row.made, "ends": row.ends} for row in rows]


def revoke(transaction: Transaction, account: str, start: str) -> None:
    """End a token for uploads by the beginning of its digest."""
    if not re.fullmatch(r"[0-9a-f]{16}", start) or not transaction.run(
            "DELETE FROM token WHERE account = :account AND kind = :kind AND substr(digest, 1, 16) = :start",
            account=account, kind=UPLOAD, start=start):
        raise Problem(404, "unknown", "There is no such token.")
    note(transaction, account, "revoke", start)


def change_password(database: Database, person: Person, old: str, new: str) -> None:
    """Ends every session and token of the account."""
    if not _SHORTEST <= len(new) <= _LONGEST:
        raise Problem(400, "password", Text("A password has {} to {} letters.", _SHORTEST, _LONGEST))
    with database.read() as transaction:
        kept = transaction.value("SELECT password FROM account WHERE id = :id", id=person.id)
    if not _fits(old, kept):
        raise Problem(403, "sign_in", "The name or the password is wrong.")
    made = hashed(new, secrets.token_bytes(16))
    with database.write() as transaction:
        transaction.run("UPDATE account SET password = :made WHERE id = :id", made=made, id=person.id)
        transaction.run("DELETE FROM token WHERE account = :id", id=person.id)
        note(transaction, person.id, "password")


def accounts(transaction: Transaction) -> list[dict[str, Any]]:
    """Those that can sign in."""
    rows = transaction.all("SELECT id, name, role, made FROM account WHERE closed IS NULL ORDER BY lower(name)")
    return [dict(row._mapping) for row in rows]


def close(transaction: Transaction, person: Person, account: str) -> None:
    """Close another's account, or one's own: it can no longer sign in, and its tokens end."""
    if account != person.id:
        person.require(MODERATOR)
    if not transaction.run("UPDATE account SET closed = :now WHERE id = :id AND closed IS NULL", now=now(), id=account):
        raise Problem(404, "unknown", "There is no such account.")
    transaction.run("DELETE FROM token WHERE account = :id", id=account)
    note(transaction, person.id, "close", account)
