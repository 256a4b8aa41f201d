"""The steps of an acceptance test: a row each, in the order in which they are asked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from swarmd.core.values import Platform
from swarmd.operator.acceptance import approaches, at_rest, calibrated, drone_steps, stops
from swarmd.operator.acceptance.step import SLACK_TIME, End, Judge, Motion, Step, Work, reach_of
from swarmd.operator.calibration.figures import PATTERN
from swarmd.operator.calibration.floor import needed_floor, top_speeds
from swarmd.robot.protection.modes import make_mode, narrowest_passage

REST_TIME = 60.0
"""Seconds for which topics are recorded at rest."""
LISTEN_TIME = 2.0
"""Seconds for which beacons are heard before the doctor's questions; a robot sends one a second."""
PARTS = {
    "A": "nothing moves",
    "B": "it stops",
    "C": "it measures itself",
    "D": "it does not touch",
}

NOT_SHOWN_YET: Mapping[str, tuple[str, ...]] = {
    "A1": ("the archive on an arm64 computer, with a daemon",),
    "A4": ("a WiFi with more than a few robots; a mesh of layer 2",),
    "A5": (
        "nodes with `rmw_fastrtps_cpp` behind the bridge; the tests have Fast DDS without ROS",
        "a TurtleBot 4 with a discovery server",
        "a Create 3 of another ROS distribution than the Raspberry Pi",
        "`rmw_zenoh` on a TurtleBot 4, with a republisher for the Create 3",
    ),
    "A6": ("goals of actions behind the bridge",),
    "A9": ("the camera and posts of a TurtleBot 4, and how its lidar is turned",),
    "B8": ("the unit of the bridge on a TurtleBot 4",),
    "C2": (
        "the values of every platform file: they follow vendors' files and documents",
        "a base that moves sideways",
    ),
}
"""What no robot has shown yet, by the step that would show it: docs/robots/new_robot.md."""

_TEST_SPEED = 0.1  # m/s of the drives of part B
_LOAD_TIME = 20.0  # s between two readings of the load
_PERSON_TIME = 30.0  # s of a run that a person ends
# m/s, s; near obstacles robots creep at 0.015 m/s
_LOW_SPEED = 0.02
_LOW_TIME = 5.0
# rad/s, and turns that are commanded for a whole one
_TURN = 0.5
_TURNS = 2.0
_DOOR_SLACK = 0.2  # m beyond the narrowest door
_HAND_TIME = 10.0  # s
_LONGEST_CALIBRATION = 600.0  # s
_OTHERS_SPEED = 0.3  # m/s of a box that is pushed, for a robot without a barrier
_BOX_WAY = 1.2  # m to the box
_SHARES = {"slowly": 0.3, "at half speed": 0.6, "at full speed": 1.0}
_BEARINGS = {
    "ahead": "ahead",
    "at its left": "30 degrees to its left",
    "at its right": "30 degrees to its right",
}


def steps_of(platform: Platform) -> tuple[Step, ...]:
    """All steps for robots of a platform; a drone has rows of its own (drone_steps.py)."""
    if platform.is_drone:
        return (*_part_a(drone_steps.CHECK, "range sensors"), *drone_steps.flying_steps(platform))
    part_d = (_as_it_evades(step, platform) for step in _part_d(platform))
    return (*_part_a(_CHECK, "lidar"), *_part_b(), *_part_c(platform), *part_d)


_CHECK = Step(
    "A5",
    "check",
    "swarmd --check compares the robot's nodes and topics with its configuration.",
    at_rest.findings_on(),
    work=Work.CHECK,
)


