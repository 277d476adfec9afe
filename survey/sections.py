# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the answers say, as the sections of a report."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from curecon_blender.core.base.language import Text
from curecon_blender.core.report.document import Picture, Section, Table
from curecon_blender.core.report.fonts import Letters

from .answers import Answers, LeftOut, SurveyError
from .items import ASPECTS, NOT_SAID, QUESTIONS, RATINGS, SATISFACTION, SCALE
from .plots import residuals, shares
from .regression import FEW, LEVEL, Fit, Term, category, eliminate, numeric
from .statistics import (
    WANTED_POWER,
    cronbach,
    holm,
    least_d,
    least_f2,
    one_way,
    paired,
    power_f,
    power_paired,
    repeated,
    spread,
)

MEDIUM_D, MEDIUM_F2 = 0.5, 0.15  # Cohen's "medium"
_ENDLESS = 1e9
_MUCH_INFLATED = 5.0
_FAR = 1.0  # Cook's distance of one person on whom a regression hangs
_NAMES = {one.key: Text(one.name.en) for one in RATINGS}
_TITLES = {one.key: Text(one.name.en) for one in QUESTIONS}
_OPTIONS = {one.key: {key: Text(words.en) for key, words in one.options.items()} | {NOT_SAID: Text(NOT_SAID)}
            for one in QUESTIONS}


@dataclass(frozen=True)
class Told:
    """The sections, and the regressions by their titles."""

    sections: tuple[Section, ...]
    fits: dict[str, Fit]


def sections_of(
    answers: Answers, left_out: Sequence[LeftOut], of: str, measured: Mapping[str, str] | None, letters: Letters
) -> Told:
    """`of` is the result whose satisfaction is explained; `measured` what an accuracy report says of each aspect."""
    fits: dict[str, Fit] = {}
    regressions = list(_regressions(answers, of, letters, fits))
    beside = [_beside(answers, of, measured)] if measured else []
    return Told((_people(answers, left_out), _scores(answers, letters), _reliability(answers), _comparison(answers),
                 *regressions, *beside), fits)


def column(answers: Answers, item: str) -> np.ndarray:
    """The ratings (n,r) of one item."""
    return answers.ratings[:, :, [one.key for one in RATINGS].index(item)]


def items_rated(answers: Answers) -> list[str]:
    return [one.key for one in RATINGS if not np.isnan(column(answers, one.key)).all()]


_SHORT = {  # as wide as a column
    "clearness": "clear.", "accuracy": "accur.", "integrity": "integr.", "authenticity": "authent."}


def figure(value: float, digits: int = 2) -> str:
    if math.isnan(value):
        return "–"
    return f"{round(value, digits) + 0.0:.{digits}f}" if abs(value) < _ENDLESS else Text("beyond measure")  # no -0.00


