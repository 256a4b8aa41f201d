"""Lockstep has the rates, delays and limits of live daemons."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from swarmd.core.clock import TICK
from swarmd.core.values import Array
from swarmd.sim.live.realtime import COMMAND_TIMEOUT
from swarmd.sim.lockstep.lockstep import BASE_TIMEOUT, Lockstep, simulate_run
from swarmd.sim.metrics.contacts import contact_list
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

PROBE = """
from swarmd.api import Outputs, Params, Pattern, Twist

class Probe(Pattern[Params]):
    params_type = Params
    needs = frozenset({"scan"})
    channels = {"word": list}
    rate = 50.0

    def __init__(self, params, context):
        self.steps, self.oldest, self.delay, self.heard, self.long = 0, 0.0, -1.0, -1.0, 0.0
        self.word, self.robot = [0.0, 1.0], context.robot

    def step(self, inputs):
        self.steps += 1
        scan, odometry = inputs.scan, inputs.odometry
        for message in inputs.messages:
            if len(message.value) > 2:
                self.long += 1.0
            else:
                said, self.heard = message.value
                self.delay = inputs.now - message.age - said
        said = {}
        if self.steps == 100:
            said = {"word": [0.0] * 200}
        elif self.steps % 25 == 0:
            self.word[:] = [inputs.now, 1.0]
            said = {"word": self.word}
        elif self.steps % 25 == 1:
            self.word[1] = 2.0  # what was said is said
        near = inputs.neighbors
        return Outputs(
            twist=Twist(0.1),
            messages=said,
            report={
                "steps": self.steps,
                "scan_stamp": -1.0 if scan is None else scan.stamp,
                "scan_age": -1.0 if not inputs.is_new_scan else inputs.now - scan.stamp,
                "odometry_stamp": -1.0 if odometry is None else odometry.stamp,
                "neighbors": len(near),
                "distance": (near[0].distance or -1.0) if near else -1.0,
                "delay": self.delay,
                "heard": self.heard,
                "long": self.long,
            },
        )
