# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The statistics of ratings: reliability, comparisons of results, and their power. NaN where one is not defined."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

SURE = 0.95  # of confidence intervals
WANTED_POWER = 0.8
_LEAST_FRIEDMAN = 3  # results
_HUGE = 50.0  # an effect that nobody has


@dataclass(frozen=True)
class Alpha:
    """Cronbach's alpha of k items over n people with its interval (Feldt 1965), and alpha without each item (k,)."""

    alpha: float
    low: float
    high: float
    people: int
    without: tuple[float, ...]


@dataclass(frozen=True)
class Spread:
    """Of n numbers; `low` and `high` bound the mean."""

    n: int
    mean: float
    deviation: float
    median: float
    low: float
    high: float


@dataclass(frozen=True)
class FTest:
    """`effect` is eta squared, partial in repeated measures."""

    f: float
    df1: float
    df2: float
    p: float
    effect: float
    n: int


@dataclass(frozen=True)
class Repeated(FTest):
    """`p` is corrected by Greenhouse and Geisser's `epsilon`; `p_ranks` is Friedman's."""

    epsilon: float
    p_ranks: float


@dataclass(frozen=True)
class Paired:
    """Student's t of n differences, their mean with its interval, Cohen's d of them, and Wilcoxon's p."""

    difference: float
    low: float
    high: float
    t: float
    df: int
    p: float
    d: float
    p_ranks: float
    n: int


def cronbach(items: np.ndarray) -> Alpha:
    """Of ratings (n,k); only people who rated every item count."""
    whole = items[~np.isnan(items).any(axis=1)]
    n, k = whole.shape
    alpha = _alpha(whole)
    df1, df2 = n - 1, (n - 1) * (k - 1)
    tail = (1 - SURE) / 2
    low, high = (1 - (1 - alpha) * stats.f.ppf(q, df1, df2) if df2 > 0 else math.nan for q in (1 - tail, tail))
    without = tuple(_alpha(np.delete(whole, item, axis=1)) for item in range(k)) if k > 2 else ()
    return Alpha(alpha, float(low), float(high), n, without)


def _alpha(items: np.ndarray) -> float:
    n, k = items.shape
    if n < 2 or k < 2 or items.sum(axis=1).var() == 0:
        return math.nan
    return float(k / (k - 1) * (1 - items.var(axis=0, ddof=1).sum() / items.sum(axis=1).var(ddof=1)))


def spread(values: np.ndarray) -> Spread:
    """Of the values (n,) that are there."""
    values = values[~np.isnan(values)]
    n = len(values)
    if not n:
        return Spread(0, *[math.nan] * 5)
    mean, deviation = float(values.mean()), float(values.std(ddof=1)) if n > 1 else math.nan
    half = float(stats.t.ppf((1 + SURE) / 2, n - 1)) * deviation / math.sqrt(n) if n > 1 else math.nan
    return Spread(n, mean, deviation, float(np.median(values)), mean - half, mean + half)


def one_way(table: np.ndarray) -> FTest:
    """Analysis of variance of the columns of ratings (n,r), as if each were rated by other people."""
    groups = [column[~np.isnan(column)] for column in table.T]
    groups = [group for group in groups if len(group)]
    total = np.concatenate(groups) if groups else np.empty(0)
    df1, df2 = len(groups) - 1, len(total) - len(groups)
    if df1 < 1 or df2 < 1:
        return FTest(math.nan, max(df1, 0), max(df2, 0), math.nan, math.nan, len(total))
    between = float(sum(len(group) * (group.mean() - total.mean()) ** 2 for group in groups))
    within = float(sum(((group - group.mean()) ** 2).sum() for group in groups))
    return FTest(*_f_test(between, within, df1, df2), len(total))


