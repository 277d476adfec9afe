-- Answers to questionnaires: nothing in them says who sent them, or when.
CREATE TABLE survey (name TEXT PRIMARY KEY, made BIGINT NOT NULL)

CREATE TABLE answer (
    survey TEXT NOT NULL REFERENCES survey (name), respondent TEXT NOT NULL, content TEXT NOT NULL,
    PRIMARY KEY (survey, respondent)
)
