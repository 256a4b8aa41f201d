"""What a hand sends and when, its keys and its words, and how it ends, without a network."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, cast

import msgspec
import pytest

from swarmd.core.codec import encode
from swarmd.core.errors import ConfigError, RequestError
from swarmd.core.messages import Code, Epoch, Reason, Reply, State, Status
from swarmd.core.values import ZERO, Twist
from swarmd.core.verbs import DriveRequest
from swarmd.link.datagram import Drive
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.verbs.drive.ask import Commands, take
from swarmd.operator.verbs.drive.words import Key, keys_of, line_of, motion_of, speed_after
from tests.support.hand import HandOn
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS

CAP = 30.0  # s
AHEAD = Twist(0.1, 0.5)


def sent(commands: Commands, begin: float, end: float) -> list[tuple[float, Twist]]:
    """What is sent between two times, looked at each ms."""
    words = []
    for ms in range(round(1000 * begin), round(1000 * end)):
        word = commands.take(ms / 1000)
        if word is not None:
            words.append((ms / 1000, word.twist))
    return words


def test_a_motion_is_sent_at_once_with_two_copies_then_ten_times_a_second() -> None:
    commands = Commands(0.0)
    assert sent(commands, 0.0, 0.15) == [(0.0, ZERO), (0.1, ZERO)]
    commands.move(AHEAD, 0.7, 0.15)
    times = [at for at, _ in sent(commands, 0.15, 0.5)]
    assert times == pytest.approx([0.15, 0.18, 0.21, 0.31, 0.41], abs=2e-3)  # of rounding


def test_a_motion_ends_after_its_seconds_and_a_repeat_renews_it() -> None:
    commands = Commands(0.0)
    commands.move(AHEAD, 0.7, 0.0)
    assert all(twist == AHEAD for _, twist in sent(commands, 0.0, 0.6))
    commands.move(AHEAD, 0.7, 0.6)
    words = sent(commands, 0.6, 2.0)
    assert {twist for at, twist in words if at < 1.3} == {AHEAD}
    assert [at for at, twist in words if twist == ZERO][:3] == [1.3, 1.33, 1.36]


def test_the_numbers_of_commands_rise() -> None:
    commands = Commands(0.0)
    orders = [word.order for ms in range(500) if (word := commands.take(ms / 1000))]
    assert orders == [1, 2, 3, 4, 5]


def test_a_pause_ends_when_a_command_or_the_end_of_a_motion_is_due() -> None:
    commands = Commands(0.0)
    commands.take(0.0)
    assert commands.pause(0.0) == pytest.approx(0.1)
    commands.move(AHEAD, 0.12, 0.0)
    sent(commands, 0.0, 0.061)
    assert commands.pause(0.061) == pytest.approx(0.12 - 0.061)


# Keys and words


@pytest.mark.parametrize(
    ("data", "keys"),
    [
        (b"wasd", [Key.FORWARD, Key.LEFT, Key.BACK, Key.RIGHT]),
        (b"W", [Key.FORWARD]),
        (b"\x1b[A\x1b[B\x1bOC\x1b[D", [Key.FORWARD, Key.BACK, Key.RIGHT, Key.LEFT]),
        (b" \r\nxq+-", [Key.STAND, Key.RELEASE, Key.RELEASE, Key.STOP, Key.LEAVE, Key.FASTER,
                        Key.SLOWER]),
        (b"\x1b[", []),
        (b"\xff\x1b[Z?", []),
    ],
)  # fmt: skip
def test_keys(data: bytes, keys: list[Key]) -> None:
    assert [*keys_of(data)] == keys


def test_motions_and_speeds_of_keys() -> None:
    assert motion_of(Key.BACK, 0.1) == (-0.1, 0.0)
    assert motion_of(Key.RIGHT, 0.1) == (0.0, -0.5)
    assert motion_of(Key.STAND, 0.1) == (0.0, 0.0)
    assert motion_of(Key.FASTER, 0.1) is None
    assert speed_after(Key.SLOWER, 0.02) == 0.02
    assert speed_after(Key.FASTER, 1.0) == 1.0


def driven() -> tuple[RobotHarness, HandOn]:
    harness = RobotHarness("waffle_pi", PATTERNS)
    harness.advance(1.0)
    harness.applied("run", pattern="forward")
    hand = HandOn(harness)
    hand.take()
    hand.drive(0.3)
    return harness, hand


def test_the_line_says_what_waits_and_why_the_base_stands() -> None:
    harness, hand = driven()
    assert "forward waits" in line_of("tb3-01", harness.status, 0.1)
    assert "held" not in line_of("tb3-01", harness.status, 0.1)
    harness.scans = lambda seq, now: None
    hand.drive(1.0)
    assert "held: stale_scan" in line_of("tb3-01", harness.status, 0.1)


# A hand


class FakeOperator:
    """Answers requests with `code`, and keeps what is sent."""

    name = "anna"

    def __init__(self, code: Code = Code.APPLIED) -> None:
        self.code = code
        self.requests: list[dict[str, Any]] = []
        self.sent: list[Drive] = []
        self.moves = threading.Event()
        self.on_status: Callable[[str, bytes], object] = lambda robot, payload: None

    def request(self, kind: type[DriveRequest], targets: Any, **fields: Any) -> Outcome:
        self.requests.append(fields)
        epoch = Epoch("0123456789ab", 7)
        reply = Reply(id="h1", robot="tb3-01", code=self.code, text="driven by bob", epoch=epoch)
        return Outcome({"tb3-01": reply})

    def send_to_robots(self, make: Callable[[], Drive], robots: Any) -> None:
        drive = make()
        self.sent.append(drive)
        if drive.linear:
            self.moves.set()

    def watch(self, name: str, handler: Callable[[str, bytes], object], robot: str) -> None:
        self.on_status = handler

    def unwatch(self, name: str, robot: str) -> None:
        self.on_status = lambda robot, payload: None


def taken(operator: FakeOperator) -> Any:
    return take(cast(Operator, operator), MembersView({}), "tb3-01")


def told(operator: FakeOperator, **fields: Any) -> Status:
    """The robot tells a status, at the epoch at which it was taken."""
    harness, _ = driven()
    status = msgspec.structs.replace(
        harness.status, epoch=Epoch("0123456789ab", 7), driven_by="anna"
    )
    status = msgspec.structs.replace(status, **fields)
    operator.on_status("tb3-01", encode(status))
    return status


def test_a_refused_hand_raises_and_sends_nothing() -> None:
    operator = FakeOperator(Code.REFUSED)
    with pytest.raises(RequestError) as refused:
        taken(operator)
    assert "driven by bob" in str(refused.value)
    assert operator.sent == []


def test_a_block_sends_its_commands_and_releases_by_word() -> None:
    operator = FakeOperator()
    with taken(operator) as hand:
        hand.move(0.1, 0.5)
        assert operator.moves.wait(CAP)
    assert [one["is_release"] for one in operator.requests[1:]] == [True]
    assert operator.requests[1]["hand"] == "h1"
    orders = [drive.order for drive in operator.sent]
    assert orders == sorted(set(orders))
    assert {(one.robot, one.hand, one.operator) for one in operator.sent} == {
        ("tb3-01", "h1", "anna")
    }


def test_a_block_that_raises_releases_nothing() -> None:
    operator = FakeOperator()
    with pytest.raises(ZeroDivisionError), taken(operator):
        raise ZeroDivisionError
    assert len(operator.requests) == 1


def test_a_hand_is_over_when_the_daemon_of_the_robot_has_started_again() -> None:
    operator = FakeOperator()
    hand = taken(operator)
    told(operator, driven_by="", epoch=Epoch("ba9876543210", 0))  # it counts from 0 again
    assert hand.is_over
    hand.close()


def test_a_hand_that_the_robot_has_ended_says_why_and_moves_nothing() -> None:
    operator = FakeOperator()
    hand = taken(operator)
    told(operator, driven_by="", epoch=Epoch("0123456789ab", 6))  # of before it was taken
    assert not hand.is_over
    told(operator)
    assert not hand.is_over
    told(operator, driven_by="", state=State.STOPPED, reason=Reason.OPERATOR, detail="by bob")
    assert hand.is_over
    assert "by bob" in hand.over
    with pytest.raises(RequestError):
        hand.move(0.1)
    hand.close()


def test_values_that_are_no_speeds_or_times_are_refused() -> None:
    hand = taken(FakeOperator())
    for wrong in ({"forward": float("nan")}, {"forward": 101.0}, {"forward": 0.1, "seconds": 0.0}):
        with pytest.raises(ConfigError):
            hand.move(**wrong)
    hand.close()