def repeated(table: np.ndarray) -> Repeated:
    """Analysis of variance of ratings (n,r) by the same people; only those who rated every result count."""
    whole = table[~np.isnan(table).any(axis=1)]
    n, r = whole.shape
    if n < 2 or r < 2:
        return Repeated(math.nan, max(r - 1, 0), 0, math.nan, math.nan, n, math.nan, math.nan)
    columns, rows = whole.mean(axis=0), whole.mean(axis=1, keepdims=True)
    between = float(n * ((columns - whole.mean()) ** 2).sum())
    residual = whole - columns - rows + whole.mean()
    f, df1, df2, p, effect = _f_test(between, float((residual**2).sum()), r - 1, (r - 1) * (n - 1))
    epsilon = _greenhouse_geisser(whole)
    if not math.isnan(f) and not math.isinf(f):
        p = float(stats.f.sf(f, df1 * epsilon, df2 * epsilon))
    ranks = math.nan
    if r >= _LEAST_FRIEDMAN and not math.isnan(f):
        ranks = float(stats.friedmanchisquare(*whole.T).pvalue)
    return Repeated(f, df1, df2, p, effect, n, epsilon, ranks)


def _f_test(between: float, within: float, df1: int, df2: int) -> tuple[float, int, int, float, float]:
    tiny = 1e-12 * (between + within)
    if between + within <= 0:
        return math.nan, df1, df2, math.nan, math.nan
    if within <= tiny:
        return math.inf, df1, df2, 0.0, 1.0
    f = between / df1 / (within / df2)
    return f, df1, df2, float(stats.f.sf(f, df1, df2)), between / (between + within)


def _greenhouse_geisser(whole: np.ndarray) -> float:
    """1 where the differences between results spread alike, 1 / (r - 1) at worst."""
    r = whole.shape[1]
    if r == 2:
        return 1.0
    centre = np.eye(r) - 1 / r
    covariance = centre @ np.cov(whole.T) @ centre
    squares = float((covariance**2).sum())
    return float(np.trace(covariance)) ** 2 / ((r - 1) * squares) if squares > 0 else 1.0


def paired(a: np.ndarray, b: np.ndarray) -> Paired:
    """Of ratings a and b (n,) by the same people: a minus b."""
    differences = (a - b)[~np.isnan(a - b)]
    n = len(differences)
    of = spread(differences)
    if n < 2 or of.deviation == 0:
        all_alike = 1.0 if n > 1 and of.mean == 0 else math.nan
        return Paired(of.mean, math.nan, math.nan, math.nan, max(n - 1, 0), all_alike, math.nan, all_alike, n)
    t = of.mean / (of.deviation / math.sqrt(n))
    ranks = float(stats.wilcoxon(differences, method="approx").pvalue)
    return Paired(of.mean, of.low, of.high, t, n - 1, 2 * float(stats.t.sf(abs(t), n - 1)), of.mean / of.deviation,
                  ranks, n)


def holm(p: Sequence[float]) -> tuple[float, ...]:
    """p of several tests, adjusted so that all are right together; those that are not defined do not count."""
    known = sorted((value, place) for place, value in enumerate(p) if not math.isnan(value))
    adjusted = list(p)
    least = 0.0
    for rank, (value, place) in enumerate(known):
        least = max(least, min(1.0, value * (len(known) - rank)))
        adjusted[place] = least
    return tuple(adjusted)


def power_paired(d: float, n: int, level: float = 0.05) -> float:
    """The chance to find a difference of d standard deviations between n pairs, two-sided."""
    return power_f(d * d * n, 1, n - 1, level)  # t squared is F


def power_f(noncentrality: float, df1: float, df2: float, level: float = 0.05) -> float:
    """The chance that an F test finds an effect; of f squared, the noncentrality is f squared times n."""
    if df1 < 1 or df2 < 1:
        return math.nan
    return float(stats.ncf.sf(stats.f.ppf(1 - level, df1, df2), df1, df2, noncentrality))


def least_d(n: int) -> float:
    """The smallest difference that n pairs find in WANTED_POWER of cases, in standard deviations."""
    return _least(lambda d: power_paired(d, n))


def least_f2(n: int, df1: int, df2: int) -> float:
    """The smallest f squared that a regression finds in WANTED_POWER of cases."""
    return _least(lambda f2: power_f(f2 * n, df1, df2))


def _least(power: Callable[[float], float]) -> float:
    most = 0.01
    while power(most) < WANTED_POWER and most < _HUGE:
        most *= 2
    if math.isnan(power(most)) or power(most) < WANTED_POWER:
        return math.nan
    return float(optimize.brentq(lambda effect: power(effect) - WANTED_POWER, 1e-6, most, xtol=1e-10))
