"""Origins and counters: replayed stops are refused, and others are not."""

from __future__ import annotations

import fcntl
import os
from functools import partial
from pathlib import Path

from msgspec.structs import replace

from swarmd.link.datagram import Ack, Stop
from swarmd.link.stops.stop_freshness import MAX_ORIGINS, REPLAYED, SLACK, StopFreshness
from swarmd.link.stops.stop_relay import StopRelay
from swarmd.operator.session.discovery import Discovery
from swarmd.operator.session.senders import ORIGIN_FILE, PendingStop, StopOrigin

HOME, LAB = b"home", b"lab!"
FAR = ("10.0.0.9", 7440)


def stop(name: str, counter: int, origin: bytes = HOME, age: int = 0) -> Stop:
    return Stop(id=name, verb="estop", operator="a", origin=origin, counter=counter, age=age)


def counts(robot: StopFreshness, one: Stop, now: float = 0.0) -> bool:
    return robot.take(one, now) is not None


class Issuer:
    """An operator's command: it repeats a stop, and takes a new origin once a robot refused it."""

    def __init__(self, numbers: StopOrigin) -> None:
        origin, counter = numbers.next()
        self.pending = PendingStop(
            stop(os.urandom(3).hex(), counter, origin),
            Discovery(0.0),
            0.0,
            renew=lambda: numbers.next(is_new=True),
        )

    def repeat(self) -> Stop:
        return next(iter(self.pending.datagrams(1.0)))[0]

    def send(self, robot: StopFreshness) -> int:
        """The number of copies until the robot takes it."""
        for copies in range(1, 4):
            one = self.repeat()
            if robot.take(one, 1.0) is not None:
                return copies
            ack = Ack(
                id=one.id, robot="r1", instance=b"123456", revision=0, code="refused",
                refusal=REPLAYED,
            )  # fmt: skip
            assert not self.pending.on_ack(ack, 1.0 + copies)
        raise AssertionError("refused for good")


# A robot


def test_a_replay_of_an_earlier_stop_is_refused() -> None:
    robot = StopFreshness()
    assert counts(robot, stop("old", 1000))
    for number in range(2000):  # the robot does not remember the id for ever
        assert counts(robot, stop(f"s{number}", SLACK + 2000 + number))
    assert not counts(robot, stop("old", 1000))
    assert not counts(robot, stop("another", 1000))


def test_a_copy_of_a_known_stop_is_as_old_as_the_first() -> None:
    robot = StopFreshness()
    first = robot.take(stop("s", 1000), 50.0)
    again = robot.take(stop("s", 1000), 80.0)
    assert first is not None
    assert again is not None
    assert (first.is_repeated, first.stop.age) == (False, 0)
    assert (again.is_repeated, again.stop.age) == (True, 30_000)
    older = robot.take(stop("s", 1000, age=90_000), 80.0)
    assert older is not None
    assert older.stop.age == 90_000


def test_stops_of_one_moment_count_in_any_order() -> None:
    robot = StopFreshness()
    assert counts(robot, stop("later", 10_000_000))
    assert counts(robot, stop("earlier", 10_000_000 - SLACK + 1))
    assert not counts(robot, stop("replayed", 10_000_000 - SLACK))


def test_a_robot_that_restarts_refuses_what_it_heard_before() -> None:
    before = StopFreshness()
    assert counts(before, stop("s", 5000))
    after = StopFreshness(before.counters)
    assert not counts(after, stop("s", 5000))
    assert counts(after, stop("t", 5001))
    assert counts(after, stop("u", 1, LAB))


def test_origins_are_bounded_and_the_oldest_goes() -> None:
    robot = StopFreshness()
    for number in range(2 * MAX_ORIGINS):
        assert counts(robot, stop(f"s{number}", 1, number.to_bytes(4, "big")))
    assert len(robot.counters) == MAX_ORIGINS
    assert (2 * MAX_ORIGINS - 1).to_bytes(4, "big") in robot.counters


# A robot and its operators: the cases of the module's docstring


def test_an_origin_that_was_forgotten_has_no_floor_of_an_earlier_life_left() -> None:
    """Stops of one moment count in any order again, once its floor has gone with it."""
    robot = StopFreshness({HOME: 10_000_000})
    for number in range(MAX_ORIGINS):
        robot.take(stop(f"s{number}", 1, origin=number.to_bytes(4, "big")), 0.0)
    assert counts(robot, stop("later", 10_000_000))
    assert counts(robot, stop("earlier", 10_000_000 - SLACK + 1))


