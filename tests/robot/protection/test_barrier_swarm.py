"""Two robots in MuJoCo, whose contacts judge independently of protection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from swarmd.core.messages import State
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.metrics.gap import minimum_gap
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from swarmd.sim.trace import Trace
from tests.support.kernel_forms import long_run

pytestmark = long_run

NO_FAULT = 0.02
KINDS = ("burger", "waffle_pi", "jackal")
SPEEDS = {"burger": 0.22, "waffle_pi": 0.26, "jackal": 0.5}
Pose = tuple[float, float, float]


def group(platform: str, name: str, pose: Pose, speed: float, turn: float = 0.0) -> dict[str, Any]:
    """One robot that drives at a constant speed."""
    return {
        "platform": platform,
        "robots": [name],
        "pattern": "drive",
        "parameters": {"speed": speed, "turn": turn, "recovery": False},
        "start": {"layout": "list", "poses": [[*pose[:2], math.degrees(pose[2])]]},
    }


def meeting(*groups: dict[str, Any], seed: int = 1, **keys: Any) -> Trace:
    """The trace of a run of `scene`."""
    return simulate_run(scene(*groups, **keys), seed)


def scene(
    *groups: dict[str, Any],
    duration: float = 12.0,
    visibility: str = "body",
    arena: dict[str, Any] | None = None,
    events: Sequence[dict[str, Any]] = (),
) -> Scenario:
    """Platforms `ram-*` are unprotected, `seeing-*` are fully visible."""
    barrier = {kind: {"extends": kind, "protection": {"mode": "barrier"}} for kind in KINDS}
    free = {f"ram-{kind}": {"extends": kind, "protection": {"mode": "off"}} for kind in KINDS}
    whole = {"mode": "barrier", "barrier": {"unseen_extent": 0.0}}
    seeing = {f"seeing-{kind}": {"extends": kind, "protection": whole} for kind in KINDS}
    data = {
        "duration": duration,
        "lidar_visibility": visibility,
        "arena": {"size": [12.0, 12.0], **(arena or {})},
        "accepts_faster": list(free),
        "platforms": {**barrier, **free, **seeing},
        "groups": {f"group-{one['robots'][0]}": one for one in groups},
        "events": list(events),
    }
    return scenario_of(data)


def first_touch(trace: Trace, name: str = "a") -> float:
    """The closing speed in m/s of a robot's own surface at its first contact.

    Later contacts do not count: the impact pushes the robot around.
    """
    own = trace.contact_pair == trace.ids.index(name)
    speeds = trace.contact_speed[own]
    return float(speeds[0]) if len(speeds) else 0.0


def driven(trace: Trace, name: str = "a") -> float:
    """The greatest distance of a robot from its start, in m."""
    path = trace.pose[:, trace.ids.index(name), :2]
    return float(np.hypot(*(path - path[0]).T).max())


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("visibility", ["body", "real"])
@pytest.mark.parametrize("kind", KINDS)
def test_two_robots_that_drive_at_each_other_stop(kind: str, visibility: str) -> None:
    speed = SPEEDS[kind]
    trace = meeting(
        group(kind, "a", (-2.0, 0.0, 0.0), speed),
        group(kind, "b", (2.0, 0.06, math.pi), speed),
        visibility=visibility,
    )
    assert len(trace.contact_t) == 0
    assert min(driven(trace, "a"), driven(trace, "b")) > 1.0


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", [1.0, -1.0], ids=["ahead", "reversing"])
def test_robot_stops_at_a_wall(kind: str, way: float) -> None:
    trace = meeting(group(kind, "a", (way * 4.0, 0.0, 0.2), way * SPEEDS[kind]))
    assert len(trace.contact_t) == 0
    assert driven(trace) > 0.7


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("kind", ["burger", "waffle_pi"])
@pytest.mark.parametrize("bearing", [0.0, 1.2, math.pi])
def test_rammed_robot_is_not_at_fault(kind: str, bearing: float) -> None:
    """The rammed robot drives at the rammer, or backs at one from behind."""
    x, y = 1.6 * math.cos(bearing), 1.6 * math.sin(bearing)
    way = -1.0 if bearing > 2.0 else 1.0
    trace = meeting(
        group(kind, "a", (0.0, 0.0, 0.0), 0.5 * way * SPEEDS[kind]),
        group(f"ram-{kind}", "b", (x, y, bearing + math.pi), SPEEDS[kind]),
    )
    assert first_touch(trace) <= NO_FAULT


@pytest.mark.parametrize(
    ("visibility", "seed", "duration"), [("body", 8019, 45.0), ("real", 8000, 60.0)]
)
def test_robots_in_a_jam_do_not_touch(
    visibility: str, seed: int, duration: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Locked robots creep out, and keep off what may be a peer, since they hear each other.

    The control is the same run of robots that hear no peer.
    """
    changes = {
        "groups.all.parameters.law": "paper",
        "lidar_visibility": visibility,
        "duration": duration,
    }
    jam = load_scenario("paper_exp1_hardware", changes)
    assert len(simulate_run(jam, seed).contact_t) == 0
    monkeypatch.setattr(Lockstep, "_update_peers", lambda *_: None)
    assert len(simulate_run(jam, seed).contact_t) > 0


