"""The states in which robots of the hardware arena spend their time and lose their last link.

A robot loses its last link if it was within LINK of a robot, and then is farther than LINK from all
robots for HOLD. The robot that drives away may be the other one: a loss counts for both, each with
its own state. If the range of the robots is less than LINK, a robot searches before it loses the
link. The origin of a loss is the last state of the robot before it searched.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.metrics import aggregation
from swarmd.sim.trace import Trace

LINK = 1.0
"""m, between axle centres."""
HOLD = 1.0
"""s; without it, a robot at the distance LINK would lose its link again and again."""
ORDER = ("search", "gather", "settled", "roll", "lead")
"""The order of known states. Other states follow by name."""

SEARCH = ORDER[0]
KINDS = ("time", "losses", "origins")

Counts = Mapping[str, Array]
"""(3,) instants in a state, losses in it, and losses of which it is the origin, by state."""


def losses(trace: Trace) -> NDArray[np.bool_]:
    """(T, n) whether the robot loses its last link at this instant."""
    is_linked = aggregation.nearest_neighbors(trace) <= LINK
    is_lost = np.zeros_like(is_linked)
    is_lost[1:] = is_linked[:-1] & ~is_linked[1:]
    for instant, robot in np.argwhere(is_lost):
        span = trace.t <= trace.t[instant] + HOLD
        is_lost[instant, robot] = not is_linked[instant:, robot][span[instant:]].any()
    return is_lost


def origins(states: NDArray[np.str_], is_lost: NDArray[np.bool_]) -> list[str]:
    """The origin of each loss: the last state that is not SEARCH; SEARCH without one.

    `states`, `is_lost`: (T, n).
    """
    found = []
    for instant, robot in np.argwhere(is_lost):
        others = [state for state in states[: instant + 1, robot] if state not in ("", SEARCH)]
        found.append(str(others[-1]) if others else SEARCH)
    return found


def counts_of(traces: Iterable[Trace]) -> dict[str, Array]:
    """The counts of all runs; instants without a report do not count."""
    found: dict[str, Array] = {}
    for trace in traces:
        states, is_lost = trace.words["state"], losses(trace)
        first = origins(states, is_lost)
        for state in {*np.unique(states[states != ""]).tolist(), *first}:
            is_in = states == state
            counts = is_in.sum(), (is_in & is_lost).sum(), first.count(state)
            found[state] = found.get(state, 0) + np.array(counts, dtype=np.float64)
    return found


def shares(counts: Counts) -> dict[str, Array]:
    """The shares (3,) of all instants, losses and origins, by state; 0 without losses."""
    totals = np.maximum(sum(counts.values(), np.zeros(3)), 1.0)
    return {state: some / totals for state, some in counts.items()}


def states_of(by_row: Mapping[str, Counts]) -> list[str]:
    """The states of all rows, in the order of ORDER."""
    found = {state for counts in by_row.values() for state in counts}
    known = [state for state in ORDER if state in found]
    return [*known, *sorted(found - set(known))]


def state_rows(by_row: Mapping[str, Counts], runs: Mapping[str, int]) -> list[list[str]]:
    """The rows of the table with its head: percent of KINDS in each state.

    `runs`: the number of runs of each row.
    """
    states = states_of(by_row)
    rows = [[" / ".join(KINDS), "losses a run", *states]]
    for row, counts in by_row.items():
        lost = sum(some[1] for some in counts.values()) / runs[row]
        some = [shares(counts).get(state, np.zeros(3)) for state in states]
        rows.append([row, f"{lost:.1f}", *(" / ".join(f"{a:.0%}" for a in cell) for cell in some)])
    return rows