"""


@pytest.fixture(scope="module")
def plugins(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("plugins")
    (folder / "probe.py").write_text(PROBE)
    return str(folder)


def scenario(plugins: str, pattern: str | None = "probe", **changes: Any) -> Scenario:
    data: dict[str, Any] = {
        "duration": 4.0,
        "trace_rate": 100.0,
        "realism": "realistic",
        "arena": {"size": [40.0, 40.0]},
        "groups": {"all": {"count": 3, "prefix": "r", "pattern": pattern}},
        "start": {"layout": "row", "spacing": 5.0},
        "plugin_dir": plugins,
    }
    return scenario_of({**data, **changes})


def told(trace: Trace, name: str, row: int = 0) -> Array:
    """(k,) what a robot reported, while it did."""
    values: Array = trace.report[name][:, row]
    return values[~np.isnan(values)]


def at(trace: Trace, time: float) -> int:
    return int(np.searchsorted(trace.t, time - 1e-9))


@pytest.fixture(scope="module")
def heard(plugins: str) -> Trace:
    """Robots in a row, each within the radio range of the next."""
    radio = {"neighborhood": "range", "range": 6.0, "range_and_bearing": True, "delay": 0.25}
    return simulate_run(scenario(plugins, radio=radio), 0)


def test_scans_arrive_at_the_sensors_rate_with_their_latency(heard: Trace) -> None:
    stamps = np.unique(told(heard, "scan_stamp"))
    assert np.diff(stamps[stamps >= 0.0]) == pytest.approx(0.2)
    ages = told(heard, "scan_age")
    assert ages[ages >= 0.0] == pytest.approx(0.2)  # of the first ray, which the stamp tells


def test_odometry_beats_alarms_and_places_of_neighbors_come_at_their_rates(heard: Trace) -> None:
    assert len(np.unique(told(heard, "odometry_stamp"))) == pytest.approx(4.0 / TICK, abs=2)
    # A pattern that is faster than the beats is stepped by alarms between them.
    assert told(heard, "steps")[-1] == pytest.approx(4.0 * 50.0, rel=0.05)
    # One place with noise for each time that it was told, and one from its start.
    assert len(np.unique(told(heard, "distance"))) == pytest.approx(10 * 4.0 + 1, abs=1)


def test_messages_arrive_unchanged_after_the_delay_unless_too_large(heard: Trace) -> None:
    assert told(heard, "delay")[-1] == pytest.approx(0.25, abs=0.011)
    assert told(heard, "heard")[-1] == 1.0
    assert told(heard, "long")[-1] == 0.0


def test_a_slow_pattern_has_but_its_beats(plugins: str) -> None:
    lab = Lockstep(scenario(plugins, pattern="drive"), 0)
    lab.advance(2.0)
    shell = lab.shells[0]
    assert shell is not None
    decisions = shell.robot.status(lab.world.time).decision.decisions
    assert 2.0 / TICK - 2 <= decisions <= 2 * 2.0 / TICK


def test_a_joining_robot_has_neighbors_at_once_and_a_latch_outlives_its_daemon(
    plugins: str,
) -> None:
    """r-01 leaves and comes back; r-03 alone is stopped, and then its daemon is another one."""
    events: list[dict[str, Any]] = [
        {"at": 0.5, "estop": ["r-03"]},
        {"at": 1.0, "kill": ["r-01"]},
        {"at": 2.0, "join": ["r-01"]},
        {"at": 2.0, "run": "probe", "targets": ["r-01"]},
        {"at": 2.7, "kill": ["r-03"]},
        {"at": 3.0, "join": ["r-03"]},
    ]
    trace = simulate_run(scenario(plugins, duration=3.2, events=events), 0)
    near = trace.report["neighbors"]
    assert near[at(trace, 0.9), 1] == 2.0
    assert near[at(trace, 1.6), 1] == 1.0
    began = near[at(trace, 2.01) :, 0]
    assert began[~np.isnan(began)][0] == 2.0
    assert near[at(trace, 2.6), 1] == 2.0
    assert trace.state is not None
    assert list(trace.state[-1]) == ["running", "running", "estopped"]


def test_an_event_happens_in_its_step_and_the_base_of_a_killed_daemon_obeys_the_next_one(
    plugins: str,
) -> None:
    events: list[dict[str, Any]] = [
        {"at": 1.23, "stop": ["r-02", "r-03"]},
        {"at": 2.0, "kill": ["r-01"]},
        {"at": 2.2, "join": ["r-01"]},
        {"at": 2.2, "run": "drive", "targets": ["r-01"]},
    ]
    trace = simulate_run(scenario(plugins, pattern="drive", duration=3.0, events=events), 0)
    assert trace.state is not None
    assert set(trace.state[at(trace, 1.22)]) == {"running"}
    assert list(trace.state[at(trace, 1.23)]) == ["running", "stopped", "stopped"]
    assert (trace.safe[at(trace, 1.22), :, 0] > 0.0).all()
    assert (trace.safe[at(trace, 1.23), 1:] == 0.0).all()
    moving = trace.safe[:, 0, 0] > 0.0
    back = at(trace, 2.2) + int(np.argmax(moving[at(trace, 2.25) :])) + 6
    assert trace.t[back] < 2.0 + BASE_TIMEOUT
    assert moving[back:].all()


def test_a_robot_that_joins_an_estopped_swarm_is_latched_before_any_run(plugins: str) -> None:
    """A daemon asks its peers for their latches before it takes a `run`."""
    events: list[dict[str, Any]] = [
        {"at": 0.1, "kill": ["r-01"]},
        {"at": 0.5, "estop": "all"},
        {"at": 0.6, "join": ["r-01"]},
    ]
    trace = simulate_run(scenario(plugins, duration=1.0, events=events), 0)
    assert trace.state is not None
    assert trace.present is not None
    is_there = trace.present[:, 0] & (trace.t > 0.3)
    assert set(trace.state[is_there, 0]) == {"estopped"}


def test_a_returning_latch_holds_robots_that_did_not_reset_it(plugins: str) -> None:
    """r-03 was killed while the swarm was stopped, and missed the reset; r-04 is new."""
    events: list[dict[str, Any]] = [
        {"at": 0.5, "estop": "all"},
        {"at": 1.0, "kill": ["r-03"]},
        {"at": 1.5, "reset": "all"},
        {"at": 2.0, "join": ["r-04"]},
        {"at": 2.0, "run": "probe"},
        {"at": 2.5, "join": ["r-03"]},
    ]
    group = {"count": 4, "prefix": "r"}
    trace = simulate_run(scenario(plugins, groups={"all": group}, events=events), 0)
    assert trace.state is not None
    assert list(trace.state[at(trace, 2.4)]) == ["running", "running", "", "running"]
    assert list(trace.state[-1]) == ["running", "running", "estopped", "estopped"]


def test_scans_judged_while_running_are_counted_and_active_ones_apart(
    plugins: str,
) -> None:
    """It drives at a wall from 1 s on, and is held back near it."""
    trace = simulate_run(
        scenario(
            plugins,
            pattern="drive",
            duration=6.0,
            arena={"size": [2.4, 8.0]},
            groups={"all": {"count": 1, "prefix": "r"}},
            start={"layout": "list", "poses": [[-0.2, 0.0, 0.0]]},
            events=[{"at": 1.0, "run": "drive"}],
        ),
        0,
    )
    assert trace.decided is not None
    assert trace.evaded is not None
    assert trace.active is not None
    assert trace.decided[: at(trace, 1.0)].sum() == 0
    assert trace.decided.sum() == pytest.approx(5.0 * 5.0, abs=1)
    began = int(np.argmax(trace.active[:, 0]))
    assert began > 0
    assert trace.evaded[: began - 1].sum() == 0
    assert trace.evaded.sum() >= 1
    assert (trace.evaded <= trace.decided).all()
    assert trace.evaded[began:].sum() == pytest.approx(5.0 * trace.active[:, 0].sum() / 100, abs=3)


def test_a_collision_is_recorded_with_its_time_and_speeds(plugins: str) -> None:
    """r-01 drives at 0.15 m/s into r-02, which stands; nothing keeps it from that."""
    trace = simulate_run(
        scenario(
            plugins,
            pattern=None,
            realism="ideal",
            duration=6.0,
            platforms={"ram": {"extends": "waffle_pi", "protection": {"mode": "off"}}},
            groups={"all": {"platform": "ram", "count": 2, "prefix": "r"}},
            start={"layout": "list", "poses": [[0.0, 0.0, 0.0], [0.7, 0.0, 0.0]]},
            events=[{"at": 0, "run": "drive", "targets": ["r-01"], "parameters": {"speed": 0.15}}],
        ),
        0,
    )
    (touch,) = contact_list(trace)
    assert (touch.a, touch.b, touch.is_a_moving, touch.is_b_moving) == ("r-01", "r-02", True, False)
    assert touch.closing_speed == pytest.approx(0.15, abs=1e-3)
    low, high = trace.footprint(0)[:, 0].min(), trace.footprint(0)[:, 0].max()
    met = trace.t[np.argmax(trace.pose[:, 0, 0] + high >= trace.pose[:, 1, 0] + low)]
    assert touch.start == pytest.approx(met, abs=0.021)


def test_a_base_gives_up_after_the_same_time_as_in_a_live_world() -> None:
    assert BASE_TIMEOUT == COMMAND_TIMEOUT
