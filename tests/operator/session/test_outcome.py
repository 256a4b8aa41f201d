"""Targeted robots, their replies, and the exit code."""

from __future__ import annotations

import pytest

from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.refusal import Refusal
from swarmd.link.datagram import Ack
from swarmd.operator.session.exit_codes import FAILED, NO_TARGET, PARTIAL, REFUSED, TIMEOUT, USAGE
from swarmd.operator.session.outcome import Acks


def reply(robot: str, code: Code = Code.APPLIED, *, instance: str = "b", id: str = "q") -> Reply:
    return Reply(id=id, robot=robot, code=code, epoch=Epoch(instance=instance, revision=1))


def acks(**codes: Code) -> Acks:
    found = Acks("q")
    for name, code in codes.items():
        found.on_reply(name, reply(name, code))
    return found


APPLIED = Code.APPLIED
NO = Code.REFUSED
BAD = Code.FAILED


@pytest.mark.parametrize(
    ("codes", "expected", "exit_code"),
    [
        ({}, (), NO_TARGET),
        ({"a": APPLIED, "b": APPLIED}, ("a", "b"), 0),
        ({"a": APPLIED}, ("a", "b"), PARTIAL),
        ({}, ("a", "b"), TIMEOUT),
        ({"a": NO, "b": NO}, ("a", "b"), REFUSED),
        ({"a": BAD, "b": BAD}, ("a", "b"), FAILED),
        ({"a": NO, "b": APPLIED}, ("a", "b"), PARTIAL),
        ({"a": BAD, "b": APPLIED}, ("a", "b"), PARTIAL),
        ({"a": NO, "b": BAD}, ("a", "b"), FAILED),
        ({"a": BAD}, ("a", "b"), FAILED),
        ({"a": NO}, ("a", "b"), TIMEOUT),
        ({"a": NO, "b": BAD}, ("a", "b", "c"), FAILED),
    ],
)
def test_the_exit_code(codes: dict[str, Code], expected: tuple[str, ...], exit_code: int) -> None:
    assert acks(**codes).outcome(expected).exit_code == exit_code


@pytest.mark.parametrize(
    ("refusals", "exit_code"),
    [
        ((Refusal.UNKNOWN_PATTERN, Refusal.UNKNOWN_PATTERN), USAGE),
        ((Refusal.INVALID_PARAMETER, Refusal.INVALID_PARAMETER), USAGE),
        ((Refusal.INVALID_PARAMETER,), USAGE),
        ((Refusal.STALE_EPOCH,), TIMEOUT),
        ((Refusal.STALE_EPOCH, Refusal.STALE_EPOCH), REFUSED),
        ((Refusal.UNKNOWN_PATTERN, Refusal.BUSY), REFUSED),
        ((Refusal.UNKNOWN_PATTERN, None), PARTIAL),
    ],
)
def test_a_mistake_that_every_robot_that_answers_refuses_is_usage(
    refusals: tuple[Refusal | None, ...], exit_code: int
) -> None:
    found = Acks("q")
    for name, refusal in zip("ab", refusals, strict=False):
        code = APPLIED if refusal is None else NO
        found.on_reply(name, Reply(id="q", robot=name, code=code, refusal=refusal, text="why"))
    outcome = found.outcome(("a", "b"))
    assert outcome.exit_code == exit_code
    assert bool(outcome.mistake) is (exit_code == USAGE)


def test_the_line_names_robots_that_did_not_apply() -> None:
    found = acks(a=APPLIED, b=NO, c=BAD)
    assert found.outcome(("a", "b", "c", "d", "e")).line == (
        "5 targeted, 1 applied, 1 refused (b), 1 failed (c), 2 no answer (d, e)"
    )


def test_an_unexpected_reply_counts_as_targeted() -> None:
    outcome = acks(a=APPLIED, x=NO).outcome(("a",))
    assert outcome.targeted == 2
    assert outcome.exit_code == PARTIAL


def test_replies_to_another_request_do_not_count() -> None:
    found = Acks("q")
    assert not found.on_reply("a", reply("a", id="another"))
    assert not found.on_reply("a", reply("b"))
    assert found.outcome(("a",)).missing == ("a",)


def test_the_worse_reply_of_a_duplicate_id_counts() -> None:
    found = Acks("q")
    found.on_reply("a", reply("a", NO, instance="1"))
    found.on_reply("a", reply("a", NO, instance="1"))
    assert found.outcome(("a",)).duplicates == ()
    found.on_reply("a", reply("a", APPLIED, instance="2"))
    outcome = found.outcome(("a",))
    assert outcome.refused == ("a",)
    assert outcome.duplicates == ("a",)


def ack(robot: str, *, via: str = "", text: str = "zero", instance: int = 1) -> Ack:
    return Ack(
        id="q",
        robot=robot,
        instance=bytes([instance] * 6),
        revision=3,
        code=APPLIED,
        text=text,
        via=via,
    )


def test_an_ack_that_another_robot_handed_on_counts_and_says_so() -> None:
    found = Acks("q")
    assert found.on_ack(ack("a", via="b"))
    outcome = found.outcome(("a",))
    assert outcome.exit_code == 0
    assert outcome.replies["a"].text == "zero (by b's word)"


@pytest.mark.parametrize("order", [("", "b"), ("b", "")])
def test_a_robots_own_ack_comes_before_one_that_was_handed_on(order: tuple[str, str]) -> None:
    found = Acks("q")
    for via in order:
        found.on_ack(ack("a", via=via))
    assert found.outcome(("a",)).replies["a"].text == "zero"


def test_the_newest_ack_counts_and_two_instances_are_a_duplicate() -> None:
    found = Acks("q")
    found.on_ack(ack("a", text="0.2 m/s"))
    found.on_ack(ack("a", text="0.0 m/s"))
    assert found.outcome(("a",)).replies["a"].text == "0.0 m/s"
    assert not found.lacks("a", {"01" * 6})
    assert found.lacks("a", {"01" * 6, "02" * 6})
    found.on_ack(ack("a", instance=2))
    assert found.outcome(("a",)).duplicates == ("a",)


def test_forged_acks_are_bounded() -> None:
    found = Acks("q")
    for number in range(3000):
        found.on_ack(ack(f"r{number}"))
        found.on_ack(ack("r0", instance=number % 250))
    outcome = found.outcome(())
    assert outcome.targeted == 1024
