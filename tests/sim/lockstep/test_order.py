"""The order of groups and robots in a file changes nothing; no place in it favours a robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import permutations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from swarmd.core.values import Array
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

UNLIKELY = 1e-4
"""An outcome that chance alone brings about more rarely fails a test."""


class Graph(NamedTuple):
    """Places of robots in m, and a range of the radio in m. Robot 0 alone holds opinion 1."""

    places: Array
    reach: float


GRAPHS: Mapping[str, Graph] = {
    "star, the hub": Graph(
        np.array([(0.0, 0.0)] + [(2.0 * math.cos(a), 2.0 * math.sin(a))
                                 for a in 0.4 * math.pi * np.arange(5)]), 2.2),
    "star, a leaf": Graph(
        np.array([(2.0, 0.0), (0.0, 0.0)] + [(2.0 * math.cos(a), 2.0 * math.sin(a))
                                             for a in 0.4 * math.pi * np.arange(1, 5)]), 2.2),
    "path, an end": Graph(np.array([(i - 1.5, 0.0) for i in range(4)]), 1.1),
    "path, the second": Graph(np.array([(i - 1.5, 0.0) for i in (1, 0, 2, 3)]), 1.1),
    "complete": Graph(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]), 2.0),
}  # fmt: skip
EXACT = {
    "star, the hub": 0.5,
    "star, a leaf": 0.1,
    "path, an end": 1.0 / 6.0,
    "path, the second": 1.0 / 3.0,
    "complete": 0.25,
}
"""Degree over the sum of degrees: Sood and Redner, PRL 94, 178701, 2005."""


def exact_share(graph: Graph) -> float:
    """How often opinion 1 wins: the exact chain of the rule as it is implemented.

    Windows of equal length begin at phases that are drawn evenly. So the robots decide in turn, in
    an order that stays, and each order is equally likely. Each adopts the opinion of one of its
    neighbours.
    """
    n = len(graph.places)
    apart = np.hypot(*(graph.places[:, None] - graph.places[None]).T)
    links = (apart < graph.reach) & ~np.eye(n, dtype=bool)
    states = np.arange(2**n)
    steps = np.zeros((n, 2**n, 2**n))
    for robot in range(n):
        heard = sum((states >> other) & 1 for other in np.flatnonzero(links[robot]).tolist())
        share = np.asarray(heard) / links[robot].sum()
        steps[robot, states, states | (1 << robot)] += share
        steps[robot, states, states & ~(1 << robot)] += 1.0 - share
    shares = []
    for order in permutations(range(n)):
        chances = np.zeros(2**n)
        chances[1] = 1.0
        while chances[0] + chances[-1] < 1.0 - 1e-6:
            for robot in order:
                chances = chances @ steps[robot]
        shares.append(chances[-1])
    return float(np.mean(shares))


def debate(graph: Graph, names: Sequence[str], order: Sequence[int], window: float) -> Any:
    """A scenario of the voter model: robot i has `names[i]`, the file has them in `order`."""
    groups = {
        f"group-{i}": {
            "platform": "burger",
            "robots": [names[i]],
            "pattern": "voter_model",
            "parameters": {"initial": int(i == 0)},
            "start": {"poses": [[*graph.places[i].tolist(), 0.0]]},
        }
        for i in order
    }
    voting = {"opinions": 2, "window": window, "share_period": window / 2.0, "expiry": 3.0}
    return {
        "duration": 60.0,
        "arena": {"size": [8.0, 8.0]},
        "realism": "ideal",
        "radio": {"neighborhood": "range", "range": graph.reach},
        "groups": groups,
        "parameters": {"voter_model": voting},
        "trace_rate": 1.0,
    }


def winner(data: Mapping[str, Any], seed: int) -> int:
    """The opinion of all robots, once they agree."""
    run = Lockstep(scenario_of(data), seed)
    while True:
        run.advance(0.5)
        opinions = {shell.robot.report["opinion"] for shell in run.shells if shell is not None}
        if len(opinions) == 1:
            return int(opinions.pop())


@pytest.mark.parametrize(
    "name",  # those of six robots have 720 orders
    [pytest.param(name, marks=[pytest.mark.evidence] * ("star" in name)) for name in GRAPHS],
)
def test_the_exact_chain_has_the_weights_of_the_theory(name: str) -> None:
    assert exact_share(GRAPHS[name]) == pytest.approx(EXACT[name], abs=1e-5)


@pytest.mark.parametrize("place", ["first", "last"])
@pytest.mark.parametrize(
    ("name", "runs"),
    [
        ("complete", 8),  # of which all would be won by chance once in 60,000 times
        *(pytest.param(name, 400, marks=pytest.mark.evidence) for name in GRAPHS),
    ],
)
def test_an_opinion_wins_as_often_as_the_exact_chain_has_it(
    name: str, place: str, runs: int
) -> None:
    """Its robot has the first name and the first line of the file, or the last ones."""
    from scipy.stats import binomtest  # a second of each worker, if it stood at the top

    graph = GRAPHS[name]
    n = len(graph.places)
    ranks = range(n) if place == "first" else range(n - 1, -1, -1)
    names = [f"r-{rank}" for rank in ranks]
    data = debate(graph, names, list(ranks), window=0.5)
    won = sum(winner(data, seed) for seed in range(runs))
    assert binomtest(won, runs, EXACT[name]).pvalue > UNLIKELY


PROBE = """
from swarmd.api import Outputs, Params, Pattern

