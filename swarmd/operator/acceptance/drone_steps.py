"""The steps of an acceptance test that are a drone's own: it takes off, flies and lands."""

from __future__ import annotations

from swarmd.core.values import Platform
from swarmd.operator.acceptance import approaches, calibrated, flights, stops
from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.step import End, Judge, Motion, Step, Work, reach_of
from swarmd.operator.acceptance.verdict import Verdict, not_shown

_SPEED = 0.1  # m/s
_TAKE_OFF = 4.0  # s, with the estimate that must rest before
_FLIGHT = 15.0  # s with the take-off; a person acts meanwhile
_LANDING = 10.0  # s: 5 s of hovering, and the way down
# m to a wall ahead whose range shows the way, and the way
_WALL = 1.8
_WALL_WAY = 1.0
_NEAR_WALL = 1.2  # m
_AHEAD = 2.0  # m of free air
_SHARES = {"slowly": 0.3, "at half speed": 0.6, "at full speed": 1.0}
_FREE = "Is the air free, 0.5 m around the drone and {:g} m ahead of it, and do people stand back?"
_SOFT = "The drone falls from its height: answer n, unless it flies over a soft mat. While it flies"


def _not_asked(id: str, name: str, why: str) -> Step:
    """A row that says what is not asked of a drone."""

    def judge(evidence: Evidence) -> Verdict:
        return not_shown("not asked of a drone")

    return Step(id, f"{name}: not asked", why, judge, work=Work.NOTHING)


CHECK = _not_asked(
    "A5",
    "check",
    "A second program must not open the drone's link beside its daemon, so run swarmd --check"
    " before the daemon.",
)


def flying_steps(platform: Platform) -> tuple[Step, ...]:
    """Parts B, C and D for a drone."""
    height = 0.5 if platform.heights is None else platform.heights.scan_plane
    fastest = platform.limits.linear
    return (
        *_part_b(height),
        Step(
            "C1",
            "hover",
            "Other robots count on its height, and protection on a zero that stands.",
            flights.lands(flights.hovers),
            prepare="Set the drone on the floor.",
            question=_FREE.format(_AHEAD),
            motion=_motion(height, 0.0, _TAKE_OFF + 6.0),
            needs=("B1",),
        ),
        Step(
            "C2",
            "flight ahead",
            "Patterns and protection count on the commanded speed.",
            flights.lands(calibrated.low_speed(_SPEED, _WALL_WAY / _SPEED)),
            prepare=f"Set the drone on the floor, {_WALL:g} m from a wall that it faces.",
            question=_FREE.format(_WALL),
            motion=_motion(height, _SPEED, _TAKE_OFF + _WALL_WAY / _SPEED),
            needs=("B1",),
        ),
        Step(
            "C3",
            "odometry",
            "A wrong scale shifts every scan that is carried to the present.",
            flights.scale,
            work=Work.NOTHING,
            of="C2",
            needs=("C2",),
        ),
        _not_asked(
            "C4",
            "brakes, response, scan delay",
            "The first drive of calibrate is over before a drone has taken off.",
        ),
        *(
            Step(
                f"D{number}",
                f"wall ahead, {name}",
                "A robot may be hit at rest; it must not drive into anything.",
                approaches.distance_left,
                prepare=f"Set the drone on the floor, {_NEAR_WALL:g} m from a wall that it faces.",
                question="Is it so, and do people and other robots stand back?",
                motion=_motion(height, share * fastest, _TAKE_OFF + _NEAR_WALL / share / fastest),
                needs=("B1", "C2"),
            )
            for number, (name, share) in enumerate(_SHARES.items(), 1)
        ),
        _not_asked(
            f"D{len(_SHARES) + 1}",
            "box, turn, push, door",
            "Four ranges see nothing between their cones, so that a drone may touch a box there.",
        ),
    )


def _part_b(height: float) -> tuple[Step, ...]:
    return (
        _flight(
            height,
            "B1",
            "stop",
            "Every other bound of this test needs a drone that obeys zero and lands.",
            flights.lands(stops.after_stop()),
            end=End.STOP,
        ),
        _flight(
            height,
            "B2",
            "emergency stop",
            "It must land the drone at once, and hold until a reset.",
            flights.lands(stops.after_stop(latched=True)),
            end=End.ESTOP,
        ),
        Step(
            "B3",
            "latch",
            "An emergency stop must outlive a restart of the daemon.",
            stops.latch_after_restart("B2"),
            work=Work.NOTHING,
            prepare="Restart the daemon of the drone, and wait until swarmctl members lists it.",
            needs=("B2",),
            is_latched=True,
        ),
        Step(
            "B4",
            "reset",
            "A reset clears the stop, and starts no motor.",
            stops.is_reset,
            work=Work.RESET,
            prepare="The emergency stop of this test will be cleared; nothing moves.",
            is_latched=True,
        ),
        _flight(
            height,
            "B5",
            "laptop gone",
            "A run must end when the computer of its operator is gone.",
            flights.lands(stops.after_silence),
            end=End.SILENCE,
        ),
        _flight(
            height,
            "B6",
            "link cut",
            "WiFi fails while drones fly.",
            flights.lands(stops.after_silence),
            prepare="While it flies ahead, cut the link from this computer to that of the daemon"
            " for 10 s; answer n if they are one.",
            end=End.PERSON,
        ),
        _flight(
            height,
            "B7",
            "daemon killed",
            "The firmware stops the drone without the daemon.",
            stops.across_gap("look at command_timeout, and at the firmware"),
            prepare=f"{_SOFT} ahead, kill its daemon by kill -9, and start it again.",
            end=End.PERSON,
        ),
        _flight(
            height,
            "B8",
            "radio lost",
            "The radio between daemon and drone fails.",
            stops.across_gap("look at command_timeout, and at the firmware"),
            prepare=f"{_SOFT} ahead, unplug the radio, and plug it in after 5 s.",
            end=End.PERSON,
        ),
    )


def _flight(
    height: float, id: str, name: str, why: str, judge: Judge, *, end: End, prepare: str = ""
) -> Step:
    """A flight ahead that `end` ends; all after `B1` need it."""
    return Step(
        id,
        name,
        why,
        judge,
        prepare=f"Set the drone on the floor. {prepare}".rstrip(),
        question=_FREE.format(_AHEAD),
        motion=_motion(height, _SPEED, _FLIGHT)._replace(
            end=end,
            end_after=_TAKE_OFF + 2.5,
            absence=stops.ABSENCE if end is End.PERSON else stops.LEASE,
        ),
        needs=() if id == "B1" else ("B1",),
        is_latched=end is End.ESTOP,
    )


def _motion(height: float, speed: float, seconds: float) -> Motion:
    """A flight ahead that ends by itself; at 0 m/s the drone hovers, and drifts."""
    most = speed or stops.HOVER_DRIFT
    return Motion(
        "drive",
        {"speed": speed, "recovery": False},
        seconds,
        speed=most,
        turn=0.0,
        reach=reach_of(most, seconds),
        height=height,
        rest=_LANDING,
    )