def _part_a(check: Step, lidar: str) -> tuple[Step, ...]:
    """The steps of part A; `lidar`: what measures its scans, in words."""
    doctor: dict[str, Any] = {"work": Work.DOCTOR, "seconds": LISTEN_TIME}
    same: dict[str, Any] = {"work": Work.NOTHING, "of": "A6"}
    return (
        Step(
            "A1",
            "identity",
            "One daemon of this version must have this name and valid keys.",
            at_rest.findings_of("A1"),
            **doctor,
        ),
        Step(
            "A2",
            "clock",
            "Certificates and stamps need clocks that agree.",
            at_rest.findings_of("A2"),
            **doctor,
        ),
        Step(
            "A3",
            "computer",
            "A busy or under-powered computer delays commands.",
            at_rest.findings_of("A3"),
            work=Work.DOCTOR,
            seconds=_LOAD_TIME,
        ),
        Step(
            "A4",
            "link",
            "Stops come by this link: losses delay them, filtered multicast hides robots.",
            at_rest.findings_of("A4"),
            **doctor,
        ),
        check,
        Step(
            "A6",
            "base",
            "Only one program may drive the base, and the driver must have it.",
            at_rest.base,
            prepare="Leave the robot alone, on the floor, for a minute.",
            seconds=REST_TIME,
        ),
        Step(
            "A7",
            "scans",
            "Protection is as old as the last scan.",
            at_rest.scan_rate,
            **same,
        ),
        Step(
            "A8",
            "stamps",
            "Scan and odometry are joined by their stamps.",
            at_rest.stamps,
            **same,
        ),
        Step(
            "A9",
            "lidar",
            "A part of the robot in the scan, or a blind sector, hides what stands there.",
            at_rest.lidar,
            **same,
        ),
        Step(
            "A10",
            "odometry at rest",
            "Odometry carries each scan to the present.",
            at_rest.odometry_at_rest,
            **same,
        ),
        Step(
            "A11",
            "battery",
            "A robot with an empty battery stands in the way.",
            at_rest.battery,
            **same,
        ),
        *(_hand(*row, lidar) for row in _HANDS),
        Step(
            "A16",
            "own battery",
            "A topic without the robot's name may be that of another robot.",
            at_rest.own_battery,
            **same,
        ),
    )


# Id, side, and bearing in degrees of a hand.
_HANDS = (
    ("A12", "ahead of", 0.0),
    ("A13", "at the left of", 90.0),
    ("A14", "behind", 180.0),
    ("A15", "at the right of", -90.0),
)


def _hand(id: str, side: str, bearing: float, lidar: str) -> Step:
    return Step(
        id,
        f"hand {side} it",
        "A lidar that is turned or mirrored sends the robot into what it sees elsewhere.",
        at_rest.hand(bearing, "" if id == "A12" else "A12"),
        prepare=f"Stand back. Answer y, count to three, then hold a hand {side} the robot, 30 cm"
        f" away, as high as its {lidar}, until the next step.",
        seconds=_HAND_TIME,
    )


def _part_b() -> tuple[Step, ...]:
    return (
        _lifted(
            "B1",
            "stop",
            "Every other bound of this test needs a base that obeys zero.",
            stops.after_stop(),
            end=End.STOP,
        ),
        _lifted(
            "B2",
            "emergency stop",
            "It must hold until a reset.",
            stops.after_stop(latched=True),
            end=End.ESTOP,
        ),
        Step(
            "B3",
            "latch",
            "An emergency stop must outlive a restart of the daemon.",
            stops.latch_after_restart("B2"),
            work=Work.NOTHING,
            prepare="Restart the daemon on the robot (sudo systemctl restart swarmd), and wait"
            " until swarmctl members lists it.",
            needs=("B2",),
            is_latched=True,
        ),
        Step(
            "B4",
            "reset",
            "A reset clears the stop, and moves nothing.",
            stops.is_reset,
            work=Work.RESET,
            prepare="The emergency stop of this test will be cleared; nothing moves.",
            is_latched=True,
        ),
        _lifted(
            "B5",
            "laptop gone",
            "A run must end when the computer of its operator is gone.",
            stops.after_silence,
            end=End.SILENCE,
        ),
        _lifted(
            "B6",
            "link cut",
            "WiFi fails while robots drive.",
            stops.after_silence,
            prepare="While the wheels turn, cut the link of this computer (cable, WiFi) for 10 s.",
            end=End.PERSON,
        ),
        _lifted(
            "B7",
            "daemon killed",
            "The base, or the watchdog, stops the wheels without the daemon.",
            stops.across_gap("look at command_timeout, and at the watchdog of the daemon"),
            prepare="While the wheels turn, kill the daemon: sudo systemctl kill -s KILL swarmd."
            " systemd starts it again.",
            end=End.PERSON,
        ),
        _lifted(
            "B8",
            "driver lost",
            "A bridge or router between daemon and base fails.",
            stops.across_gap(
                "without a command timeout nothing stops it until its bridge is back: run"
                " the bridge by swarmd hub"
            ),
            prepare="While the wheels turn, kill the bridge of the base: sudo systemctl kill -s"
            " KILL zenoh-bridge-ros2dds. Start it after 10 s: sudo systemctl start"
            " zenoh-bridge-ros2dds swarmd.",
            end=End.PERSON,
        ),
        _lifted(
            "B9",
            "its own button",
            "The last stop that works must not pass through swarmd.",
            stops.own_stop(_PERSON_TIME),
            prepare="While the wheels turn, press the stop button of the base itself (or its"
            " switch of the motors), and release it once you are asked for Enter. Answer n if it"
            " has none.",
            end=End.PERSON,
        ),
    )


