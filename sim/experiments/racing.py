"""Racing: which candidates are worse than the leader with confidence, from runs of common seeds.

F-race: M. Birattari, T. Stuetzle, L. Paquete and K. Varrentrapp, "A racing algorithm for
configuring metaheuristics", GECCO 2002. Each seed is a block in which the candidates are ranked;
Friedman's test comes first, then the comparison of each candidate with the leader: W. J. Conover,
Practical Nonparametric Statistics, 3rd edition 1999, chapter 5.8. With two candidates left the
comparison is Wilcoxon's signed-rank test. Ranks need no normal scatter, which metrics of swarms do
not have, and a failed run is a rank, too.

Differently from F-race the level is divided: among the looks at the race, and at each look among
the comparisons with the leader (Bonferroni). So the best candidate of a race is eliminated with a
probability of about `ALPHA` at most, and of equal candidates any.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from swarmd.core.values import Array

ALPHA = 0.05
FIRST = 5
"""The number of seeds before the first look, as in irace."""
_GROWTH = math.sqrt(2.0)  # of the number of seeds from one look to the next


def looks(seeds: int) -> tuple[int, ...]:
    """After how many of the seeds candidates are compared: 5, 8, 12, 17 ..., below `seeds`."""
    counts: list[int] = []
    at = FIRST
    while at < seeds:
        counts.append(at)
        at = math.ceil(at * _GROWTH)
    return tuple(counts)


def losers(losses: Array, level: float) -> list[int]:
    """The columns of losses (seeds, candidates) that are worse than the leader at this level.

    Less is better; inf is a failed run, and no loss is NaN. The leader has the least sum of ranks.
    """
    from scipy.stats import f, rankdata, t, wilcoxon

    n, k = losses.shape
    if n < 2 or k < 2:
        return []
    ranks = rankdata(losses, axis=1)
    sums = ranks.sum(axis=0)
    leader = int(sums.argmin())
    if k == 2:
        follower = 1 - leader
        worse = _differences(losses[:, leader], losses[:, follower])
        if not worse.any():
            return []
        return [follower] if float(wilcoxon(worse).pvalue) <= level else []
    scatter = float((ranks**2).sum()) - n * k * (k + 1) ** 2 / 4.0
    if scatter <= 0.0:  # all are equal on each seed
        return []
    between = (k - 1) * float(((sums - n * (k + 1) / 2.0) ** 2).sum()) / scatter
    within = n * (k - 1) - between
    freedom = (n - 1) * (k - 1)
    if within > 1e-9 * n and f.sf((n - 1) * between / within, k - 1, freedom) > level:
        return []
    error = 2.0 * max(n * float((ranks**2).sum()) - float((sums**2).sum()), 0.0) / freedom
    bound = float(t.isf(level / (k - 1), freedom)) * math.sqrt(error)
    return [column for column in range(k) if sums[column] - sums[leader] > max(bound, 1e-9)]


def mean_loss(losses: Sequence[float]) -> tuple[int, float]:
    """For comparing candidates over the same seeds: the number of failed runs, then the mean."""
    finite = [loss for loss in losses if math.isfinite(loss)]
    return len(losses) - len(finite), sum(finite) / len(finite) if finite else math.inf


def _differences(a: Array, b: Array) -> Array:
    """b - a (n,); a failed run is worse than any other, and two of them are equal."""
    both = np.isfinite(a) & np.isfinite(b)
    finite = np.where(both, b, 0.0) - np.where(both, a, 0.0)
    far = 1.0 + float(np.abs(finite).max(initial=0.0))
    sign = np.isinf(b).astype(np.float64) - np.isinf(a)
    return np.where(both, finite, far * sign)