def test_robot_stops_at_a_thin_pole() -> None:
    arena = {"poles": [{"at": [0.0, 0.05], "radius": 0.03}]}
    trace = meeting(group("burger", "a", (-1.2, 0.0, 0.0), 0.22), duration=6.0, arena=arena)
    assert len(trace.contact_t) == 0
    assert driven(trace) > 0.7


def test_jackal_rammed_out_of_its_blind_zone_is_not_at_fault() -> None:
    """Its lidar loses the rammer at 0.8 m."""
    trace = meeting(
        group("jackal", "a", (-1.0, 0.0, 0.0), 0.5),
        group("ram-jackal", "b", (1.0, 0.1, math.pi), 0.5),
        duration=6.0,
    )
    assert len(trace.contact_t) > 0
    assert first_touch(trace) <= NO_FAULT


@pytest.mark.short_rows(1)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_resting_robot_that_is_rammed_twice_faster_than_declared_goes_on(seed: int) -> None:
    """A Jackal drives at 0.5 m/s into a Burger, backs, and comes again."""
    turns = ((3.6, -0.5), (6.6, 0.5))
    lab = Lockstep(
        scene(
            group("burger", "a", (0.0, 0.0, 0.0), 0.0),
            group("ram-jackal", "b", (1.7, 0.0, math.pi), 0.5),
            events=[{"at": at, "param": {"speed": speed}, "targets": "b"} for at, speed in turns],
        ),
        seed,
    )
    lab.advance(12.0)
    contacts = lab.trace().contact_t
    assert min(contacts) < turns[0][0] + 0.5
    assert max(contacts) > turns[1][0]
    robot = lab.shells[0]
    assert robot is not None
    status = robot.robot.status(lab.world.time)
    assert status.findings[0].startswith("2 things came at")
    assert status.state is State.RUNNING


def test_turning_robot_does_not_swing_into_one_that_passes() -> None:
    """The other robot is unprotected; it passes within reach of the rear corners.

    The turn may end with a corner in its way: then the other one hits a robot at rest.
    """
    trace = meeting(
        group("burger", "a", (0.0, 0.0, 0.0), 0.0, 2.84),
        group("ram-burger", "b", (-0.2, 1.5, -math.pi / 2), 0.22),
        duration=8.0,
    )
    assert first_touch(trace) <= NO_FAULT
    assert driven(trace, "b") > 1.5
    assert np.ptp(np.cos(trace.pose[:, trace.ids.index("a"), 2])) > 1.0  # it has turned


@pytest.mark.parametrize("seed", [1, 4])
def test_two_robots_that_slide_to_the_same_place_keep_apart(seed: int) -> None:
    """Neither would close on a standing other; without a rule their corners would meet."""
    trace = meeting(
        group("seeing-waffle_pi", "a", (0.0, 0.296, -0.24), 0.2),
        group("seeing-waffle_pi", "b", (0.1, -0.296, 0.37), 0.2),
        seed=seed,
        duration=6.0,
    )
    assert len(trace.contact_t) == 0
    assert minimum_gap(trace) > 0.07
    assert min(driven(trace, "a"), driven(trace, "b")) > 0.3
