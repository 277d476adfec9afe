# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Answers that a questionnaire's page posts to an atlas are kept for its moderators, and only those of a survey."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from atlas_run import Asker, running

from survey.answers import read_answers
from survey.sections import column

ROW = ("respondent,consent,seconds,role,Ours: clearness,B: clearness\r\n"
       "{},yes,200,surveying,{},2\r\n")


def send(visitor: Asker, text: str, name: str = "tulou") -> int:
    return visitor.ask("POST", f"/api/surveys/{name}/answers", body=text.encode(), Content_Type="text/plain").status


def test_answers_come_in_once_and_only_moderators_read_them(tmp_path: Path) -> None:
    with running(tmp_path) as atlas:
        visitor = atlas.visitor
        assert send(visitor, ROW.format("0123456789ab", 5)) == 404, "nobody has opened this survey"
        address = atlas.run("survey", "tulou").strip()
        assert address == f"{atlas.address}/api/surveys/tulou/answers"
        assert send(visitor, ROW.format("0123456789ab", 5)) == 200
        assert send(visitor, ROW.format("0123456789ab", 1)) == 200, "the page may send once more"
        assert send(visitor, ROW.format("0123456789ac", 3)) == 200
        for bad in ("", "a,b\n1\n", ROW.format("Jane Doe", 5), ROW.format("0123456789ad", "=cmd()"),
                    ROW.format("0123456789ad", 5).replace("yes", "no"), ROW.format("0123456789ad", "5\n6"),
                    ROW.format("0123456789ad", 5) * 2, "x" * 20_000):
            assert send(visitor, bad) in (400, 413), bad[:60]
        path = "/api/surveys/tulou/answers"
        assert visitor.ask("GET", path).status == 401
        assert atlas.somebody("contributor", "Ann").ask("GET", path).status == 403
        got = atlas.somebody("moderator", "Mo").ask("GET", path)
        (tmp_path / "answers.csv").write_bytes(got.body)
        found = read_answers([tmp_path / "answers.csv"])
        assert found.ids == ("0123456789ab", "0123456789ac") and found.results == ("Ours", "B")
        assert np.array_equal(column(found, "clearness")[:, 0], [5, 3])
        while send(visitor, ROW.format("0123456789ae", 4)) == 200:
            pass  # an hour's worth from one place
        assert send(visitor, ROW.format("0123456789af", 4)) == 429