def test_two_machines_of_one_operator_have_origins_of_their_own(tmp_path: Path) -> None:
    robot = StopFreshness()
    for name, at in (("laptop", 5000.0), ("desk", 100.0), ("laptop", 6000.0), ("desk", 200.0)):
        (tmp_path / name).mkdir(exist_ok=True)
        assert Issuer(StopOrigin(tmp_path / name, partial(float, at))).send(robot) == 1


def test_a_clock_that_is_set_back_goes_on_from_the_file(tmp_path: Path) -> None:
    robot = StopFreshness()
    for at in (5000.0, 0.0, 1.0, 5001.0):
        assert Issuer(StopOrigin(tmp_path, partial(float, at))).send(robot) == 1
    assert len(robot.counters) == 1


def test_a_copied_home_whose_clock_is_behind_takes_a_new_origin(tmp_path: Path) -> None:
    robot = StopFreshness()
    numbers = StopOrigin(tmp_path, lambda: 1.0)
    numbers.next()
    copy = (tmp_path / ORIGIN_FILE).read_bytes()
    assert Issuer(StopOrigin(tmp_path, lambda: 9000.0)).send(robot) == 1
    (tmp_path / ORIGIN_FILE).write_bytes(copy)
    assert Issuer(numbers).send(robot) == 2
    assert Issuer(numbers).send(robot) == 1  # the file has the new origin


def test_a_lost_or_damaged_file_gives_a_new_origin(tmp_path: Path) -> None:
    robot = StopFreshness()
    for content in (None, b"", b"junk", b"\x92\xc4\x04home\xff"):
        if content is not None:
            (tmp_path / ORIGIN_FILE).write_bytes(content)
        assert Issuer(StopOrigin(tmp_path, lambda: 1.0)).send(robot) == 1
    assert len(robot.counters) == 4


def test_without_a_file_each_command_has_an_origin(tmp_path: Path) -> None:
    robot = StopFreshness()
    for folder in (None, tmp_path / "absent", None):
        assert Issuer(StopOrigin(folder, lambda: 1.0)).send(robot) == 1
    with (tmp_path / ORIGIN_FILE).open("wb") as held:  # another command holds it, or hangs
        fcntl.flock(held, fcntl.LOCK_EX)
        assert Issuer(StopOrigin(tmp_path, lambda: 1.0)).send(robot) == 1
    assert len(robot.counters) == 4


def test_a_stop_under_way_reaches_a_robot_that_restarts(tmp_path: Path) -> None:
    before = StopFreshness()
    issuer = Issuer(StopOrigin(tmp_path, lambda: 1.0))
    assert issuer.send(before) == 1
    assert issuer.send(StopFreshness(before.counters)) == 2


def test_counters_that_a_stolen_robot_forges_delay_a_stop_by_one_repeat(tmp_path: Path) -> None:
    robot = StopFreshness()
    issuer = Issuer(StopOrigin(tmp_path, lambda: 1.0))
    origin = issuer.repeat().origin
    assert counts(robot, stop("forged", 2**53, origin))
    assert issuer.send(robot) == 2


def test_a_relay_hands_on_the_refusal_and_then_the_newer_origin() -> None:
    relay, operator = StopRelay("r2", 1), ("10.0.0.250", 5000)
    first = stop("s", 5, HOME)
    relay.on_stop(first, operator, 0.0)
    assert [one.origin for one in relay.advance(0.3)] == [HOME]
    refused = Ack(
        id="s", robot="r3", instance=b"123456", revision=0, code="refused", refusal=REPLAYED
    )
    for _ in range(2):
        ((handed, address),) = relay.on_ack(refused, FAR)
        assert isinstance(handed, Ack)
        assert (handed.via, handed.refusal, address) == ("r2", REPLAYED, operator)
    relay.on_stop(replace(first, origin=LAB, counter=1), operator, 0.5)
    (again,) = [one for at in range(10) for one in relay.advance(0.6 + 0.1 * at)][:1]
    assert (again.origin, again.counter, again.id) == (LAB, 1, "s")
    applied = replace(refused, refusal=None, code="applied")
    assert [address for _, address in relay.on_ack(applied, FAR)] == [operator]
