-- Statements are parted by empty lines. Times are seconds since 1970, JSON is text.
CREATE TABLE account (
    id TEXT PRIMARY KEY, name TEXT NOT NULL UNIQUE, role TEXT NOT NULL CHECK (role IN ('contributor', 'moderator', 'official')),
    password TEXT NOT NULL, made BIGINT NOT NULL, closed BIGINT
)

CREATE TABLE invitation (
    digest TEXT PRIMARY KEY, role TEXT NOT NULL, made_by TEXT NOT NULL, made BIGINT NOT NULL, ends BIGINT NOT NULL, used_by TEXT
)

CREATE TABLE token (
    digest TEXT PRIMARY KEY, account TEXT NOT NULL REFERENCES account (id), kind TEXT NOT NULL CHECK (kind IN ('session', 'upload')),
    label TEXT NOT NULL, made BIGINT NOT NULL, ends BIGINT NOT NULL
)

CREATE INDEX token_account ON token (account)

CREATE TABLE rate (what TEXT NOT NULL, began BIGINT NOT NULL, count INTEGER NOT NULL, PRIMARY KEY (what, began))

CREATE TABLE upload (
    id TEXT PRIMARY KEY, account TEXT NOT NULL REFERENCES account (id), digest TEXT NOT NULL,
    state TEXT NOT NULL CHECK (state IN ('open', 'done')), about TEXT NOT NULL, bytes BIGINT NOT NULL,
    made BIGINT NOT NULL, touched BIGINT NOT NULL, version TEXT
)

CREATE INDEX upload_account ON upload (account, state)

CREATE UNIQUE INDEX upload_open ON upload (account, digest) WHERE state = 'open'

CREATE TABLE upload_file (
    upload TEXT NOT NULL REFERENCES upload (id), number INTEGER NOT NULL, path TEXT NOT NULL, size BIGINT NOT NULL,
    sha256 TEXT NOT NULL, received BIGINT NOT NULL, PRIMARY KEY (upload, number)
)

CREATE TABLE chunk (
    upload TEXT NOT NULL REFERENCES upload (id), number INTEGER NOT NULL, start BIGINT NOT NULL, size BIGINT NOT NULL,
    object TEXT NOT NULL, PRIMARY KEY (upload, number, start)
)

CREATE TABLE site (
    name TEXT PRIMARY KEY, owner TEXT NOT NULL REFERENCES account (id), state TEXT NOT NULL CHECK (state IN ('new', 'public', 'removed')),
    number BIGINT UNIQUE, newest INTEGER NOT NULL, made BIGINT NOT NULL, published BIGINT, removed BIGINT, why TEXT NOT NULL,
    title TEXT NOT NULL, place TEXT NOT NULL, tags TEXT NOT NULL, register TEXT NOT NULL, period_from INTEGER, period_to INTEGER,
    longitude DOUBLE PRECISION, latitude DOUBLE PRECISION, quadkey TEXT, shown_quadkey TEXT, feature TEXT NOT NULL,
    changed INTEGER NOT NULL
)

CREATE INDEX site_quadkey ON site (quadkey)

CREATE INDEX site_owner ON site (owner)

CREATE INDEX site_register ON site (register)

CREATE INDEX site_period ON site (period_from, period_to)

CREATE INDEX site_changed ON site (changed) WHERE changed > 0

CREATE TABLE version (
    id TEXT PRIMARY KEY, site TEXT NOT NULL REFERENCES site (name), number INTEGER,
    state TEXT NOT NULL CHECK (state IN ('held', 'accepted', 'refused', 'withdrawn', 'removed')), account TEXT NOT NULL REFERENCES account (id),
    made BIGINT NOT NULL, decided BIGINT, decided_by TEXT, why TEXT NOT NULL, record TEXT NOT NULL, about TEXT NOT NULL,
    doubts TEXT NOT NULL, bytes BIGINT NOT NULL, UNIQUE (site, number)
)

CREATE INDEX version_state ON version (state, made)

CREATE TABLE version_file (
    version TEXT NOT NULL REFERENCES version (id), path TEXT NOT NULL, size BIGINT NOT NULL, sha256 TEXT NOT NULL, PRIMARY KEY (version, path)
)

CREATE TABLE place (site TEXT PRIMARY KEY REFERENCES site (name), sealed TEXT NOT NULL, made BIGINT NOT NULL)

CREATE TABLE lease (name TEXT PRIMARY KEY, holder TEXT NOT NULL, ends BIGINT NOT NULL)
