"""One run in several processes: the same bits, and an end that names the process at fault."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.lockstep.processes import RunProcess, run_processes
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace

MIXED: dict[str, Any] = {
    "duration": 2.5,
    "arena": {"size": [7.0, 7.0], "boxes": [{"name": "crate", "size": [0.4, 0.4], "mass": 1.0}]},
    "groups": {
        "slow": {"count": 2, "prefix": "s", "pattern": "random_walk"},
        "voters": {"platform": "burger", "count": 5, "prefix": "v", "pattern": "voter_model"},
    },
    "start": {"layout": "random", "clearance": 0.1},
    "radio": {"loss": 0.2, "delay": 0.02, "jitter": 0.01, "line_of_sight": True,
              "range_and_bearing": True},
    "fields": [{"name": "light", "kind": "linear", "slope": 1.0}],
    "trace_rate": 50.0,
    "lidar_visibility": "real",
    "accepts_faster": ["waffle_pi"],
}  # fmt: skip
AT_ONCE = {**MIXED, "radio": {}, "accepts_unseen": ["waffle_pi"]}
BOXES = {
    **MIXED,
    "groups": {"all": {"count": 3, "prefix": "r", "pattern": "drive"}},
    "start": {"layout": "row", "spacing": 1.5},
    "platforms": {"waffle_pi": {"protection": {"mode": "off"}}},
    "arena": {
        "size": [20.0, 20.0],
        "boxes": [
            {"name": "crate", "at": [0.2, 0.0], "size": [0.1, 0.1], "mass": 0.2},
            {"name": "late", "size": [0.2, 0.2], "mass": 5.0},
        ],
    },
    "events": [
        {"at": 0.5, "place": "late", "pose": [0.0, 3.0, 0.0]},
        {"at": 2.0, "remove": "late"},
    ],
}
# Latches of robots in each process, daemons that end and return, and requests to all.
LATCHES = {
    **MIXED,
    "events": [
        {"at": 0.5, "estop": ["v-02", "s-01"]},
        {"at": 0.7, "kill": ["v-01"]},
        {"at": 0.7, "leave": ["v-02"]},
        {"at": 0.9, "remove": "v-03"},
        {"at": 1.0, "join": ["v-02", "v-01"]},
        {"at": 1.3, "estop": "all"},
        {"at": 1.6, "kill": ["s-02"]},
        {"at": 1.7, "reset": ["s-01", "v-01", "v-02", "v-04", "v-05"]},
        {"at": 1.8, "run": "random_walk", "targets": ["s-01", "v-01"]},
        {"at": 2.0, "param": {"speed": 0.05}, "targets": ["s-01"]},
        {"at": 2.1, "join": ["s-02"]},
    ],
}


# Each robot has an item ahead of it, which it carries.
_SENSORS = {"light": [{"at": [0.0, 0.04]}, {"at": [0.0, -0.04]}]}
CARRIED = {
    **AT_ONCE,
    "platforms": {
        "burger": {
            "extends": "burger", "provides": ["scan", "odometry", "gripper"], "sensors": _SENSORS,
        }
    },
    "accepts_unseen": [],
    "accepts_faster": [],
    "groups": {"all": {"platform": "burger", "count": 3, "prefix": "r", "pattern": "foraging"}},
    "start": {"layout": "list", "poses": [[0, 0, 0], [0, 1.5, 0], [0, -1.5, 0]]},
    "fields": [{"name": "light", "kind": "light"}, {"name": "ground", "kind": "floor"}],
    "items": [
        {"name": "food", "at": [[0.06, 0], [0.06, 1.5], [0.06, -1.5]], "source": [2, 0, 0.5]},
        {"name": "puck", "count": 5, "source": [-2, 0, 0.5], "mass": 0.05},
    ],
}  # fmt: skip

# Robots recognise robots of the other process, a box that they push, and a lamp that it hides.
SEEN = {
    **CARRIED,
    "platforms": {
        "burger": {
            "extends": "burger", "protection": {"mode": "off"},
            "sensors": {
                "detections": [
                    {"at": [0, 0], "bearing_deg": 0, "field_of_view_deg": 360, "range": 5}
                ]
            },
        }
    },
    "arena": {
        "size": [7.0, 7.0],
        "boxes": [{"name": "crate", "at": [0.4, 0.0], "size": [0.5, 0.5], "mass": 0.5}],
    },
    "groups": {
        "all": {"platform": "burger", "count": 3, "prefix": "r", "pattern": "cooperative_transport"}
    },
    "fields": [{"name": "light", "kind": "light", "center": [2.5, 0]}],
    "items": [],
}  # fmt: skip


def same_bits(a: Trace, b: Trace) -> None:
    for field in fields(Trace):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if field.name in ("report", "words"):
            assert one.keys() == other.keys()
            assert all(one[name].tobytes() == other[name].tobytes() for name in one)
        elif isinstance(one, np.ndarray):
            assert (one.dtype, one.shape) == (other.dtype, other.shape)
            assert one.tobytes() == other.tobytes(), field.name


@pytest.mark.integration
@pytest.mark.parametrize(
    ("data", "cores"),
    [(MIXED, 3), (AT_ONCE, 2), (BOXES, 2), (LATCHES, 3), (CARRIED, 2), (SEEN, 2)],
    ids=["mixed", "at_once", "boxes", "latches", "carried", "seen"],
)
def test_processes_give_the_bits_of_one_process(data: dict[str, Any], cores: int) -> None:
    whole = simulate_run(scenario_of(data), 4)
    assert len(whole.t) > 100
    same_bits(whole, simulate_run(scenario_of(data), 4, cores=cores))


def test_robots_carry_their_items_from_the_first_steps_on() -> None:
    trace = simulate_run(scenario_of(CARRIED), 4)
    assert (trace.readings["held"][-1] == 1.0).all()
    assert trace.box_pose is not None
    ahead = trace.box_pose[-1, 1:4, :2] - trace.pose[-1, :, :2]
    assert np.hypot(*ahead.T) == pytest.approx(0.038, abs=1e-9)


@pytest.mark.integration
def test_robots_of_both_processes_recognise_the_box_and_the_lamp() -> None:
    trace = simulate_run(scenario_of(SEEN), 4, cores=2)
    assert trace.words["state"][-1].tolist() == ["push", "around", "around"]


@pytest.mark.integration
@pytest.mark.parametrize("robot", ["r-01", "r-02"])
def test_a_pattern_fault_and_a_refusal_are_told_from_each_process(
    tmp_path: Path, robot: str
) -> None:
    (tmp_path / "raises.py").write_text(
        "from swarmd.api import MovementPattern, Params\n"
        "class Raises(MovementPattern[Params]):\n"
        "    params_type = Params\n"
        "    def drive(self, inputs):\n"
        "        raise ValueError('on purpose')\n"
    )
    data = {
        **BOXES,
        "duration": 4.0,
        "plugin_dir": str(tmp_path),
        "events": [{"at": 0.1, "run": "raises", "targets": [robot]}],
    }
    same_bits(*(simulate_run(scenario_of(data), 0, cores=cores) for cores in (1, 2)))
    refused = [*data["events"], {"at": 3.5, "run": "drive", "targets": [robot]}]
    with pytest.raises(SwarmError, match=rf"3.5 s run drive: {robot}"):
        simulate_run(scenario_of({**data, "events": refused}), 0, cores=2)


def test_robots_of_one_step_are_shared_out_evenly() -> None:
    order = np.random.default_rng(0).permutation(37)
    processes = [RunProcess(index, 3) for index in range(3)]
    for process in processes:
        process.share(order)
    assert sorted(np.concatenate([process.rows for process in processes])) == list(range(37))
    for first in range(30):  # robots in a row of `order` work in one step
        step = order[first : first + 7].tolist()
        assert {len(process.own(step)) for process in processes} <= {2, 3}


@pytest.mark.integration
def test_parts_longer_than_a_round_arrive_whole() -> None:
    def work(process: RunProcess) -> list[bool]:
        part = (process.index, bytes([process.index]) * (3_000_000 * process.index + 5))
        meanwhile: list[int] = []
        for turn in range(3):
            found = process.exchange(part, partial(meanwhile.append, turn))
        assert meanwhile == [0, 1, 2]
        found = process.collect(part)
        return [data == bytes([index]) * (3_000_000 * index + 5) for index, data in found]

    assert run_processes(work, 3) == [True] * 3


def pids_of(path: Path) -> list[int]:
    return [int(pid) for pid in path.read_text().split()]


def has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


@pytest.mark.integration
@pytest.mark.parametrize(
    ("fault", "timeout", "words"),
    [
        (lambda: os.kill(os.getpid(), signal.SIGKILL), 30.0, "process 2 of the 3.*SIGKILL"),
        (lambda: os.kill(os.getpid(), signal.SIGSTOP), 1.0, "process 2 of the 3.*1 s"),
        (lambda: os._exit(3), 30.0, "process 2 of the 3.*code 3"),
        (lambda: (_ for _ in ()).throw(ConfigError("told")), 30.0, "^told$"),
        (lambda: (_ for _ in ()).throw(OSError("else")), 30.0, "else"),
    ],
    ids=["killed", "frozen", "ended", "raised", "raised another"],
)
def test_a_process_that_fails_ends_the_run_and_is_named(
    tmp_path: Path, fault: Callable[[], object], timeout: float, words: str
) -> None:
    pids = tmp_path / "pids"

    def work(process: RunProcess) -> None:
        if process.index:
            with pids.open("a") as file:
                file.write(f"{os.getpid()} ")
        for turn in range(1000):
            process.exchange(turn)
            if turn == 100 and process.index == 1:
                fault()

    begin = time.monotonic()
    with pytest.raises(Exception, match=words):
        run_processes(work, 3, timeout)
    assert time.monotonic() - begin < 20.0
    assert len(pids_of(pids)) == 2
    assert all(has_ended(pid) for pid in pids_of(pids))


@pytest.mark.integration
@pytest.mark.parametrize("fault", [None, "killed"])
def test_a_pattern_may_ignore_the_end_of_children(fault: str | None) -> None:
    def work(process: RunProcess) -> list[int]:
        if process.index == 0:
            signal.signal(signal.SIGCHLD, signal.SIG_IGN)
        process.exchange(None)
        if process.index and fault:
            os.kill(os.getpid(), signal.SIGKILL)
        return process.exchange(process.index)

    before = signal.getsignal(signal.SIGCHLD)
    try:
        if fault:
            with pytest.raises(SwarmError, match=r"process 2 of the 2 of this run ended$"):
                run_processes(work, 2)
        else:
            assert run_processes(work, 2) == [0, 1]
    finally:
        signal.signal(signal.SIGCHLD, before)


@pytest.mark.integration
def test_an_error_of_the_first_process_leaves_none_behind(tmp_path: Path) -> None:
    pids = tmp_path / "pids"

    def work(process: RunProcess) -> None:
        if process.index:
            pids.write_text(str(os.getpid()))
        process.exchange(None)
        if process.index == 0:
            raise SwarmError("first")
        process.exchange(None)

    with pytest.raises(SwarmError, match="first"):
        run_processes(work, 2)
    assert all(has_ended(pid) for pid in pids_of(pids))
