"""Patterns that need places of neighbours: by boards, by shared poses, and with robots at rest.

The scenario of each pattern runs in lockstep with range-and-bearing boards, with poses in a shared
frame (`radio.places: shared`), and with boards on robots that never move. `make evidence` with
`ARGS="-s -k shared_poses"` prints the figures of the patterns' pages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from studies.outcomes.patterns import hexagonal_lattice, lloyd_coverage
from studies.outcomes.still import still_robots
from swarmd.patterns.hexagonal_lattice.metrics import bonds_near_distance
from swarmd.patterns.leader_following.metrics import gap_error
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import Trace

SOURCES = BOARD, SHARED, STILL = "boards", "shared poses", "at rest"
SHARED_SET = {"radio.range_and_bearing": False, "radio.places": "shared"}
ENOUGH = 0.8
"""The share of the boards' figure that shared poses have to reach."""
SEEDS = {"shepherding": 5, "chain_formation": 8}
"""Runs of each source; twenty of the patterns that are not named."""
_LATE = 1.0 / 3.0  # of a run, over which the polarisation is averaged


@dataclass(frozen=True, slots=True)
class Figure:
    """What is measured of a run, in words, and whether more of it is better."""

    what: str
    of: Callable[[Trace], float]
    is_more_better: bool = True
    changes: Mapping[str, Any] = field(default_factory=dict)


def _polarisation(trace: Trace) -> float:
    late = trace.pose[int(len(trace.t) * (1.0 - _LATE)) :, :, 2]
    return float(np.abs(np.exp(1j * late).mean(axis=1)).mean())


def _joined(trace: Trace) -> float:
    return float((trace.report["leads"][:, trace.ids.index("nest-01")] > 0.0).any())


def _gap_error(trace: Trace) -> float:
    error = gap_error(trace)
    return math.inf if error is None else error


def _arrived(trace: Trace) -> float:
    return float((trace.words["state"][:, trace.ids.index("shepherd-01")] == "arrived").any())


FIGURES = {
    "chain_formation": Figure("runs in which a chain joins both", _joined),
    "hexagonal_lattice": Figure(
        "share of bonds within 10 % of the distance",
        bonds_near_distance,
        changes={"duration": hexagonal_lattice.SECONDS},
    ),
    "leader_following": Figure(
        "largest difference of a gap from the policy's [m]",
        _gap_error,
        is_more_better=False,
    ),
    "lloyd_coverage": Figure(
        "cost at the end [m2]",
        lambda trace: lloyd_coverage.cost(trace.pose[-1, :, :2]),
        is_more_better=False,
    ),
    "shepherding": Figure("runs in which the herd arrives", _arrived),
    "vicsek_alignment": Figure("polarisation over the last 20 s", _polarisation),
}


def run(given: tuple[str, str, int], more: Mapping[str, Any] | None = None) -> float:
    """The figure of one run, by pattern, source of places and seed."""
    name, source, seed = given
    figure = FIGURES[name]
    changes = {**figure.changes, **(SHARED_SET if source == SHARED else {}), **(more or {})}
    with still_robots(name) if source == STILL else nullcontext():
        (trace,) = simulate(name, [seed], jobs=1, set=changes).traces
    return figure.of(trace)


def figures_of(name: str, seeds: Sequence[int]) -> dict[str, list[float]]:
    """The figures of a pattern by source of places, a value for each seed."""
    return {source: [run((name, source, seed)) for seed in seeds] for source in SOURCES}


def show(name: str, figures: Mapping[str, Sequence[float]]) -> None:
    """Print least, median, most and mean of a pattern's figures by source of places."""
    for source, values in figures.items():
        low, mid, high = np.percentile(values, (0.0, 50.0, 100.0))
        print(f"{name}: {FIGURES[name].what}, {source}: {low:.3g} / {mid:.3g} / {high:.3g},"
              f" mean {np.mean(values):.3g}")  # fmt: skip


def reached(name: str, board: Sequence[float], shared: Sequence[float]) -> float:
    """How much of the mean figure of boards shared poses reach; more is better."""
    ratio = float(np.mean(shared) / np.mean(board))
    return ratio if FIGURES[name].is_more_better else 1.0 / ratio


@pytest.mark.evidence
@pytest.mark.parametrize("name", FIGURES)
def test_shared_poses_reach_what_boards_reach_and_robots_at_rest_do_not(name: str) -> None:
    figures = figures_of(name, range(SEEDS.get(name, 20)))
    show(name, figures)
    assert reached(name, figures[BOARD], figures[SHARED]) >= ENOUGH
    assert reached(name, figures[BOARD], figures[STILL]) < ENOUGH


@pytest.mark.evidence
def test_leader_following_by_kin_reaches_what_boards_reach() -> None:
    """The table "Following by kin" of docs/evidence/kin.md."""
    without = {"radio.range_and_bearing": False}
    figures = {
        BOARD: [run(("leader_following", BOARD, seed)) for seed in range(20)],
        "kin": [run(("leader_following", "kin", seed), without) for seed in range(20)],
    }
    show("leader_following", figures)
    assert reached("leader_following", figures[BOARD], figures["kin"]) >= ENOUGH


@pytest.mark.long
def test_burgers_spread_by_shared_poses_and_not_at_rest() -> None:
    changes = {"duration": 25.0, "groups.tb3.count": 4}
    shared, still = (run(("lloyd_coverage", source, 0), changes) for source in (SHARED, STILL))
    assert shared < 0.6 * still