def chance(p: float) -> str:
    return "–" if math.isnan(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def _people(answers: Answers, left_out: Sequence[LeftOut]) -> Section:
    n = len(answers)
    rows = tuple(
        (_TITLES[key], _OPTIONS[key][option], str(count), f"{100 * count / n:.0f}")
        for key, said in answers.background.items() for option in _OPTIONS[key] if (count := Counter(said)[option])
    )
    tables = []
    if rows:
        tables.append(Table(title=Text("Who answered"), rows=rows,
                            head=(Text("Question"), Text("Answer"), Text("People"), "%")))
    if left_out:
        tables.append(Table(title=Text("Left out, by rule"), head=(Text("Respondent"), Text("Why")), words=True,
                            rows=tuple((one.respondent, Text(one.why)) for one in left_out)))
    if answers.remarks:
        tables.append(Table(title=Text("Not read as it stands"), head=("", Text("What")), words=True,
                            rows=tuple((str(row), Text(remark)) for row, remark in enumerate(answers.remarks, 1))))
    seconds = answers.seconds[~np.isnan(answers.seconds)]
    return Section(
        title=Text("People"), tables=tuple(tables),
        sentences=(Text("{} people's answers count; {} were left out.", str(n), str(len(left_out))),),
        rows=((Text("Results rated"), ", ".join(answers.results)),
              *([(Text("Minutes taken, median"), f"{np.median(seconds) / 60:.1f}")] if len(seconds) else [])),
    )


def _scores(answers: Answers, letters: Letters) -> Section:
    rows, bars = [], []
    for item in items_rated(answers):
        for result, values in zip(answers.results, column(answers, item).T, strict=True):
            of = spread(values)
            if of.n:
                rows.append((Text("{}: {}", _NAMES[item], result), str(of.n), figure(of.mean), figure(of.deviation),
                             figure(of.median, 1), Text("{} to {}", figure(of.low), figure(of.high))))
                bars.append((f"{_NAMES[item]}: {result}", values))
    head = (Text("Item and result"), "n", Text("mean"), Text("std. dev."), Text("median"), Text("95 % of mean"))
    picture = shares(bars, [words.en for words in SCALE], letters)
    return Section(
        title=Text("Scores"), sentences=(Text("From 1, strongly disagree, to 5, strongly agree."),),
        tables=(Table(title=Text("Ratings"), head=head, rows=tuple(rows)),),
        pictures=(Picture(Text("Shares of each answer in per cent, and the mean."), picture),),
    )


def _reliability(answers: Answers) -> Section:
    rows = []
    for number, result in enumerate(answers.results):
        ratings = np.column_stack([column(answers, item)[:, number] for item in ASPECTS])
        found = cronbach(ratings)
        rows.append((result, str(found.people), figure(found.alpha), Text("{} to {}", figure(found.low),
                                                                          figure(found.high)),
                     *(figure(value) for value in found.without)))
    head = (Text("Result"), "n", "alpha", "95 %", *(Text("without {}", _SHORT[item]) for item in ASPECTS))
    return Section(
        title=Text("Reliability"), tables=(Table(title=Text("Cronbach's alpha"), head=head, rows=tuple(rows)),),
        sentences=(Text("Whether the four aspects measure one thing: from 0.7 on they may be taken together. Only who "
                        "rated all four counts. – is what cannot be told, as where everybody agrees."),),
    )


def _comparison(answers: Answers) -> Section:
    items = items_rated(answers)
    if len(answers.results) < 2:
        return Section(title=Text("Comparison"), sentences=(Text("Only one result was rated: there is nothing to "
                                                                 "compare."),))
    between = {item: one_way(column(answers, item)) for item in items}
    within = {item: repeated(column(answers, item)) for item in items}
    together = dict(zip(items, holm([within[item].p for item in items]), strict=True))
    repeated_rows = tuple((
        _NAMES[item], str(one.n), figure(one.f), f"{one.df1:.0f}, {one.df2:.0f}", figure(one.epsilon), chance(one.p),
        chance(together[item]), figure(one.effect), chance(one.p_ranks)) for item, one in within.items())
    one_way_rows = tuple((
        _NAMES[item], str(one.n), figure(one.f), f"{one.df1:.0f}, {one.df2:.0f}", chance(one.p), figure(one.effect),
    ) for item, one in between.items())
    paired_people = max(one.n for one in within.values())
    if paired_people >= 2:
        what = Text("Each person rated several results, so the repeated-measures test is the one to go by; the one-way "
                    "analysis, which the literature often gives, takes the ratings as if each came from somebody else.")
    else:
        what = Text("No two people rated all results, so the one-way analysis is the one to go by.")
    n = paired_people
    power = Text("With {} people who rated all results, a medium difference between two (d = 0.5) is found with a "
                 "chance of {} %; the least that is found in {} % of cases is d = {}.", str(n),
                 figure(100 * power_paired(MEDIUM_D, n), 0), f"{100 * WANTED_POWER:.0f}", figure(least_d(n)))
    return Section(
        title=Text("Comparison"),
        sentences=(what, Text("p is Greenhouse and Geisser's; Holm's adjusts it for all items together; that of ranks "
                              "is Friedman's, and Wilcoxon's of pairs."), power),
        tables=(
            Table(title=Text("Do the results differ, rated by the same people?"), rows=repeated_rows, head=(
                Text("Item"), "n", "F", Text("df"), "epsilon", "p", Text("p, Holm"), Text("partial eta²"),
                Text("p, ranks"))),
            Table(title=Text("Do they, as if rated by different people?"), rows=one_way_rows, head=(
                Text("Item"), Text("ratings"), "F", Text("df"), "p", "eta²")),
            _pairs(answers, items),
        ),
    )


def _pairs(answers: Answers, items: Sequence[str]) -> Table:
    pairs = list(itertools.combinations(range(len(answers.results)), 2))
    rows = []
    for item in items:
        ratings = column(answers, item)
        found = [paired(ratings[:, a], ratings[:, b]) for a, b in pairs]
        for (a, b), one, together in zip(pairs, found, holm([one.p for one in found]), strict=True):
            rows.append((
                Text("{}: {} − {}", _NAMES[item], answers.results[a], answers.results[b]), str(one.n),
                figure(one.difference), Text("{} to {}", figure(one.low), figure(one.high)),
                figure(one.t), chance(one.p), chance(together), chance(one.p_ranks), figure(one.d)))
    head = (Text("Item and pair"), "n", Text("differ by"), "95 %", "t", "p", Text("p, Holm"),
            Text("p, ranks"), "d")
    return Table(title=Text("Which differ, by the same people?"), head=head, rows=tuple(rows))


def _regressions(answers: Answers, of: str, letters: Letters, fits: dict[str, Fit]) -> Iterator[Section]:
    number = answers.results.index(of)
    satisfied = column(answers, SATISFACTION)[:, number]
    ratings = {item: values for item in ASPECTS if not np.isnan(values := column(answers, item)[:, number]).all()}
    rated = ~np.isnan(satisfied)
    whole = rated & ~np.isnan(np.column_stack([satisfied, *ratings.values()])).any(axis=1)
    aspects = [numeric(_NAMES[item], values[whole]) for item, values in ratings.items()]
    background = [category(_TITLES[key], [_OPTIONS[key][said[row]] for row in np.flatnonzero(rated)])
                  for key, said in answers.background.items()]
    for title, y, terms in (
        (Text("What makes people satisfied with {}?", of), satisfied[whole], aspects),
        (Text("Who is satisfied with {}?", of), satisfied[rated], background),
    ):
        yield _regression(title, y, terms, letters, fits)


def _regression(title: Text, y: np.ndarray, terms: list[Term], letters: Letters, fits: dict[str, Fit]) -> Section:
    if not terms or not len(y):
        return Section(title=title, sentences=(Text("The people were not asked."),))
    try:
        fit = eliminate(y, terms)
    except SurveyError as error:
        return Section(title=title, sentences=(Text("No regression: {} {}", Text(error.message), Text(error.remedy)),))
    fits[title] = fit
    head = (Text("Predictor"), "b", Text("std. error"), "t", "p", "95 %", "beta", "VIF")
    rows = tuple((Text(one.name), figure(one.b, 3), figure(one.error, 3), figure(one.t), chance(one.p),
                  Text("{} to {}", figure(one.low), figure(one.high)), figure(one.beta, 3), figure(one.vif))
                 for one in fit.coefficients)
    facts: list[tuple[Text, str]] = [
        (Text("People"), str(fit.n)), (Text("R²"), Text("{}, adjusted {}", figure(fit.r2, 3), figure(fit.adjusted, 3))),
        (Text("Whole model"), f"F({fit.df1}, {fit.df2}) = {figure(fit.f)}, p {_equals(fit.p)}"),
        *((Text("Reference of {}", Text(name)), Text(level)) for name, level in fit.references.items()),
    ]
    if fit.removed:
        went = "; ".join(f"{name} (p {_equals(p)})" for name, p in fit.removed)
        facts.append((Text("Taken out, in this order"), went))
    facts += [(Text("Not tried: {}", Text(name)), Text(why)) for name, why in fit.unusable]
    tried = sum(term.columns.shape[1] for term in terms) - sum(
        term.columns.shape[1] for term in terms for name, _ in fit.unusable if term.name == name)
    df2 = fit.n - tried - 1
    facts.append((Text("Power, all {} predictors", str(tried)), Text(
        "a medium effect (f² = 0.15) is found with a chance of {} %; the least found in {} % of cases is f² = {}",
        figure(100 * power_f(MEDIUM_F2 * fit.n, tried, df2), 0), f"{100 * WANTED_POWER:.0f}",
        figure(least_f2(fit.n, tried, df2)))))
    pictures = () if not fit.df1 else (Picture(
        Text("Residuals over fitted values, and over those of a normal distribution."),
        residuals(fit.fitted, fit.residuals, ("fitted", "residual", "normal", "residual"), letters)),)
    return Section(title=title, sentences=_cautions(fit, tried), rows=tuple(facts), pictures=pictures,
                   tables=(Table(title=Text("What remained"), head=head, rows=rows),))


def _equals(p: float) -> str:
    return chance(p) if chance(p).startswith("<") else f"= {chance(p)}"


def _cautions(fit: Fit, tried: int) -> tuple[Text, ...]:
    """What was done, and what speaks against relying on it."""
    said = [Text("Ordinary least squares; the term of the highest p went first, until all were below {}. A category's "
                 "dummies go together.", f"{LEVEL:g}")]
    if not fit.df1:
        said.append(Text("No predictor remained: nothing that was asked explains the answers."))
    if fit.n < FEW * tried:
        said.append(Text("{} people are few for {} predictors: take what remained as a hint.", str(fit.n), str(tried)))
    if fit.df1 and fit.p_normal < LEVEL:
        said.append(Text("The residuals are not normal (Shapiro-Wilk, p {}), so p and intervals are rough.",
                         _equals(fit.p_normal)))
    if fit.p_even < LEVEL:
        said.append(Text("The residuals do not spread evenly (Breusch-Pagan, p {}), so standard errors are rough.",
                         _equals(fit.p_even)))
    if any(one.vif > _MUCH_INFLATED for one in fit.coefficients):
        said.append(Text("Some predictors nearly say the same (VIF above 5): their shares cannot be told apart."))
    if (fit.cook > _FAR).any():
        said.append(Text("{} of the people sway the result by themselves (Cook's distance above 1).",
                         str(int((fit.cook > _FAR).sum()))))
    said.append(Text("Backward elimination makes what remains look surer than it is."))
    return tuple(said)


def _beside(answers: Answers, of: str, measured: Mapping[str, str]) -> Section:
    number = answers.results.index(of)
    rows = []
    for item in ASPECTS:
        said = spread(column(answers, item)[:, number])
        rows.append((_NAMES[item], Text("{} of 5 ({} people)", figure(said.mean), str(said.n)),
                     Text(measured.get(item, "–"))))
    return Section(
        title=Text("Said and measured"), sentences=(Text("What people said of {}, and what its accuracy report "
                                                         "measured.", of),),
        tables=(Table(title=Text("The four words"), words=True, rows=tuple(rows),
                      head=(Text("Word"), Text("said"), Text("measured"))),))
