"""Faults on purpose: what each kind does where data pass, by hand, and in runs of lockstep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan, Twist
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.active_faults import ActiveFaults
from swarmd.sim.world.bodies import value
from swarmd.sim.world.faults import KINDS, PLACES, fault_of

STEP = 0.01
WANTED = {
    "scan": ("frozen", "blind_sector", "noise", "offset", "mirrored", "late", "lost", "mast"),
    "odometry": ("frozen", "drift", "slip", "scale", "wrong_sign"),
    "base": ("weak_brakes", "dead_wheel", "late", "coasts", "ignores_zero", "dead_zone"),
    "radio": ("mute", "deaf", "loss", "delay"),
    "process": ("killed", "frozen"),
    "battery": ("low",),
    "pose": ("frozen", "drift", "turned"),
}
"""The list of the issue."""


def burger() -> Platform:
    return load_platform("burger")


def faults(*given: dict[str, Any], rows: Sequence[int] = (0,), begin: float = 0.0) -> ActiveFaults:
    """The faults of robots a and b; each is on for `rows`."""
    made = ActiveFaults(("a", "b"), 3, (burger(), burger()), STEP, value)
    for one in given:
        made.begin(fault_of(one, "here"), rows, begin)
    return made


def scan_of(ranges: Sequence[float], seq: int = 0) -> Scan:
    """Rays ahead, left, behind and right."""
    bearings = np.radians((0.0, 90.0, 180.0, 270.0))
    return Scan(seq, 0.1 * seq, np.array(ranges), bearings, 0.12, 3.5)


def seen(fault: dict[str, Any], *scans: Sequence[float]) -> list[list[float] | None]:
    """The ranges that arrive of scans, one after the other; None: lost."""
    made = faults(fault)
    arrived = [made.scan(0, scan_of(ranges, seq))[0] for seq, ranges in enumerate(scans)]
    return [None if one is None else one.ranges.tolist() for one in arrived]


def followed(fault: dict[str, Any], *commands: tuple[float, float]) -> Array:
    """The commands (k, 2) linear, angular that the base follows at k steps."""
    made = faults(fault)
    out = [made.command(0, np.array((*one, 0.0))) for one in commands]
    return np.array(out)[:, :2]


def test_the_table_has_the_kinds_that_were_asked_for() -> None:
    given = {
        place: {str(k.__struct_config__.tag) for k in KINDS if k.place == place} for place in PLACES
    }
    assert tuple(given) == tuple(WANTED)
    assert all(set(words) <= given[place] for place, words in WANTED.items())


@pytest.mark.parametrize(
    ("fault", "ranges", "arrived"),
    [
        ({"scan": "mirrored"}, [1, 2, 3, 0.5], [1, 0.5, 3, 2]),
        ({"scan": "turned", "angle_deg": 90}, [1, 2, 3, 0.5], [0.5, 1, 2, 3]),
        ({"scan": "offset", "offset": 0.25}, [1, 0, math.inf, 0.5], [1.25, 0, math.inf, 0.75]),
        ({"scan": "blind_sector", "bearing_deg": 90, "width_deg": 10}, [1, 2, 3, 1], [1, 0, 3, 1]),
        ({"scan": "mast", "bearing_deg": -90}, [1, 2, 3, 1], [1, 2, 3, 0.05]),
        ({"scan": "lost", "share": 1}, [1, 2, 3, 1], None),
    ],
)  # fmt: skip
def test_a_lidar_with_a_fault_sends_other_ranges(
    fault: dict[str, Any], ranges: list[float], arrived: list[float] | None
) -> None:
    assert seen(fault, ranges) == [arrived]


def test_a_frozen_lidar_repeats_ranges_with_new_numbers() -> None:
    made = faults({"scan": "frozen"})
    (first, _), (second, _) = (made.scan(0, scan_of([i, 1, 1, 1], i)) for i in (1, 2))
    assert first is not None
    assert second is not None
    assert second.ranges.tolist() == first.ranges.tolist() == [1, 1, 1, 1]
    assert (second.seq, second.stamp) == (2, 0.2)


def test_noise_has_the_wanted_deviation_and_a_late_scan_keeps_its_stamp() -> None:
    made = faults({"scan": "noise", "sd": 0.2}, {"scan": "late", "delay": 0.7})
    errors = []
    for seq in range(500):
        one, delay = made.scan(0, scan_of([2.0] * 4, seq))
        assert one is not None
        assert (delay, one.stamp) == (0.7, 0.1 * seq)
        errors += (one.ranges - 2.0).tolist()
    assert np.std(errors) == pytest.approx(0.2, rel=0.1)  # 2,000 draws: 1.6 % a standard error


def test_only_the_robot_with_the_fault_has_it_and_only_until_its_end() -> None:
    made = faults({"scan": "mirrored"}, rows=(1,))
    for row, wanted in ((0, [1, 2, 3, 4]), (1, [1, 4, 3, 2])):
        arrived, _ = made.scan(row, scan_of([1, 2, 3, 4]))
        assert arrived is not None
        assert arrived.ranges.tolist() == wanted
    assert made.texts() == {"b": "scan mirrored"}
    made.end(fault_of({"scan": "mirrored"}, "here"), (1,))
    after, _ = made.scan(1, scan_of([1, 2, 3, 4]))
    assert after is not None
    assert after.ranges.tolist() == [1, 2, 3, 4]
    assert made.texts() == {}


@pytest.mark.parametrize(
    ("fault", "commands", "wanted"),
    [
        # 0.5 m/s2: 0.005 m/s a step of 10 ms; it speeds up as commanded.
        ({"base": "weak_brakes", "linear": 0.5}, [(0, 0), (0.2, 0), (0, 0)], [0, 0.2, 0.195]),
        ({"base": "weak_brakes", "linear": 1}, [(0.2, 0), (-0.2, 0), (0.1, 0)], [0.2, 0.19, 0.18]),
        ({"base": "coasts", "deceleration": 1}, [(0.2, 1), (0, 0), (0.1, 0)], [0.2, 0.19, 0.1]),
        ({"base": "ignores_zero"}, [(0.1, 0), (0, 0), (0.2, 0)], [0.1, 0.1, 0.2]),
        ({"base": "dead_zone", "speed": 0.05}, [(0.04, 0), (-0.04, 0), (0.06, 0)], [0, 0, 0.06]),
        ({"base": "late", "seconds": 0.02}, [(0.1, 0), (0.2, 0), (0.3, 0)], [0.1, 0.1, 0.1]),
        ({"base": "late", "seconds": 0.01}, [(0.1, 0), (0.2, 0), (0.3, 0)], [0.1, 0.1, 0.2]),
    ],
)  # fmt: skip
def test_a_base_with_a_fault_follows_other_commands(
    fault: dict[str, Any], commands: list[tuple[float, float]], wanted: list[float]
) -> None:
    assert followed(fault, *commands)[:, 0].tolist() == pytest.approx(wanted)


@pytest.mark.parametrize(("side", "sign"), [("left", 1.0), ("right", -1.0)])
def test_a_dead_wheel_makes_the_base_turn_about_it(side: str, sign: float) -> None:
    # The other wheel drives 0.2 m/s, and the dead one stands: half the speed, and 0.2 / 0.16 rad/s.
    ((linear, angular),) = followed({"base": "dead_wheel", "side": side}, (0.2, 0.0))
    assert (linear, angular) == pytest.approx((0.1, sign * 0.2 / 0.16))


def driven(fault: dict[str, Any]) -> tuple[list[Odometry], ActiveFaults]:
    """The readings of a robot that drives 0.1 m ahead, ten times, in 1 s."""
    made = faults(fault)
    readings = [
        made.odometry(0, Odometry(0.1 * i, Pose(0.1 * i, 0.0, 0.0), Twist(1.0, 0.0)))
        for i in range(11)
    ]
    return readings, made


@pytest.mark.parametrize(
    ("fault", "x", "linear"),
    [
        ({"odometry": "frozen"}, 0.0, 1.0),
        ({"odometry": "scale", "factor": 1.2}, 1.2, 1.2),
        ({"odometry": "wrong_sign"}, -1.0, -1.0),
        ({"odometry": "drift", "linear": -0.3, "angular": 0.0}, 0.7, 0.7),
        ({"odometry": "slip", "sd": 0.0}, 1.0, 1.0),
    ],
)
def test_odometry_with_a_fault_reports_another_motion(
    fault: dict[str, Any], x: float, linear: float
) -> None:
    readings, _ = driven(fault)
    assert readings[-1].pose.x == pytest.approx(x)
    assert readings[-1].twist.linear == pytest.approx(linear)


def test_the_error_of_odometry_stays_after_the_fault() -> None:
    _, made = driven({"odometry": "scale", "factor": 2.0})
    made.end(fault_of({"odometry": "scale"}, "here"), (0,))
    after = made.odometry(0, Odometry(1.1, Pose(1.5, 0.0, 0.0), Twist(1.0, 0.0)))
    assert after.pose.x == pytest.approx(2.0 + 0.5)


def test_a_turn_about_the_origin_and_a_drift_move_a_tracked_pose() -> None:
    turned = faults({"pose": "turned", "angle_deg": 90}).pose(0, np.array((1.0, 0.0, 0.0)), 5.0)
    assert turned.tolist() == pytest.approx([0.0, 1.0, math.pi / 2.0])
    drift = {"pose": "drift", "speed": 0.1, "direction_deg": 90}
    drifted = faults(drift, begin=3.0).pose(0, np.array((1.0, 0.0, 0.0)), 5.0)
    assert drifted.tolist() == pytest.approx([1.0, 0.2, 0.0])


@pytest.mark.parametrize(
    ("fault", "from_faulty", "to_faulty"),
    [
        ({"radio": "mute"}, [], [1.0]),
        ({"radio": "deaf"}, [1.0], []),
        ({"radio": "delay", "seconds": 2}, [3.0], [3.0]),
        ({"radio": "loss", "share": 1}, [], []),
    ],
)
def test_messages_of_a_robot_with_a_fault_of_its_radio(
    fault: dict[str, Any], from_faulty: list[float], to_faulty: list[float]
) -> None:
    made = faults(fault)
    for sender, receiver, wanted in ((0, 1, from_faulty), (1, 0, to_faulty)):
        found = made.flights([(1.0, 0.0, [receiver], sender, "x", 5)])
        assert [one[0] for one in found] == wanted


@pytest.mark.parametrize(
    ("fault", "subject"),
    [
        ({"scam": "frozen"}, "scan"),
        ({"scan": "frozen", "radio": "mute"}, "scan and radio"),
        ({"scan": "frosen"}, "'frozen'"),
        ({"scan": "noise", "sd": 11}, "10"),
        ({"scan": "noise", "ds": 1}, "'ds'"),
        ({"scan": "frozen", "sd": 1}, "sd"),
        ({"base": "dead_wheel", "side": "front"}, "left"),
    ],
)
def test_an_unknown_kind_parameter_or_value_is_refused_in_one_line(
    fault: dict[str, Any], subject: str
) -> None:
    with pytest.raises(ConfigError) as raised:
        fault_of(fault, "file: events[0].fault")
    text = str(raised.value)
    assert text.startswith("file: events[0].fault: ")
    assert subject in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("platform", "has_wheels"), [("burger", True), ("rosbot_xl", False), ("crazyflie", False)]
)
def test_only_a_differential_drive_has_a_wheel_that_dies(platform: str, has_wheels: bool) -> None:
    groups = {"tb3": {"platform": platform, "count": 2}}
    event = {"at": 1.0, "fault": {"base": "dead_wheel"}, "robots": "all"}
    with nullcontext() if has_wheels else pytest.raises(ConfigError, match=r"events\[0\]\.fault"):
        scenario_of({**BASE, "groups": groups, "events": [event]})


# Runs

BASE: dict[str, Any] = {
    "duration": 8.0,
    "arena": {"size": [4, 4]},
    "groups": {"tb3": {"platform": "burger", "count": 3, "pattern": "random_walk"}},
    "start": {"layout": "random", "clearance": 0.3},
}
FAULTY = "tb3-02"


def scenario(*given: dict[str, Any], at: float = 2.0, **changes: Any) -> Scenario:
    events = [{"at": at, "fault": one, "robots": FAULTY} for one in given]
    return scenario_of({**BASE, "events": events, **changes})


def said(trace: Trace, robot: str = FAULTY) -> str:
    return "\n".join(text for _, name, text in trace.meta["said"] if name == robot)


def test_a_frozen_lidar_stops_the_robot_which_says_so_and_no_other() -> None:
    trace = simulate_run(scenario({"scan": "frozen"}), 1)
    assert trace.reason is not None
    row = trace.ids.index(FAULTY)
    assert trace.reason[-1].tolist() == ["frozen_scan" if i == row else "" for i in range(3)]
    assert "frozen_scan" in said(trace)
    assert "frozen_scan" not in said(trace, "tb3-01")
    (event,) = [one for one in trace.meta["events"] if one["action"] != "run"]
    assert (event["at"], event["action"], event["robots"]) == (2.0, "fault scan frozen", [FAULTY])


def test_a_fault_with_a_duration_ends() -> None:
    events = [{"at": 2.0, "fault": {"scan": "frozen"}, "robots": FAULTY, "for": 1.5}]
    trace = simulate_run(scenario_of({**BASE, "events": events}), 1)
    assert trace.reason is not None
    reasons = trace.reason[:, trace.ids.index(FAULTY)]
    assert "frozen_scan" in reasons[trace.t < 3.6]
    assert set(reasons[trace.t > 5.0]) == {""}
    assert [one["action"] for one in trace.meta["events"]][1:] == [
        "fault scan frozen",
        "mend scan frozen",
    ]


def test_a_base_that_ignores_zero_drives_on_behind_a_stop() -> None:
    made = scenario({"base": "ignores_zero"}, at=1.0)
    stop = replace(made.events[-1], at=3.0, action="stop", fault=None)
    lab = Lockstep(replace(made, events=(*made.events, stop)), 1)
    lab.advance(3.5)
    before = lab.world.poses()
    lab.advance(1.0)
    row = lab.world.ids.index(FAULTY)
    assert not lab.commands[row].any()
    assert np.abs(lab.world.poses() - before)[row].max() > 0.05


def test_a_halted_daemon_is_absent_and_continues() -> None:
    events = [{"at": 2.0, "fault": {"process": "frozen"}, "robots": FAULTY, "for": 3.0}]
    trace = simulate_run(scenario_of({**BASE, "events": events}), 1)
    assert trace.present is not None
    assert trace.state is not None
    row = trace.ids.index(FAULTY)
    assert trace.present[(trace.t > 0) & (trace.t < 2.0), row].all()
    assert not trace.present[(trace.t > 2.0) & (trace.t < 4.9), row].any()
    assert not trace.safe[(trace.t > 2.6) & (trace.t < 4.9), row].any()  # the base's own 0.5 s
    assert trace.present[-1, row]
    assert "loop_stalled" in said(trace)


@pytest.mark.parametrize("action", ["kill", "remove"])
def test_a_halted_daemon_that_is_ended_does_not_continue(action: str) -> None:
    halt = {"at": 1.0, "fault": {"process": "frozen"}, "robots": FAULTY, "for": 2.0}
    events = [halt, {"at": 2.0, action: FAULTY}]
    trace = simulate_run(scenario_of({**BASE, "events": events, "duration": 4.0}), 1)
    assert trace.present is not None
    assert not trace.present[-1, trace.ids.index(FAULTY)]


def test_a_killed_daemon_starts_again_without_a_run() -> None:
    events = [{"at": 2.0, "fault": {"process": "killed"}, "robots": FAULTY, "for": 3.0}]
    trace = simulate_run(scenario_of({**BASE, "events": events}), 1)
    assert trace.present is not None
    assert trace.state is not None
    row = trace.ids.index(FAULTY)
    assert not trace.present[(trace.t > 2.0) & (trace.t < 4.9), row].any()
    assert str(trace.state[-1, row]) == "idle"


@pytest.mark.parametrize(
    ("fault", "is_deaf", "is_mute"),
    [({"radio": "deaf"}, True, False), ({"radio": "mute"}, False, True)],
)
def test_a_deaf_robot_has_no_neighbors_and_a_mute_one_is_none(
    fault: dict[str, Any], is_deaf: bool, is_mute: bool
) -> None:
    lab = Lockstep(scenario(fault, at=1.0), 1)
    lab.advance(3.0)
    heard = {
        robot: {one.id for one in lab._radio.neighbors(row, lab.world.poses())}
        for row, robot in enumerate(lab.world.ids)
    }
    assert (not heard[FAULTY]) == is_deaf
    assert (FAULTY not in heard["tb3-01"]) == is_mute


@pytest.mark.parametrize(
    ("fault", "at", "told"),
    [
        ({"radio": "mute"}, 1.0, {(FAULTY, "mute")}),
        ({"radio": "deaf"}, 1.0, {(FAULTY, "deaf")}),
        ({"radio": "mute"}, 9.5, set()),  # the control: the fault is to come
    ],
)
def test_peers_name_a_mute_and_a_deaf_robot(
    fault: dict[str, Any], at: float, told: set[tuple[str, str]]
) -> None:
    group = {"platform": "burger", "count": 3, "pattern": "trimmed_consensus"}
    lab = Lockstep(scenario(fault, at=at, groups={"tb3": group}, duration=10.0), 1)
    lab.advance(9.0)
    for shell in lab.shells:
        assert shell is not None
        found = shell.robot.status(lab.world.time).peer_faults
        assert {(one.robot, one.kind) for one in found} == told
        lines = [event.text for event in shell.robot.status(lab.world.time).events]
        assert any(FAULTY in line for line in lines) == bool(told)


KIN = {
    "asks": {
        "platform": "waffle_pi",
        "count": 1,
        "pattern": "attraction",
        "parameters": {"kin": True},
    },
    "walks": {"platform": "waffle_pi", "prefix": "tb3", "count": 4, "pattern": "random_walk"},
}
POLES = [{"at": [1.0, 1.0], "radius": 0.12}, {"at": [-1.2, 0.5], "radius": 0.12}]


@pytest.mark.parametrize(
    ("fault", "begins", "told"),
    [
        ({"base": "ignores_zero"}, 1.0, {(FAULTY, "strays")}),
        ({"base": "ignores_zero"}, 13.9, set()),  # the control: the fault is to come
    ],
)
def test_peers_name_a_robot_that_drives_on_behind_a_stop(
    fault: dict[str, Any], begins: float, told: set[tuple[str, str]]
) -> None:
    made = scenario(fault, at=begins, groups=KIN, duration=14.0, realism="realistic")
    stop = replace(made.events[-1], at=8.0, action="stop", fault=None)
    lab = Lockstep(replace(made, events=tuple(sorted((*made.events, stop), key=lambda e: e.at))), 3)
    lab.advance(13.0)
    for shell in lab.shells:
        assert shell is not None
        found = shell.robot.status(lab.world.time).peer_faults
        assert {(one.robot, one.kind) for one in found} == told


def test_the_charge_of_a_battery_with_a_fault_is_read() -> None:
    platforms = {"burger": {"extends": "burger", "body": {"battery_time": 1000.0}}}
    made = scenario({"battery": "low", "charge": 0.07}, platforms=platforms)
    trace = simulate_run(made, 1)
    assert trace.readings["battery"][-1].tolist() == pytest.approx([1.0, 0.07, 1.0], abs=0.01)


@pytest.mark.integration
def test_the_result_does_not_depend_on_the_number_of_processes() -> None:
    kinds = ({"scan": "noise"}, {"odometry": "slip"}, {"base": "late"}, {"radio": "loss"})
    radio = {"places": "shared"}
    made = scenario(*kinds, radio=radio, duration=4.0)
    one, two = (simulate_run(made, 1, cores=cores) for cores in (1, 2))
    assert one.pose.tobytes() == two.pose.tobytes()
    assert one.meta["said"] == two.meta["said"]
