"""Racing of a tuning: rank tests find the candidates that are significantly worse than the leader.

F-race: M. Birattari, T. Stuetzle, L. Paquete and K. Varrentrapp, "A racing algorithm for
configuring metaheuristics", GECCO 2002. Each seed is a block in which the candidates are ranked.
Three or more candidates: the Friedman test in its F form (Iman-Davenport), then, if that test
rejects, Conover's comparison of each candidate with the leader (W. J. Conover, Practical
Nonparametric Statistics, 3rd edition 1999, chapter 5.8). Two candidates: Wilcoxon's signed-rank
test. Rank tests are used, since metrics of swarms do not scatter normally, and since a failed run
has a rank, too.

A look is an interim analysis of a race, after a number of seeds. Unlike F-race, the level is
divided by the number of looks, and at each look by the number of comparisons with the leader
(Bonferroni). So the probability that a race eliminates its best candidate is at most about `ALPHA`.
If all candidates are equal, this is also the probability that a race eliminates any of them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.core.values import Array

ALPHA = 0.05
FIRST = 5
"""The number of seeds before the first look, as in irace."""
_GROWTH = math.sqrt(2.0)  # the factor between the numbers of seeds of successive looks
_ROUNDING = 1e-9  # ranks are multiples of 0.5: smaller differences of rank sums count as 0


def looks(seeds: int) -> tuple[int, ...]:
    """The numbers of seeds after which candidates are compared: 5, 8, 12, 17 ..., below `seeds`."""
    counts: list[int] = []
    count = FIRST
    while count < seeds:
        counts.append(count)
        count = math.ceil(count * _GROWTH)
    return tuple(counts)


def losers(losses: Array, level: float) -> list[int]:
    """The candidates (column indices) that are significantly worse than the leader.

    `losses` (seeds, candidates): the least loss is the best; inf: a failed run; never NaN. `level`:
    of significance. The leader is the candidate with the least sum of ranks over the seeds. Two
    candidates: Wilcoxon's signed-rank test. More: the Friedman test in the Iman-Davenport form,
    then Conover's comparison with the leader. Empty with fewer than two seeds or candidates.
    """
    from scipy.stats import rankdata, t

    seeds, candidates = losses.shape
    if seeds < 2 or candidates < 2:
        return []
    if candidates == 2:
        return _loser_of_two(losses, level)
    ranks = rankdata(losses, axis=1)
    if not _friedman_rejects(ranks, level):
        return []
    # Conover's least significant difference of rank sums, one-sided. The level is divided by the
    # number of comparisons with the leader (Bonferroni).
    sums = ranks.sum(axis=0)
    freedom = (seeds - 1) * (candidates - 1)
    scatter = max(seeds * float((ranks**2).sum()) - float((sums**2).sum()), 0.0)
    error = 2.0 * scatter / freedom
    quantile = float(t.isf(level / (candidates - 1), freedom))
    bound = max(quantile * math.sqrt(error), _ROUNDING)
    return [column for column in range(candidates) if sums[column] - sums.min() > bound]


def _loser_of_two(losses: Array, level: float) -> list[int]:
    """As `losers`, for two candidates: Wilcoxon's signed-rank test."""
    from scipy.stats import rankdata, wilcoxon

    leader = int(rankdata(losses, axis=1).sum(axis=0).argmin())
    follower = 1 - leader
    excess = _differences(losses[:, leader], losses[:, follower])
    if not excess.any():
        return []
    return [follower] if float(wilcoxon(excess).pvalue) <= level else []


def _friedman_rejects(ranks: Array, level: float) -> bool:
    """True if the Friedman test in the Iman-Davenport form finds that the candidates differ.

    `ranks` (seeds, candidates), with ties. T1 and T2 as in Conover 1999, chapter 5.8.
    """
    from scipy.stats import f

    n, k = ranks.shape
    sums = ranks.sum(axis=0)
    scatter = float((ranks**2).sum()) - n * k * (k + 1) ** 2 / 4.0
    if scatter <= 0.0:  # all candidates are equal on each seed
        return False
    t1 = (k - 1) * float(((sums - n * (k + 1) / 2.0) ** 2).sum()) / scatter
    t1_margin = n * (k - 1) - t1
    if t1_margin <= _ROUNDING * n:  # 0, and T2 infinite: all seeds give the same order
        return True
    t2 = (n - 1) * t1 / t1_margin
    return bool(f.sf(t2, k - 1, (n - 1) * (k - 1)) <= level)


def mean_loss(losses: Sequence[float]) -> tuple[int, float]:
    """A sort key for candidates over the same seeds: the number of failed runs, then the mean.

    The mean is over the runs that did not fail; inf if all failed.
    """
    finite = [loss for loss in losses if math.isfinite(loss)]
    return len(losses) - len(finite), sum(finite) / len(finite) if finite else math.inf


def _differences(a: Array, b: Array) -> Array:
    """The differences b - a (n,) of losses (n,), where the loss inf is a failed run.

    Two failed runs have the difference 0. The difference of a failed and a finished run is finite,
    and greater in size than each difference of two finished runs, so that Wilcoxon's test gives it
    a higher rank.
    """
    are_finite = np.isfinite(a) & np.isfinite(b)
    finite = np.where(are_finite, b, 0.0) - np.where(are_finite, a, 0.0)
    beyond_all = 1.0 + float(np.abs(finite).max(initial=0.0))
    sign = np.isinf(b).astype(np.float64) - np.isinf(a)
    return np.where(are_finite, finite, beyond_all * sign)
