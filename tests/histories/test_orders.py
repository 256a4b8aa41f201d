"""One run and one stop, each begun at each of some instants, while one robot is missing.

The last order counts, by when it was typed: after a later stop all robots stand, and after a later
run the robots run. The rules of `invariants.py` hold all the time.
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from itertools import product
from typing import Any

import pytest

from tests.histories.history import History, HistoryStep, step

INSTANTS = 20
STEP = 0.12  # s between two instants: a look waits some 2 s for the missing robot
WELL = 0.2  # s by which a run must be later than a stop to be later for sure, without a disturbance
MISSING: Mapping[str, tuple[HistoryStep, ...]] = {
    "frozen": (step(0.0, "freeze", robot="r4"),),
    "frozen for a while": (step(0.0, "freeze", robot="r4", seconds=0.9),),
    "absent": (step(0.0, "kill", robot="r4"),),
    "just booted": (step(0.0, "boot", robot="r5"),),
    "restarted": (step(0.0, "start", robot="r3"),),
}
DISTURBED: Mapping[str, Mapping[str, Any]] = {
    "by nothing": {},
    "by losses": {"loss": 0.3},
    "by copies": {"copies": (0.5, 2.0)},
    "by slow requests": {"slow_links": {"anna": 0.5}},
    "by slower requests": {"slow_links": {"anna": 2.0}},
    "by a slow stop": {"slow": {"bob": 0.5}},
    "by a slower stop": {"slow": {"bob": 2.0}},
    "by slow robots": {"slow": {"r1": 0.5, "r2": 2.0}},
    "by a slow operator": {"slow": {"anna": 2.0}, "slow_links": {"anna": 2.0}},
}
OPTIONS: tuple[Mapping[str, Any], ...] = (
    {},
    {"ahead": 2.0},
    {"on_join": "run", "valid": 60.0},
    {"has_goal": False},
)


def check(missing: str, disturbed: str, run_at: float, stop_at: float, seed: int) -> None:
    """Let one history happen; BrokenRuleError or AssertionError if the last order does not win."""
    history, chance = History(4, seed), random.Random(seed)
    swarm = history.swarm
    for one in MISSING[missing]:
        history.carry_out(one)
    for name, value in DISTURBED[disturbed].items():
        setattr(swarm, name, value)
    options = {} if seed % 3 else chance.choice(OPTIONS)
    stop = "stop" if seed % 5 else chance.choice(("estop", "program_stop"))
    orders = [
        (run_at, step(0.0, "run", by="anna", **options)),
        (stop_at, step(0.0, stop, by="bob")),
    ]
    begun = swarm.now
    for at, order in sorted(orders, key=lambda pair: pair[0]):
        swarm.advance(begun + at - swarm.now)
        history.carry_out(order)
    history.await_commands()
    swarm.slow, swarm.slow_links, swarm.copies = {}, {}, ()
    history.end()
    running = {name for name, one in swarm.robots.items() if one.robot.is_running}
    text = (
        f"{missing}, disturbed {disturbed}, run at {run_at:.2f} {options}, {stop} at {stop_at:.2f}"
    )
    if stop_at > run_at:
        assert not running, f"{text}: {sorted(running)} run"
    elif stop == "stop" and disturbed == "by nothing" and run_at - stop_at >= WELL:
        assert {"r1", "r2"} <= running, f"{text}: {sorted({'r1', 'r2'} - running)} stand"


def search(seed: int, share: float) -> int:
    """Check a share of all pairs of instants, for each missing robot; returns their count."""
    chance, count = random.Random(seed), 0
    for missing, run, stop in product(MISSING, range(INSTANTS), range(INSTANTS)):
        if chance.random() < share:
            count += 1
            disturbed = chance.choice(tuple(DISTURBED))
            check(missing, disturbed, STEP * run, STEP * stop, chance.randrange(1000))
    return count


def test_the_last_order_wins() -> None:
    assert search(1, 0.002) > 0


@pytest.mark.evidence
@pytest.mark.parametrize("seed", range(4))
def test_the_last_order_wins_at_each_instant(seed: int) -> None:
    assert search(seed, 1.0) == len(MISSING) * INSTANTS**2
