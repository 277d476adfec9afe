# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The survey's statistics agree with statsmodels and pingouin and find what was planted; odd answers are told of."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
import survey_answers as synthetic

from survey.__main__ import main
from survey.answers import Answers, SurveyError, leave_out, read_answers
from survey.items import ASPECTS, QUESTIONS, RATINGS
from survey.regression import category, eliminate, least_squares, numeric
from survey.sections import column
from survey.statistics import cronbach, holm, least_f2, one_way, paired, power_f, power_paired, repeated, spread

EXACT = 1e-6


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Answers:
    return read_answers([synthetic.write(tmp_path_factory.mktemp("survey") / "answers.csv", synthetic.table())])


# ---- against other libraries

def test_alpha_is_the_oracles(answers: Answers) -> None:
    pingouin, pandas = pytest.importorskip("pingouin"), pytest.importorskip("pandas")
    ratings = np.column_stack([column(answers, item)[:, 0] for item in ASPECTS])
    found = cronbach(ratings)
    alpha, (low, high) = pingouin.cronbach_alpha(pandas.DataFrame(ratings))
    assert found.alpha == pytest.approx(alpha, abs=EXACT)
    assert (found.low, found.high) == pytest.approx((low, high), abs=6e-4)  # the oracle rounds to three decimals
    without_one = np.vstack([ratings, [5, np.nan, 5, 5]])
    assert cronbach(without_one) == found


def test_analyses_of_variance_are_the_oracles(answers: Answers) -> None:
    pingouin, pandas = pytest.importorskip("pingouin"), pytest.importorskip("pandas")
    table = column(answers, "clearness")
    long = pandas.DataFrame({"person": np.repeat(answers.ids, 3), "result": np.tile(answers.results, len(answers)),
                             "score": table.ravel()})
    between = pingouin.anova(long, dv="score", between="result").iloc[0]
    found = one_way(table)
    assert (found.f, found.p) == pytest.approx((between["F"], between["p-unc"]), abs=EXACT)
    assert found.effect == pytest.approx(between["np2"], abs=EXACT)
    within = pingouin.rm_anova(long, dv="score", within="result", subject="person", correction=True,
                               effsize="np2").iloc[0]
    ours = repeated(table)
    assert ours.f == pytest.approx(within["F"], abs=EXACT) and ours.epsilon == pytest.approx(within["eps"], abs=EXACT)
    assert ours.effect == pytest.approx(within["np2"], abs=EXACT)
    assert ours.p == pytest.approx(within["p-GG-corr"], abs=EXACT)
    pair = pingouin.ttest(table[:, 0], table[:, 1], paired=True).iloc[0]
    mine = paired(table[:, 0], table[:, 1])
    assert (mine.t, mine.p) == pytest.approx((pair["T"], pair["p-val"]), abs=EXACT)
    p = (0.01, 0.04, 0.03, 0.5)
    assert holm(p) == pytest.approx(pingouin.multicomp(list(p), method="holm")[1], abs=EXACT)


def test_the_regression_is_the_oracles(answers: Answers) -> None:
    api = pytest.importorskip("statsmodels.api")
    diagnostic = pytest.importorskip("statsmodels.stats.diagnostic")
    from statsmodels.stats.outliers_influence import variance_inflation_factor

    y = column(answers, "satisfaction")[:, 0]
    terms = [*(numeric(item, column(answers, item)[:, 0]) for item in ASPECTS),
             category("role", answers.background["role"])]
    found = least_squares(y, terms)
    X = api.add_constant(np.hstack([term.columns for term in terms]))
    oracle = api.OLS(y, X).fit()
    for name, ours, theirs in (
        ("b", [one.b for one in found.coefficients], oracle.params),
        ("error", [one.error for one in found.coefficients], oracle.bse),
        ("p", [one.p for one in found.coefficients], oracle.pvalues),
        ("interval", [(one.low, one.high) for one in found.coefficients], oracle.conf_int()),
        ("vif", [one.vif for one in found.coefficients][1:],
         [variance_inflation_factor(X, k) for k in range(1, X.shape[1])]),
        ("fit", (found.r2, found.adjusted, found.f, found.p),
         (oracle.rsquared, oracle.rsquared_adj, oracle.fvalue, oracle.f_pvalue)),
        ("cook", found.cook, oracle.get_influence().cooks_distance[0]),
        ("breusch-pagan", found.p_even, diagnostic.het_breuschpagan(oracle.resid, X)[1]),
    ):
        assert np.allclose(ours, theirs, atol=EXACT), name
    standardised = api.OLS((y - y.mean()) / y.std(), (X[:, 1:] - X[:, 1:].mean(axis=0)) / X[:, 1:].std(axis=0)).fit()
    assert np.allclose([one.beta for one in found.coefficients][1:], standardised.params, atol=EXACT)


