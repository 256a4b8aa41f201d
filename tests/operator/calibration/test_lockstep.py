"""A calibration in simulation finds what the simulated base and lidar were given."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace as replace_scan

from swarmd.core.messages import Reason, State
from swarmd.core.values import Platform, Scan, Sweep
from swarmd.operator.calibration.figures import DONE, REFUSED, Figure, names_of
from swarmd.operator.calibration.floor import needed_floor
from swarmd.operator.calibration.report import figures_of, measured_file, settings
from swarmd.robot.protection.assumption_monitor import axis_of
from swarmd.settings.settings import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import scenario_of

ROOM: dict[str, Any] = {
    "size": [2.8, 2.3],
    "boxes": [{"name": "crate", "at": [1.2, 0.9], "size": [0.3, 0.3]}],
}
# Errors of a lidar but no bias of its ranges: no scan can tell that from odometry's.
NOISE: dict[str, Any] = {"preset": "realistic", "lidar": {"bias": 0.0}}
STEP = 0.01  # s: the simulated base responds within one


def simulated(
    platform: str = "burger",
    realism: Any = "ideal",
    arena: dict[str, Any] = ROOM,
    *,
    body: dict[str, float] | None = None,
    limits: dict[str, float] | None = None,
    events: Sequence[dict[str, Any]] = (),
    floor: float | None = None,
    repeats: int = 4,
    seed: int = 3,
) -> Lockstep:
    """One robot in the middle, which calibrates itself from 0.1 s on.

    Its daemon has the platform's own file, and its base other values of `body` and `limits`.
    """
    file = load_platform(platform)
    parameters: dict[str, float] = {"repeats": repeats}
    if floor is not None:
        parameters["floor"] = floor
    begin = {"at": 0.1, "run": "calibration", "parameters": parameters}
    scenario = scenario_of(
        {
            "duration": 300.0,
            "realism": realism,
            "arena": arena,
            "groups": {"all": {"platform": platform, "robots": ["r"]}},
            "start": {"layout": "row"},
            "events": [{"at": 0.0, "join": "r"}, begin, *events],
        }
    )
    base: Platform = replace(file, body={**file.body, **(body or {})})
    base = replace(base, limits=structs.replace(base.limits, **(limits or {})))
    sim = Lockstep(replace(scenario, robots={"r": base}), seed)
    own = sim._platforms[0]
    sim._platforms[0] = replace(own, limits=file.limits)
    return sim


def calibrated(sim: Lockstep) -> dict[str, Any]:
    """The last report of the run, which has ended."""
    sim.advance(0.5)
    robot = sim.shells[0].robot  # type: ignore[union-attr]  # it has joined
    while robot.is_running and sim.world.time < 300.0:
        sim.advance(1.0)
    assert (robot.state, robot.reason) == (State.IDLE, Reason.FINISHED)
    return dict(robot.report)


def found(sim: Lockstep) -> dict[str, Figure]:
    report = calibrated(sim)
    assert report["state"] == DONE, report.get("why")
    shell = sim.shells[0]
    assert shell is not None
    decision = shell.robot.status(sim.world.time).decision
    # Nothing was limited, but by the monitor of the assumptions that this base breaks.
    assert decision.duty == 0.0 or decision.speed_share < 1.0
    return figures_of(report)


@pytest.mark.long
@pytest.mark.parametrize(
    ("platform", "linear", "angular", "delay", "latency"),
    [
        pytest.param("burger", 0.5, 2.0, 0.10, 0.5, marks=pytest.mark.evidence),
        ("burger", 1.0, 3.2, 0.20, 1.2),
        ("waffle_pi", 0.7, 1.5, 0.15, 0.5),
    ],
)
def test_brakes_and_delays_are_found_within_five_percent(
    platform: str, linear: float, angular: float, delay: float, latency: float
) -> None:
    realism = {
        "preset": "realistic",
        "actuation": {"delay": delay},
        "lidar": {"bias": 0.0, "latency": latency},
    }
    base = {"linear_acceleration": linear, "angular_acceleration": angular}
    figures = found(simulated(platform, realism, body=base))
    assert figures["braking_linear"].value == pytest.approx(linear, rel=0.05)
    assert figures["braking_angular"].value == pytest.approx(angular, rel=0.05)
    # The speed changes at the begin of a step: half of one early.
    given = delay - 0.5 * STEP
    assert figures["reaction_linear"].value == pytest.approx(given, rel=0.05)
    assert figures["reaction_angular"].value == pytest.approx(given, rel=0.05, abs=0.005)
    rate = load_platform(platform).scan.rate
    assert figures["scan_delay"].value == pytest.approx(latency / rate, rel=0.05)
    for name in ("braking_linear", "braking_angular", "scan_delay"):
        assert 0.0 < figures[name].spread < 0.2 * figures[name].value
        assert figures[name].samples >= 8


@pytest.mark.long
def test_a_sweep_that_the_platform_does_not_know_is_found_and_written(tmp_path: Path) -> None:
    """The lidar of a Burger turns clockwise once in 0.2 s, and its last ray lies at -1 degree."""
    sim = simulated(realism=NOISE)
    own = sim._platforms[0]
    scan = replace(own.scan, sweep=None, is_sweep_unknown=True)
    sim._platforms[0] = replace(own, scan=scan)
    report = calibrated(sim)
    delay = Figure.parse(report["scan_delay"])
    assert delay.value == pytest.approx(0.1, abs=0.02)
    file = tmp_path / "mine.yaml"
    file.write_text(measured_file("r", "burger", "2026-11-28", report))
    assert load_platform(str(file)).scan.sweep == Sweep(math.radians(-1.0), -1.0, 0.2)


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, pytest.param(4, marks=pytest.mark.evidence)])
def test_a_scale_that_far_walls_hardly_bind_is_stated_as_less_exact(seed: int) -> None:
    arena = {"size": [6.0, 6.0], "boxes": [{"name": "crate", "at": [1.7, 0.4], "size": [0.3, 0.3]}]}
    figures = found(simulated(realism=NOISE, arena=arena, seed=seed))  # the lidar reaches 3.5 m
    scale, share = figures["odometry_linear"], figures["speed_linear"]
    assert abs(scale.value - 1.0) < 2.0 * scale.spread
    assert abs(share.value - 1.0) < 2.0 * share.spread
    brake = figures["braking_linear"]
    assert brake.spread / brake.value > scale.spread / scale.value


def test_scales_of_speed_and_odometry_are_found_within_five_percent() -> None:
    sim = simulated(realism=NOISE, limits={"linear": 0.19, "angular": 1.6})
    measured = sim.world._odometers._measured
    measured[0, :, 0] *= 1.08  # from true to measured motion
    measured[0, :, 1] *= 0.92
    given = measured[0, 0, 0], measured[0, 1, 1]
    figures = found(sim)
    assert figures["odometry_linear"].value == pytest.approx(given[0], rel=0.02)
    assert figures["odometry_angular"].value == pytest.approx(given[1], rel=0.02)
    assert figures["speed_linear"].value == pytest.approx(0.19 / 0.22, rel=0.05)
    top = 0.95 * 0.30 / float(np.hypot(0.102, 0.089))
    assert figures["speed_angular"].value == pytest.approx(1.6 / top, rel=0.05)
    assert figures["braking_linear"].value == pytest.approx(1.0, rel=0.05)
    assert figures["braking_angular"].value == pytest.approx(3.2, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("arena", "unknown"),
    [
        pytest.param(
            {"size": [20.0, 20.0]},
            {"odometry_linear", "odometry_angular", "scan_delay"},
            marks=pytest.mark.evidence,
        ),
        ({"size": [20.0, 2.2]}, {"odometry_linear"}),
    ],
)
def test_what_the_surroundings_do_not_show_is_not_measured(
    arena: dict[str, Any], unknown: set[str]
) -> None:
    figures = found(simulated(realism=NOISE, arena=arena))
    assert {name for name in names_of(False) if not figures[name].is_measured} == unknown
    assert figures["braking_linear"].value == pytest.approx(1.0, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    ("platform", "arena", "word"),
    [
        ("burger", {"size": [4.0, 4.0], "poles": [{"at": [0.7, 0.3], "radius": 0.01}]}, "0.75"),
        ("burger", {"size": [1.6, 4.0]}, "0.8"),
        ("jackal", {"size": [4.0, 4.0]}, "4.6 x 4.6"),
        ("rosbot_xl", {"size": [8.0, 5.0]}, "5.9 x 5.9"),  # too little room at its sides
    ],
)
def test_nothing_moves_unless_the_floor_is_free(
    platform: str, arena: dict[str, Any], word: str
) -> None:
    sim = simulated(platform, arena=arena)
    start = sim.world.poses()
    report = calibrated(sim)
    assert report["state"] == REFUSED
    assert word in report["why"]
    assert np.array_equal(sim.world.poses(), start)


HALL: dict[str, Any] = {
    "size": [6.6, 6.1],
    "boxes": [{"name": "crate", "at": [3.1, 2.4], "size": [0.3, 0.3]}],
}


@pytest.mark.long
def test_weak_brakes_sideways_are_found_and_the_monitor_names_them_before() -> None:
    """On a base whose odometry measures too long a way sideways."""
    body = {"linear_acceleration": 1.0, "lateral_acceleration": 0.4}
    sim = simulated("rosbot_xl", NOISE, HALL, body=body)
    measured = sim.world._odometers._measured
    measured[0, 2, 2] = 1.08
    sim.advance(0.5)
    robot = sim.shells[0].robot  # type: ignore[union-attr]  # it has joined
    findings: tuple[str, ...] = ()
    while robot.is_running and not findings and sim.world.time < 200.0:
        sim.advance(1.0)
        findings = robot.status(sim.world.time).findings
    assert robot.is_running
    assert [axis_of(text) for text in findings] == ["lateral"]
    figures = found(sim)
    shown = figures_of(robot.status(sim.world.time).report)
    assert shown.keys() == {*names_of(True), "margin"}  # a status has room for all of them
    assert figures["odometry_lateral"].value == pytest.approx(1.08, rel=0.02)
    assert figures["odometry_linear"].value == pytest.approx(measured[0, 0, 0], rel=0.02)
    assert figures["braking_lateral"].value == pytest.approx(0.4, rel=0.05)
    assert figures["braking_lateral"].assumed == 0.8
    assert figures["braking_linear"].value == pytest.approx(1.0, rel=0.05)
    assert figures["braking_angular"].value == pytest.approx(4.0, rel=0.05)
    given = 0.03 - 0.5 * STEP
    assert figures["reaction_lateral"].value == pytest.approx(given, rel=0.05, abs=0.005)
    chosen = {one.key: one for one in settings(figures, (0.76, 3.14, 0.53))}
    braking = chosen["protection.barrier.braking_linear"]
    assert braking.is_safe
    assert float(braking.value) == pytest.approx(0.4, rel=0.05)


@pytest.mark.long
def test_drives_sideways_stay_on_the_floor() -> None:
    """And find a base that is slower sideways than its file says."""
    sim = simulated("rosbot_xl", NOISE, HALL, limits={"lateral": 0.3})
    sim.advance(0.5)
    robot = sim.shells[0].robot  # type: ignore[union-attr]  # it has joined
    far = 0.0
    while robot.is_running and sim.world.time < 200.0:
        sim.advance(0.1)
        far = max(far, abs(float(sim.world.poses()[0, 1])))
    assert robot.report["state"] == DONE, robot.report.get("why")
    assert robot.status(sim.world.time).decision.duty == 0.0
    assert 0.1 < far < 1.2 * 0.76
    figures, drove = figures_of(robot.report), str(robot.report["drove"]).split()
    assert figures["speed_lateral"].value == pytest.approx(0.3 / float(drove[2]), rel=0.05)
    assert figures["speed_linear"].value == pytest.approx(1.0, rel=0.05)
    assert figures["braking_lateral"].value == pytest.approx(1.0, rel=0.05)


@pytest.mark.long
def test_wheels_that_do_not_slide_end_the_drives() -> None:
    report = calibrated(simulated("rosbot_xl", arena=HALL, limits={"lateral": 0.0}))
    assert report["state"] == REFUSED
    assert "limits.lateral" in report["why"]


@pytest.mark.long
def test_odometry_without_the_way_sideways_ends_the_drives_before_the_robot_goes_far() -> None:
    sim = simulated("rosbot_xl", NOISE, HALL)
    sim.world._odometers._measured[0, 2, 2] = 0.0
    report = calibrated(sim)
    assert report["state"] == REFUSED
    assert "odometry shows no way sideways" in report["why"]
    assert abs(float(sim.world.poses()[0, 1])) < 0.76


@pytest.mark.long
def test_the_floor_has_room_at_the_sides_as_ahead() -> None:
    """A base turned by 90 degrees needs the same floor."""
    base = load_platform("rosbot_xl")
    outline = base.footprint * (1.5, 1.0)
    ahead = replace(base, footprint=outline, limits=structs.replace(base.limits, lateral=0.2))
    turned = np.stack((-outline[:, 1], outline[:, 0]), axis=1)
    limits = structs.replace(base.limits, linear=0.2, lateral=0.8)
    aside = replace(base, footprint=turned, limits=limits)
    slow = replace(aside, limits=structs.replace(limits, lateral=0.0))
    assert needed_floor(slow) < needed_floor(aside) == needed_floor(ahead)


def turned(scan: Scan, angle: float) -> Scan:
    """The scan of a lidar that is mounted turned by `angle` rad, against its file."""
    steps = round(angle / (2.0 * np.pi) * len(scan.ranges))
    return replace_scan(scan, ranges=np.roll(scan.ranges, -steps))


def mirrored(scan: Scan) -> Scan:
    """The scan of a lidar that is mounted upside down: its bearing 0 stays ahead."""
    return replace_scan(scan, ranges=np.roll(scan.ranges[::-1], 1))


def with_scans(sim: Lockstep, change: Callable[[Scan], Scan]) -> Lockstep:
    """The simulation with changed scans, as a robot with a wrongly mounted lidar gets them."""
    arrived = sim.world.arrived_scans
    sim.world.arrived_scans = lambda: [  # type: ignore[method-assign]
        (row, change(scan)) for row, scan in arrived()
    ]
    return sim


def with_motors(sim: Lockstep, linear: float, angular: float) -> Lockstep:
    """The simulation with motors that turn otherwise, and so do their encoders."""
    factors = np.array((linear, angular, 1.0))
    set_commands = sim.world.set_commands
    sim.world.set_commands = (  # type: ignore[method-assign]
        lambda twists: set_commands(factors * twists)
    )
    sim.world._odometers._measured[0] *= factors[:, None]
    return sim


def refusal_of(sim: Lockstep) -> str:
    report = calibrated(sim)
    assert report["state"] == REFUSED
    return str(report["why"])


@pytest.mark.long
@pytest.mark.parametrize(
    "angle", [180.0, *(pytest.param(angle, marks=pytest.mark.evidence) for angle in (90.0, -90.0))]
)
def test_a_lidar_that_is_turned_ends_the_first_drive(angle: float) -> None:
    sim = simulated(realism=NOISE)
    why = refusal_of(with_scans(sim, lambda scan: turned(scan, np.radians(angle))))
    assert "lidar is turned" in why
    (told,) = re.findall(r"turned by (-?\d+) deg", why)
    assert abs(np.remainder(float(told) - angle + 180.0, 360.0) - 180.0) < 5.0
    assert sim.world.time < 12.0


@pytest.mark.long
@pytest.mark.evidence
def test_a_mirrored_scan_gives_no_figures() -> None:
    why = refusal_of(with_scans(simulated(realism=NOISE, repeats=1), mirrored))
    assert "scan is mirrored" in why


@pytest.mark.long
def test_swapped_motors_give_no_figures() -> None:
    why = refusal_of(with_motors(simulated(realism=NOISE, repeats=1), 1.0, -1.0))
    assert "motors are swapped" in why


@pytest.mark.long
def test_motors_of_wrong_sign_end_the_first_drive() -> None:
    sim = with_motors(simulated(realism=NOISE), -1.0, -1.0)
    assert "wrong sign" in refusal_of(sim)
    assert sim.world.time < 12.0


@pytest.mark.long
@pytest.mark.evidence
def test_a_mirrored_scan_of_a_base_that_moves_sideways_ends_the_first_drive_sideways() -> None:
    why = refusal_of(with_scans(simulated("rosbot_xl", NOISE, HALL, repeats=1), mirrored))
    assert "scan is mirrored" in why


LATE = {"preset": "realistic", "lidar": {"bias": 0.0, "delay": 0.23}}


@pytest.mark.long
@pytest.mark.parametrize(
    ("platform", "floor"),
    [("jackal", 5.0), pytest.param("burger", 2.3, marks=pytest.mark.evidence)],
)
def test_scans_that_come_late_are_measured(platform: str, floor: float) -> None:
    """Also those of a Jackal, which are too late for every other pattern."""
    room = {
        "size": [floor + 1.0, floor + 0.8],
        "boxes": [{"name": "crate", "at": [0.5 * floor + 0.3, 0.4 * floor], "size": [0.3, 0.3]}],
    }
    figures = found(simulated(platform, LATE, room, floor=floor))
    given = 0.23 + load_platform(platform).scan.latency
    assert figures["scan_delay"].value == pytest.approx(given, rel=0.1)
    (latency,) = [one for one in settings(figures, (1.0, 1.0)) if one.key == "scan.latency"]
    assert latency.is_safe
    assert latency.value == pytest.approx(given, rel=0.1)
    assert figures["braking_linear"].value == pytest.approx(1.0, rel=0.05)


@pytest.mark.long
def test_late_scans_need_a_larger_floor() -> None:
    sim = simulated("jackal", LATE, {"size": [6.0, 6.0]}, floor=4.6)
    start = sim.world.poses()
    report = calibrated(sim)
    assert report["state"] == REFUSED
    assert "5 m needed" in report["why"]
    assert np.array_equal(sim.world.poses(), start)


@pytest.mark.long
def test_the_robot_stays_on_its_floor() -> None:
    sim = simulated("waffle_pi", NOISE, {"size": [2.02, 2.02]})
    far = 0.0
    sim.advance(0.5)
    robot = sim.shells[0].robot  # type: ignore[union-attr]  # it has joined
    while robot.is_running:
        sim.advance(0.1)
        far = max(far, float(np.abs(sim.world.poses()[0, :2]).max()))
    assert robot.report["state"] == DONE
    assert 0.1 < far < 1.2 * 0.26
    assert robot.status(sim.world.time).decision.duty == 0.0


@pytest.mark.long
def test_what_comes_onto_the_floor_ends_the_drives() -> None:
    arena = {"size": [4.0, 4.0], "boxes": [{"name": "b", "size": [0.2, 0.2], "mass": 9.0}]}
    placed = {"at": 15.0, "place": "b", "pose": [0.85, 0.0, 0.0]}
    sim = simulated(realism=NOISE, arena=arena, events=(placed,))
    report = calibrated(sim)
    assert report["state"] == REFUSED
    assert "not free" in report["why"]
    assert 15.0 < sim.world.time < 20.0
    assert np.hypot(*sim.world.twists()[0, :2]) < 1e-6