def _lifted(id: str, name: str, why: str, judge: Judge, *, end: End, prepare: str = "") -> Step:
    """A drive on lifted wheels that `end` ends; all after `B1` need it."""
    is_by_person = end is End.PERSON
    seconds = _PERSON_TIME if is_by_person else 8.0
    return Step(
        id,
        name,
        why,
        judge,
        prepare=f"Put the robot on a block, so that its wheels turn freely. {prepare}".rstrip(),
        question="Do the wheels turn freely, and is the way free if it falls off the block?",
        motion=Motion(
            "drive",
            {"speed": _TEST_SPEED, "recovery": False},
            seconds,
            speed=_TEST_SPEED,
            turn=0.0,
            reach=reach_of(_TEST_SPEED, seconds),
            is_lifted=True,
            end=end,
            end_after=2.5,
            absence=stops.ABSENCE if is_by_person else stops.LEASE,
        ),
        needs=() if id == "B1" else ("B1",),
        is_latched=end is End.ESTOP,
    )


def calibration_step(platform: Platform, floor: float, repeats: int = 4) -> Step:
    """The step of the calibration, on a free square floor with sides of `floor` m.

    `repeats`: drives to and fro at each of two speeds.
    """
    speeds = top_speeds(platform)
    return Step(
        "C2",
        "calibration",
        "Protection assumes how the base brakes, how soon it responds and how old scans are.",
        calibrated.calibration,
        prepare=f"Put the robot in the middle of a free floor of {floor:g} x {floor:g} m, with"
        " walls or furniture around; other robots stand.",
        question=f"Is the floor free, {floor:g} x {floor:g} m, and does it stay free?",
        motion=Motion(
            PATTERN,
            {"floor": floor, "repeats": repeats},
            _LONGEST_CALIBRATION,
            speed=speeds["linear"],
            turn=speeds["angular"],
            reach=0.5 * floor,
        ),
        needs=("B1",),
    )


def _part_c(platform: Platform) -> tuple[Step, ...]:
    turn = min(_TURN, platform.limits.angular)
    figures: dict[str, Any] = {"work": Work.NOTHING, "needs": ("C2",)}
    return (
        Step(
            "C1",
            "low speed",
            "Near obstacles protection commands centimetres per second.",
            calibrated.low_speed(_LOW_SPEED, _LOW_TIME),
            prepare="Put the robot on the floor.",
            question="Is the way ahead free for 0.5 m?",
            motion=Motion(
                "drive",
                {"speed": _LOW_SPEED, "recovery": False},
                _LOW_TIME,
                speed=_LOW_SPEED,
                turn=0.0,
                reach=reach_of(_LOW_SPEED, _LOW_TIME),
            ),
            needs=("B1",),
        ),
        calibration_step(platform, needed_floor(platform)),
        Step(
            "C3",
            "brakes",
            "A base that brakes more weakly than assumed stops too late.",
            calibrated.brakes("C2", "braking_linear", "braking_angular", "braking_lateral"),
            **figures,
        ),
        Step(
            "C4",
            "response",
            "A base that responds late drives on at the old command.",
            calibrated.margin("C2"),
            **figures,
        ),
        Step(
            "C5",
            "speed",
            "Patterns and protection count on the commanded speed.",
            calibrated.scales(
                *("C2", "speed_linear", "speed_angular", "speed_lateral"),
                cause="the base drives slower or faster than commanded: correct limits",
            ),
            **figures,
        ),
        Step(
            "C6",
            "odometry",
            "A wrong scale shifts every scan that is carried to the present.",
            calibrated.scales(
                *("C2", "odometry_linear", "odometry_angular", "odometry_lateral"),
                cause="the scale of odometry is wrong: correct wheel radius and separation",
            ),
            **figures,
        ),
        Step(
            "C7",
            "scan delay",
            "An obstacle moves while its scan is on the way.",
            calibrated.scan_delay("C2"),
            **figures,
        ),
        Step(
            "C8",
            "platform file",
            "The measured values make the robot more careful.",
            at_rest.findings_on("platform file"),
            work=Work.WRITE,
            prepare="The measured platform file will be written beside the results; the robot does"
            " not use it until its configuration names it.",
            needs=("C2",),
        ),
        Step(
            "C9",
            "level",
            "A tilted lidar sees the floor on one side, and overlooks robots on the other.",
            calibrated.level,
            prepare="Put the robot where the floor is free for 3 m on one side. It turns on the"
            " spot.",
            question="Is it free around?",
            motion=Motion(
                "drive",
                {"speed": 0.0, "turn": turn, "recovery": False},
                _TURNS * math.tau / turn,
                speed=0.0,
                turn=turn,
                reach=reach_of(0.0, 0.0),
            ),
            needs=("B1",),
        ),
        Step(
            "C10",
            "age of rays",
            "Protection moves each ray by the way since its measurement.",
            calibrated.ages("C2"),
            **figures,
        ),
    )