def test_power_is_the_oracles() -> None:
    pingouin = pytest.importorskip("pingouin")
    from statsmodels.stats.power import FTestPowerF2

    assert power_paired(0.5, 20) == pytest.approx(pingouin.power_ttest(d=0.5, n=20, contrast="paired"), abs=EXACT)
    assert power_f(0.15 * 60, 5, 54) == pytest.approx(FTestPowerF2().power(0.15, 5, 54, 0.05), abs=EXACT)
    assert power_f(least_f2(60, 5, 54) * 60, 5, 54) == pytest.approx(0.8, abs=EXACT)


# ---- known answers

def test_figures_that_a_hand_can_compute() -> None:
    # Items 1 2 3 and 2 2 5: variances 1 and 3, sums 3 4 8 of variance 7: 2 (1 - 4 / 7).
    assert cronbach(np.array([[1.0, 2], [2, 2], [3, 5]])).alpha == pytest.approx(6 / 7)
    # Groups 1 2 3 and 3 4 5: between 6, within 4 of 4 degrees.
    found = one_way(np.array([[1.0, 3], [2, 4], [3, 5]]))
    assert (found.f, found.df1, found.df2) == (pytest.approx(6.0), 1, 4)
    assert paired(np.array([1.0, 2, 3]), np.array([3.0, 4, 5])).difference == -2
    x = np.arange(10.0)
    fit = least_squares(3 + 2 * x + np.tile([1.0, -1, -1, 1, 0], 2), [numeric("x", x)])
    assert fit.coefficients[1].b == pytest.approx(2, abs=0.05)


def test_the_survey_finds_what_was_planted(answers: Answers, tmp_path: Path) -> None:
    ours, b, c = (spread(values).mean for values in column(answers, "clearness").T)
    assert ours - b > 0.4 and abs(b - c) < 0.3
    assert repeated(column(answers, "accuracy")).p < 0.001
    y = column(answers, "satisfaction")[:, 0]
    terms = [*(numeric(item, column(answers, item)[:, 0]) for item in ASPECTS),
             category("role", answers.background["role"], "design"),
             category("software", answers.background["software"])]
    fit = eliminate(y, terms)
    found = {one.name: one for one in fit.coefficients}
    assert {"clearness", "accuracy", "role: surveying"} < set(found)
    assert found["role: surveying"].low < synthetic.BONUS["surveying"] < found["role: surveying"].high + 0.3
    assert {"integrity", "authenticity", "software"} <= {name for name, _ in fit.removed}
    assert fit.references["role"] == "design"
    reversed_fit = eliminate(y, terms[::-1])
    assert reversed_fit.r2 == pytest.approx(fit.r2)


