CREATE TABLE audit (
    id INTEGER PRIMARY KEY AUTOINCREMENT, at BIGINT NOT NULL, account TEXT NOT NULL, action TEXT NOT NULL, subject TEXT NOT NULL,
    detail TEXT NOT NULL
)

CREATE TRIGGER audit_kept BEFORE UPDATE ON audit BEGIN SELECT RAISE(ABORT, 'the audit log is only added to'); END

CREATE TRIGGER audit_stays BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'the audit log is only added to'); END

CREATE VIRTUAL TABLE words USING fts5 (name UNINDEXED, said, tokenize = 'unicode61 remove_diacritics 0')