def _part_d(platform: Platform) -> tuple[Step, ...]:
    fastest = platform.limits.linear
    places = [(speed, side) for speed in _SHARES for side in _BEARINGS]
    boxes = [
        _approach(
            f"D{number}",
            f"box {side}, {speed}",
            approaches.distance_left,
            f"Put a box of 30 x 30 cm {_BOX_WAY:g} m from the robot, {_BEARINGS[side]}.",
            _SHARES[speed] * fastest,
        )
        for number, (speed, side) in enumerate(places, 1)
    ]
    half = 0.5 * fastest
    first = len(boxes) + 1
    passage = narrowest_passage(make_mode(platform))
    others = (platform.protection["barrier"] or {}).get("others_speed", _OTHERS_SPEED)
    door = 4.0 * _body_width(platform) if passage is None else passage.door + _DOOR_SLACK
    return (
        *boxes,
        _approach(
            f"D{first}",
            "box beside a turn",
            approaches.distance_left,
            "Put the box 0.5 m to the left of the robot: it drives a circle to the left.",
            half,
            turn=half / 0.4,
        ),
        _approach(
            f"D{first + 1}",
            "box pushed",
            approaches.pushed,
            "Push the box with a stick towards the robot, from 2 m ahead, as slowly as protection"
            f" assumes others: {others:g} m/s.",
            half,
        ),
        _approach(
            f"D{first + 2}",
            "along a wall",
            approaches.passage(_BOX_WAY),
            "Put the robot beside a wall, 25 cm away, with the way ahead free for 2.5 m.",
            half,
        ),
        _approach(
            f"D{first + 3}",
            "door",
            approaches.passage(_BOX_WAY),
            f"Put two boxes 0.6 m ahead as a door, {door:.2f} m apart.",
            half,
        ),
    )


def _body_width(platform: Platform) -> float:
    """The width of the outline in m."""
    return float(np.ptp(platform.footprint[:, 1]))


def _approach(
    id: str, name: str, judge: Judge, prepare: str, speed: float, *, turn: float = 0.0
) -> Step:
    """A drive ahead on the floor, for _BOX_WAY m at most."""
    return Step(
        id,
        name,
        "A robot may be hit at rest; it must not drive into anything.",
        judge,
        prepare=prepare,
        question="Is it so, and are people and other robots out of the way?",
        motion=Motion(
            "drive",
            {"speed": speed, "turn": turn, "recovery": False},
            _BOX_WAY / speed,
            speed=speed,
            turn=turn,
            reach=reach_of(speed, _BOX_WAY / speed),
        ),
        needs=("B1", "C2"),
    )


def _as_it_evades(step: Step, platform: Platform) -> Step:
    """The step with the speeds of mode `potential_field`, which evades a box at full speed."""
    motion = step.motion
    limits = platform.limits
    if motion is None or platform.protection["mode"] != "potential_field":
        return step
    reach = motion.reach + SLACK_TIME * (limits.linear - motion.speed)
    return replace(
        step, motion=motion._replace(speed=limits.linear, turn=limits.angular, reach=reach)
    )