class Probe(Pattern[Params]):
    params_type = Params
    needs = frozenset({"scan"})
    channels = {"word": int}

    def __init__(self, params, context):
        self.heard, self.is_new = 0, True

    def step(self, inputs):
        self.heard += len(inputs.messages)
        word = {"word": 1} if self.is_new else {}
        self.is_new = False
        return Outputs(messages=word, report={"heard": self.heard, "near": len(inputs.neighbors)})
"""


def probes(folder: Path, **changes: Any) -> Trace:
    """Four robots, each of which says one word in its first step."""
    (folder / "probe.py").write_text(PROBE)
    data: dict[str, Any] = {
        "duration": 2.0,
        "trace_rate": 100.0,
        "arena": {"size": [20.0, 20.0]},
        "groups": {
            name: {"platform": "burger", "robots": [f"{name}-1", f"{name}-2"], "pattern": "probe"}
            for name in ("b", "a")
        },
        "start": {"layout": "row", "spacing": 2.0},
        "radio": {"neighborhood": "range", "range": 9.0},
        "plugin_dir": str(folder),
    }
    return simulate_run(scenario_of({**data, **changes}), 0)


def test_robots_that_start_at_one_instant_hear_each_others_first_word(tmp_path: Path) -> None:
    trace = probes(tmp_path)
    assert (trace.report["near"][0] == 3.0).all()
    assert (trace.report["heard"][10] == 3.0).all()


def test_robots_that_join_at_one_instant_and_the_others_hear_each_other(tmp_path: Path) -> None:
    joining = [
        {"at": 1.0, "join": ["b-2", "b-1"]},
        {"at": 1.0, "join": ["a-2"]},
        {"at": 1.0, "run": "probe"},
    ]
    trace = probes(tmp_path, events=joining)
    at = int(np.searchsorted(trace.t, 1.0 - 1e-9))
    assert (trace.report["near"][at] == 3.0).all()
    assert (trace.report["heard"][at + 10] == 3.0).all()


def test_robots_that_join_at_one_instant_share_the_emergency_stop_of_one(tmp_path: Path) -> None:
    """b-2, the last by name, holds it from its earlier life; no other has seen it."""
    events = [
        {"at": 0.3, "estop": "all"},
        {"at": 0.5, "kill": "b-2"},
        {"at": 1.0, "join": ["b-2", "b-1", "a"]},
    ]
    trace = probes(tmp_path, events=events)
    assert trace.state is not None
    at = int(np.searchsorted(trace.t, 1.0 - 1e-9))
    assert set(trace.state[at]) == {"estopped"}


VOTERS: dict[str, Any] = {
    "duration": 4.0,
    "arena": {"size": [8.0, 8.0]},
    "radio": {"neighborhood": "range", "range": 3.0, "loss": 0.2, "delay": 0.05, "jitter": 0.02},
    "groups": {
        "hubs": {"platform": "burger", "robots": ["m-1"], "pattern": "voter_model",
                 "start": {"poses": [[0.0, 0.0, 0.0]]}},
        "leaves": {"platform": "burger", "robots": ["z-1", "a-1", "n-1"],
                   "pattern": "voter_model",
                   "start": {"poses": [[2.0, 0.0, 0.0], [-2.0, 0.0, 0.0], [0.0, 2.0, 90.0]]}},
    },
}  # fmt: skip
GATHERING: dict[str, Any] = {
    "duration": 6.0,
    "arena": {"size": [8.0, 8.0]},
    "radio": {"range_and_bearing": True},
    "accepts_faster": ["waffle_pi"],
    "groups": {
        "slow": {"platform": "burger", "robots": ["s-1", "k-2"], "pattern": "attraction",
                 "start": {"poses": [[1.0, 1.0, 0.0], [-1.0, 0.5, 90.0]]}},
        "fast": {"platform": "waffle_pi", "robots": ["w-2", "a-1"], "pattern": "attraction",
                 "start": {"layout": "list", "poses": [[0.0, -1.0, 0.0], [2.0, -1.0, 180.0]]}},
    },
}  # fmt: skip
PUSHING: dict[str, Any] = {
    "duration": 6.0,
    "arena": {"size": [8.0, 8.0], "boxes": [
        {"name": "crate", "at": [0.0, 0.0], "size": [0.3, 1.2], "mass": 2.0}]},
    "platforms": {"pusher": {"extends": "waffle_pi", "protection": {"mode": "off"}}},
    "parameters": {"drive": {"speed": 0.2}},
    "groups": {
        "west": {"platform": "pusher", "robots": ["w-1", "a-1"], "pattern": "drive",
                 "start": {"poses": [[-0.6, -0.3, 0.0], [-0.6, 0.3, 0.0]]}},
        "south": {"platform": "pusher", "robots": ["p-1", "b-1"], "pattern": "drive",
                  "start": {"poses": [[-1.2, -0.3, 0.0], [-0.6, -1.0, 80.0]]}},
    },
}  # fmt: skip
DISPERSING: dict[str, Any] = {
    "duration": 4.0,
    "arena": {"size": [6.0, 6.0]},
    "start": {"layout": "random", "clearance": 0.1, "size": [3.0, 3.0]},
    "groups": {
        "red": {"platform": "burger", "robots": ["r-3", "r-1"], "pattern": "dispersion"},
        "blue": {"platform": "burger", "robots": ["s-1", "q-2"], "pattern": "dispersion"},
        "rest": {"platform": "burger", "robots": ["x-1"], "pattern": "discussed_dispersion",
                 "parameters": {"discuss": 1.0}},
    },
}  # fmt: skip


def reversed_file(data: Mapping[str, Any]) -> dict[str, Any]:
    """The same robots at the same places, in the opposite order."""
    turned = deepcopy(dict(data))
    turned["groups"] = dict(reversed(turned["groups"].items()))
    for group in turned["groups"].values():
        group["robots"] = group["robots"][::-1]
        if "poses" in group.get("start", {}):
            group["start"]["poses"] = group["start"]["poses"][::-1]
    return turned


def arrays(trace: Trace) -> dict[str, NDArray[Any]]:
    plain = {name: getattr(trace, name) for name in ("t", "pose", "safe", "requested", "state")}
    contacts = {"contact_t": trace.contact_t, "contact_speed": trace.contact_speed}
    return {**plain, **contacts, **trace.report, **trace.words}


@pytest.mark.short_rows(1)
@pytest.mark.parametrize(
    "data", [VOTERS, GATHERING, PUSHING, DISPERSING], ids=["vote", "gather", "push", "disperse"]
)
def test_the_order_of_groups_and_robots_in_a_file_changes_no_bit(data: dict[str, Any]) -> None:
    one, other = (simulate_run(scenario_of(some), 3) for some in (data, reversed_file(data)))
    assert one.ids == other.ids
    for name, values in arrays(one).items():
        np.testing.assert_array_equal(values, arrays(other)[name], err_msg=name)


def farthest(data: Mapping[str, Any], seed: int) -> int:
    """The rank by name of the robot that moves the farthest."""
    trace = simulate_run(scenario_of(data), seed)
    return int(np.hypot(*(trace.pose[-1, :, :2] - trace.pose[0, :, :2]).T).argmax())


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("runs", [8, pytest.param(400, marks=pytest.mark.evidence)])
@pytest.mark.parametrize(("pattern", "side"), [("attraction", 2.0), ("dispersion", 0.7)])
def test_equal_robots_move_the_farthest_equally_often(pattern: str, side: float, runs: int) -> None:
    """Four robots at the corners of a square, each with its heading towards the next corner."""
    from scipy.stats import chisquare

    half = side / 2.0
    poses = [[-half, -half, 0.0], [half, -half, 90.0], [half, half, 180.0], [-half, half, -90.0]]
    data = {
        "duration": 4.0,
        "arena": {"size": [8.0, 8.0]},
        "groups": {"all": {"platform": "burger", "count": 4, "prefix": "r", "pattern": pattern}},
        "start": {"layout": "list", "poses": poses},
    }
    counts = np.bincount([farthest(data, seed) for seed in range(runs)], minlength=4)
    assert chisquare(counts).pvalue > UNLIKELY
