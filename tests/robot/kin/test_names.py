"""The table of docs/evidence/kin.md: names among pillars in runs of lockstep."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import pytest
from msgspec.structs import replace

from swarmd.core.kin_message import KinMessage
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.kin_judge import Counts, play, record

POLES = (
    (1.2, 1.2, 0.12),
    (-1.5, 0.8, 0.12),
    (0.3, -1.6, 0.15),
    (-0.6, 2.1, 0.1),
    (2.0, -0.9, 0.12),
)
WALKERS = {
    "platform": "waffle_pi",
    "prefix": "tb3",
    "count": 6,
    "start": {"layout": "random", "clearance": 0.3},
    "pattern": "random_walk",
}
PAIR = {
    "platform": "waffle_pi",
    "prefix": "pair",
    "count": 2,
    "start": {"layout": "list", "poses": [[-3.2, -3.4, 0], [-2.0, -3.4, 0]]},
    "pattern": "drive",
    "parameters": {"speed": 0.1, "turn": 0.2},
}
AT_REST = {**WALKERS, "pattern": "drive", "parameters": {"speed": 0.0, "turn": 0.0}}
SLIP = {"preset": "realistic", "odometry": {"slip": 0.1}}


class Row(NamedTuple):
    """A row of the table; `pair`: the rows of the two robots, or of the one, whose sights count."""

    seeds: range
    groups: dict[str, Any]
    more: Mapping[str, Any] = MappingProxyType({})
    size: float = 6.0
    pair: frozenset[int] = frozenset()
    change: Callable[[KinMessage], KinMessage] = lambda told: told
    named: float = 0.6  # at least
    right: float = 0.97


ROWS = {
    "all walk": Row(range(150, 170), {"all": WALKERS}, right=0.99),
    "two in step": Row(
        range(160, 164),
        {"pair": PAIR, "walkers": {**WALKERS, "count": 4}},
        {},
        9.0,
        frozenset({0, 1}),
    ),
    "one at rest": Row(
        range(160, 164),
        {"all": WALKERS},
        {
            "events": [
                {"at": 15, "stop": "tb3-01"},
                {"at": 45, "run": "random_walk", "targets": "tb3-01"},
            ]
        },
        pair=frozenset({0}),
    ),
    "slip": Row(range(160, 163), {"all": WALKERS}, {"realism": SLIP}),
    "twelve": Row(range(160, 162), {"all": {**WALKERS, "count": 12}}, size=8.0, right=0.99),
    "no objects told": Row(
        range(160, 163), {"all": WALKERS}, change=lambda told: replace(told, objects=b""), named=0.0
    ),
    "all at rest": Row(range(160, 163), {"all": AT_REST}, named=0.0),
}


def counts_of(row: Row, seeds: range) -> Counts:
    scenario = scenario_of(
        {
            "duration": 60,
            "trace_rate": 10,
            "arena": {
                "size": [row.size, row.size],
                "poles": [{"at": [x, y], "radius": radius} for x, y, radius in POLES],
            },
            "realism": "realistic",
            "groups": row.groups,
            **row.more,
        }
    )
    counts = Counts()

    def is_counted(viewer: int, seen: int) -> bool:
        return row.pair <= {viewer, seen}

    for seed in seeds:
        play(record(scenario, seed), counts, seed, change=row.change, counted=is_counted)
    return counts


@pytest.mark.evidence
@pytest.mark.parametrize("name", ROWS)
def test_names_among_pillars(name: str) -> None:
    row = ROWS[name]
    counts = counts_of(row, row.seeds)
    print(f"{name}: {counts.row()}")
    assert counts.pillars_named <= 0.002 * counts.pillars
    assert counts.named >= row.named * counts.sights
    assert counts.right >= row.right * counts.named
    assert counts.named == 0 or row.named > 0.0


@pytest.mark.long
@pytest.mark.compiled_only(reason="a long simulated run")
def test_names_of_one_run_are_right() -> None:
    counts = counts_of(ROWS["all walk"], range(150, 151))
    assert counts.named >= 0.5 * counts.sights
    assert counts.right >= 0.97 * counts.named
    assert counts.pillars_named <= 0.002 * counts.pillars
