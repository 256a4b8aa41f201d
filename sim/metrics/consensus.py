"""Consensus of a swarm, by the opinions that its patterns report.

Only present robots count. A robot that has reported no opinion agrees with no other. Consensus and
the time to it are as in the literature on collective decisions (Valentini, Ferrante and Dorigo,
The Best-of-n Problem in Robot Swarms, Frontiers in Robotics and AI 2017).
"""

from __future__ import annotations

import numpy as np

from swarmd.core.values import OPINION, Array
from swarmd.sim.metrics.metric import SHARE, Metric
from swarmd.sim.metrics.window import presence
from swarmd.sim.trace import Trace


def consensus_shares(trace: Trace) -> Array | None:
    """(T,) the share of the present robots that hold the most common opinion.

    NaN without a present robot; None if no robot ever reported an opinion.
    """
    opinion = trace.report.get(OPINION)
    if opinion is None or np.isnan(opinion).all():
        return None
    is_present = presence(trace)
    held = np.where(is_present, opinion, np.nan)
    most = np.zeros(len(trace.t), dtype=np.int64)
    for value in np.unique(held[~np.isnan(held)]):
        most = np.maximum(most, np.count_nonzero(held == value, axis=1))
    here = is_present.sum(axis=1)
    shares: Array = np.where(here > 0, most / np.maximum(here, 1), np.nan)
    return shares


def consensus_share(trace: Trace) -> float | None:
    """`consensus_shares` at the last instant; None if unknown."""
    shares = consensus_shares(trace)
    return None if shares is None or np.isnan(shares[-1]) else float(shares[-1])


def consensus_opinion(trace: Trace) -> float | None:
    """The opinion of all present robots at the last instant; None if they do not agree."""
    if consensus_share(trace) != 1.0:
        return None
    return float(trace.report[OPINION][-1][presence(trace)[-1]][0])


def consensus_time(trace: Trace) -> float | None:
    """Seconds from the start until all present robots hold the final opinion to the end.

    A common opinion that the swarm later gives up does not count. None if the robots do not agree
    at the end.
    """
    final = consensus_opinion(trace)
    if final is None:
        return None
    is_present = presence(trace)
    agree = ((trace.report[OPINION] == final) | ~is_present).all(axis=1) & is_present.any(axis=1)
    broken = np.flatnonzero(~agree)
    since = int(broken[-1]) + 1 if len(broken) else 0
    return float(trace.t[since] - trace.t[0])


_VALENTINI = "Valentini et al. 2017, Front. Robot. AI 4:9"

METRICS = (
    Metric("consensus_time", "s", "until all robots hold one opinion, and keep it to the end",
           _VALENTINI, consensus_time, better="less", is_time_to_event=True, event="consensus"),
    Metric("consensus_share", "share", "robots that hold the most common opinion at the end",
           _VALENTINI, consensus_share, consensus_shares, "more", bounds=SHARE),
    Metric("consensus_opinion", "", "the opinion that all robots hold at the end", _VALENTINI,
           consensus_opinion),
)  # fmt: skip
