# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""Ordinary least squares with dummies for categories, by backward elimination, with its diagnostics.

A category's dummies stand for one term: they come and go together, by a partial F test, so that the reference category
stays the same. The reference is the most frequent category.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from .answers import SurveyError
from .statistics import SURE

LEVEL = 0.05  # a term stays below
CONSTANT = "constant"
FEW = 10  # people for each predictor, below which a regression is little to go by
_ALIKE = 1e-8  # of a column that is left when the others are taken out of it: then it says nothing of its own


@dataclass(frozen=True)
class Term:
    """A predictor: numbers as one column, or a category as a dummy for each but its `reference`. `columns` (n,c)."""

    name: str
    columns: np.ndarray
    labels: tuple[str, ...]
    reference: str = ""


@dataclass(frozen=True)
class Coefficient:
    """b with its standard error, t, p and interval; `beta` is standardised, b s_x / s_y; `vif` the inflation of its
    variance by the other predictors. Both are NaN for the constant."""

    name: str
    b: float
    error: float
    t: float
    p: float
    low: float
    high: float
    beta: float
    vif: float


@dataclass(frozen=True, kw_only=True)
class Fit:
    """A regression of n people's numbers. `removed` are terms and the p at which they went, `unusable` terms and why
    they could not be tried. `p_normal` is Shapiro and Wilk's of the residuals, `p_even` Breusch and Pagan's of their
    variance; `cook` (n,) is Cook's distance of each person."""

    n: int
    coefficients: tuple[Coefficient, ...]
    r2: float
    adjusted: float
    f: float
    df1: int
    df2: int
    p: float
    residuals: np.ndarray
    fitted: np.ndarray
    cook: np.ndarray
    p_normal: float
    p_even: float
    references: dict[str, str]
    removed: tuple[tuple[str, float], ...] = ()
    unusable: tuple[tuple[str, str], ...] = ()


def numeric(name: str, values: np.ndarray) -> Term:
    return Term(name, values[:, None].astype(np.float64), (name,))


def category(name: str, values: Sequence[str], reference: str | None = None) -> Term:
    """Dummies of a category; the reference is its most frequent value, the first of equals in the alphabet."""
    counts = Counter(values)
    reference = reference or min(counts, key=lambda value: (-counts[value], value))
    levels = [level for level in sorted(counts) if level != reference]
    columns = np.array([[value == level for level in levels] for value in values], np.float64)
    labels = tuple(f"{name}: {level}" for level in levels)
    return Term(name, columns.reshape(len(values), len(levels)), labels, reference)


def eliminate(y: np.ndarray, terms: Sequence[Term], level: float = LEVEL) -> Fit:
    """The fit that is left when the term of the highest p is taken out, again and again, until all are below `level`.
    Raises SurveyError where y has no variance or there are too few people."""
    kept, unusable = _usable(y, terms)
    removed: list[tuple[str, float]] = []
    while kept:
        p = [_partial_p(y, kept, place) for place in range(len(kept))]
        worst = int(np.argmax(p))
        if p[worst] < level:
            break
        removed.append((kept.pop(worst).name, p[worst]))
    return least_squares(y, kept, removed=tuple(removed), unusable=unusable)


def _usable(y: np.ndarray, terms: Sequence[Term]) -> tuple[list[Term], tuple[tuple[str, str], ...]]:
    """The terms that vary and that the terms before them do not make up already, and why the others cannot be used."""
    if len(y) < 3 or y.var() == 0:
        raise SurveyError("Everybody gave the same answer, or there are fewer than three people: there is nothing to "
                          "explain.", remedy="Ask more people.")
    kept: list[Term] = []
    out: list[tuple[str, str]] = []
    wanted = sum(term.columns.shape[1] for term in terms if term.columns.var(axis=0).any())
    if len(y) < wanted + 2:
        raise SurveyError(f"{wanted} predictors are too many for {len(y)} people.",
                          remedy=f"Ask at least {FEW * wanted} people, or leave questions out.")
    basis = np.ones((len(y), 1)) / math.sqrt(len(y))
    for term in terms:
        left = term.columns - basis @ (basis.T @ term.columns)
        if not term.columns.shape[1] or not term.columns.var(axis=0).any():
            out.append((term.name, "everybody is alike"))
            continue
        q, singular, _ = np.linalg.svd(left, full_matrices=False)
        if singular.min() < _ALIKE * max(float(np.linalg.norm(term.columns)), 1e-300):
            out.append((term.name, "the other predictors say the same"))
            continue
        basis = np.hstack([basis, q])
        kept.append(term)
    return kept, tuple(out)