def test_the_report_is_written_in_all_its_forms(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = synthetic.write(tmp_path / "answers.csv", synthetic.table())
    measured = tmp_path / "report.json"
    measured.write_text(json.dumps({"sentences": {"Clearness": "A pixel is 9 mm.", "Accuracy": "Check points: 2 cm."}}))
    assert main([str(source), "--out", str(tmp_path / "out"), "--report", str(measured)]) == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    for word in ("Cronbach", "Greenhouse", "Ordinary least squares", "Reference of Role", "A pixel is 9 mm.", "VIF"):
        assert word in page, word
    assert (tmp_path / "out" / "report.pdf").read_bytes().startswith(b"%PDF")
    record = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert record["people"] == 60 and len(record["regressions"]) == 2
    with open(tmp_path / "out" / "scores_ratings.csv", newline="", encoding="utf-8-sig") as file:
        rows = list(csv.reader(file))
    assert rows[1][0] == "Clearness: Ours" and float(rows[1][2]) > 3.5
    assert "Written" in capsys.readouterr().out


# ---- answers as people send them

def _rows(**changes: str) -> list[dict[str, str]]:
    return [row | changes for row in synthetic.table(12)]


def _read(path: Path, rows: list[dict[str, str]], separator: str = ",", encoding: str = "utf-8") -> Answers:
    return read_answers([synthetic.write(path / "answers.csv", rows, separator, encoding)])


def test_rows_are_left_out_by_rule_and_listed(tmp_path: Path) -> None:
    rows = _rows()
    rows[1] |= {name: "1" for name in rows[1] if ": " in name}
    rows[2]["seconds"] = "12"
    rows[3]["consent"] = "no"
    rows[4]["respondent"] = rows[0]["respondent"]
    rows[5] |= {name: "" for name in rows[5] if ": " in name}
    kept, out = leave_out(_read(tmp_path, rows))
    assert len(kept) == 7
    assert [one.respondent for one in out] == ["p01", "p02", "p03", "p00", "p05"]
    for one, word in zip(out, ("gave 1 to all", "12 s", "agree", "before", "nothing"), strict=True):
        assert word in one.why
    assert len(leave_out(_read(tmp_path, rows), least_seconds=300)[1]) > 5


def test_semicolons_decimal_commas_and_a_chinese_excel_are_read(tmp_path: Path) -> None:
    expected = _read(tmp_path, _rows()).ratings
    names = {one.key: one.name.zh for one in RATINGS}
    asked = {one.key: one.name.zh for one in QUESTIONS}
    asked |= {"respondent": "编号", "consent": "同意", "seconds": "用时（秒）"}
    rows = []
    for row in _rows(consent="是"):
        translated = {}
        for name, cell in row.items():
            result, _, item = name.rpartition(": ")
            options = {key: words.zh for one in QUESTIONS if one.key == name for key, words in one.options.items()}
            translated[f"{result}：{names[item]}" if result else asked[name]] = options.get(cell, cell)
        translated["用时（秒）"] = "312,5"
        rows.append(translated)
    found = _read(tmp_path, rows, ";", "gb18030")
    assert np.array_equal(found.ratings, expected) and found.seconds[0] == 312.5 and found.agreed.all()
    assert found.background["role"][2] == "surveying" and not found.remarks


def test_cells_that_are_no_ratings_are_missing_and_told(tmp_path: Path) -> None:
    rows = _rows()
    rows[0]["Ours: clearness"], rows[1]["Ours: clearness"] = "7", "splendid"
    rows[2]["Ours: clearness"], rows[3]["Ours: clearness"], rows[4]["role"] = "", "Strongly agree", "pirate"
    found = _read(tmp_path, rows)
    assert np.isnan(column(found, "clearness")[:3, 0]).all() and column(found, "clearness")[3, 0] == 5
    assert len(found.remarks) == 3 and "row 2" in found.remarks[0] and "splendid" in found.remarks[1]
    assert found.background["role"][4] == "not said"


@pytest.mark.parametrize(("content", "word"), [
    (b"", "no answer"), (b"respondent,role\np1,design\n", "no column of ratings"),
    (b"\x00\x01\x02\x00", "cannot be read"),
    (b"Ours: clearness,Ours: Clearness\n3,4\n", "2 times"), (b"Ours: clearness\n", "no answer"),
    (b"Ours: clearness\n" + b"3\n" * 100_002, "more than 100,000 rows"),
])
def test_what_is_no_table_of_answers_is_refused(content: bytes, word: str, tmp_path: Path) -> None:
    (tmp_path / "answers.csv").write_bytes(content)
    with pytest.raises(SurveyError, match=word):
        read_answers([tmp_path / "answers.csv"])


@pytest.mark.parametrize("people", [1, 2, 3])
def test_a_handful_of_people_gets_a_report_that_says_what_cannot_be_told(people: int, tmp_path: Path) -> None:
    source = synthetic.write(tmp_path / "answers.csv", synthetic.table(people))
    assert main([str(source), "--out", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    tables = "".join(file.read_text(encoding="utf-8-sig") for file in (tmp_path / "out").glob("*.csv"))
    assert "No regression" in text and "nan" not in tables and "–" in tables


def test_answers_without_variance_have_no_statistics_but_a_report(tmp_path: Path) -> None:
    rows = [{"respondent": f"p{n}", "Ours: clearness": "4", "Ours: satisfaction": "4", "B: clearness": "4"}
            for n in range(9)]
    source = synthetic.write(tmp_path / "answers.csv", rows)
    assert main([str(source), "--out", str(tmp_path / "out")]) == 0
    assert "Everybody gave the same answer" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    alike = np.full((9, 3), 4.0)
    assert math.isnan(cronbach(alike).alpha) and math.isnan(repeated(alike).f) and math.isnan(one_way(alike).p)
    assert paired(alike[:, 0], alike[:, 1]).p == 1


def test_more_predictors_than_people_is_said() -> None:
    rng = np.random.default_rng(1)
    terms = [numeric(f"x{n}", rng.normal(size=6)) for n in range(5)]
    with pytest.raises(SurveyError, match="5 predictors are too many for 6 people"):
        eliminate(rng.normal(size=6), terms)


def test_predictors_that_say_the_same_are_named_and_not_tried() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=40)
    terms = [numeric("x", x), numeric("twice", 2 * x), category("same", ["a"] * 40)]
    fit = eliminate(x + rng.normal(size=40) / 9, terms)
    assert dict(fit.unusable) == {"twice": "the other predictors say the same", "same": "everybody is alike"}


def test_nobody_left_is_an_error_that_names_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = synthetic.write(tmp_path / "answers.csv", _rows(consent="no"))
    assert main([str(source), "--out", str(tmp_path / "out")]) == 1
    assert "did not agree" in capsys.readouterr().err