def _design(n: int, terms: Sequence[Term]) -> np.ndarray:
    return np.hstack([np.ones((n, 1)), *(term.columns for term in terms)])


def _residual_square(y: np.ndarray, X: np.ndarray) -> float:
    return float(((y - X @ np.linalg.lstsq(X, y, rcond=None)[0]) ** 2).sum())


def _partial_p(y: np.ndarray, terms: Sequence[Term], place: int) -> float:
    """p of the F test of a model against the one without a term; for one column it is the t test's."""
    whole = _residual_square(y, full := _design(len(y), terms))
    without = _residual_square(y, _design(len(y), [*terms[:place], *terms[place + 1 :]]))
    df1, df2 = terms[place].columns.shape[1], len(y) - full.shape[1]
    if whole <= 1e-20 * float((y**2).sum()):
        return 0.0 if without > 1e-16 * float((y**2).sum()) else 1.0
    return float(stats.f.sf((without - whole) / df1 / (whole / df2), df1, df2))


def least_squares(
    y: np.ndarray, terms: Sequence[Term], *, removed: tuple[tuple[str, float], ...] = (),
    unusable: tuple[tuple[str, str], ...] = (),
) -> Fit:
    """The regression of y (n,) on terms whose columns are independent."""
    X = _design(len(y), terms)
    n, k = X.shape
    inverse = np.linalg.inv(X.T @ X)
    b = inverse @ X.T @ y
    fitted = X @ b
    residuals = y - fitted
    df1, df2 = k - 1, n - k
    left, total = float((residuals**2).sum()), float(((y - y.mean()) ** 2).sum())
    variance = left / df2
    r2 = 1 - left / total
    f = (total - left) / df1 / variance if df1 and variance > 0 else math.nan
    leverage = np.einsum("ij,jk,ik->i", X, inverse, X)
    with np.errstate(divide="ignore", invalid="ignore"):
        cook = residuals**2 / (k * variance) * leverage / (1 - leverage) ** 2
    names = (CONSTANT, *(label for term in terms for label in term.labels))
    return Fit(
        n=n, coefficients=_coefficients(names, X, y, b, np.sqrt(variance * np.diag(inverse)), df2), r2=r2,
        adjusted=1 - (1 - r2) * (n - 1) / df2, f=f, df1=df1, df2=df2,
        p=float(stats.f.sf(f, df1, df2)) if df1 else math.nan, residuals=residuals, fitted=fitted, cook=cook,
        p_normal=float(stats.shapiro(residuals).pvalue) if variance > 1e-20 else math.nan,
        p_even=_breusch_pagan(residuals, X), removed=removed, unusable=unusable,
        references={term.name: term.reference for term in terms if term.reference},
    )


def _coefficients(
    names: Sequence[str], X: np.ndarray, y: np.ndarray, b: np.ndarray, error: np.ndarray, df: int
) -> tuple[Coefficient, ...]:
    half = float(stats.t.ppf((1 + SURE) / 2, df)) * error
    with np.errstate(divide="ignore", invalid="ignore"):
        t = b / error
    beta = b * X.std(axis=0, ddof=1) / y.std(ddof=1)
    found = []
    for place, name in enumerate(names):
        constant = place == 0
        found.append(Coefficient(
            name, float(b[place]), float(error[place]), float(t[place]), 2 * float(stats.t.sf(abs(t[place]), df)),
            float(b[place] - half[place]), float(b[place] + half[place]), math.nan if constant else float(beta[place]),
            math.nan if constant else _inflation(X, place),
        ))
    return tuple(found)


def _inflation(X: np.ndarray, place: int) -> float:
    column = X[:, place]
    return float(((column - column.mean()) ** 2).sum()) / _residual_square(column, np.delete(X, place, axis=1))


def _breusch_pagan(residuals: np.ndarray, X: np.ndarray) -> float:
    """Koenker's form: n R2 of the squared residuals on the predictors."""
    squares = residuals**2
    total = float(((squares - squares.mean()) ** 2).sum())
    if X.shape[1] < 2 or total <= 1e-30:
        return math.nan
    return float(stats.chi2.sf(len(squares) * (1 - _residual_square(squares, X) / total), X.shape[1] - 1))
