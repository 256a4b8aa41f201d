"""Targeted robots, their replies, and the exit code."""

from __future__ import annotations

import pytest

from swarmd.core.messages import Code, Epoch, Member, Presence, Refusal, Reply
from swarmd.network.outcome import (
    FAILED,
    NO_TARGET,
    PARTIAL,
    REFUSED,
    TIMEOUT,
    USAGE,
    Acks,
    expected_to_run,
    expected_to_stop,
)


def reply(robot: str, code: Code = Code.APPLIED, *, instance: str = "b", id: str = "q") -> Reply:
    return Reply(id=id, robot=robot, code=code, epoch=Epoch(instance=instance, revision=1))


def member(robot: str, presence: Presence, age: float = 0.0) -> Member:
    return Member(robot=robot, instance="i", presence=presence, age=age)


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
        ({"a": NO, "b": BAD}, ("a", "b"), PARTIAL),
        ({"a": NO}, ("a", "b"), PARTIAL),
        ({"a": BAD}, ("a", "b"), PARTIAL),
    ],
)
def test_the_exit_code(codes: dict[str, Code], expected: tuple[str, ...], exit_code: int) -> None:
    assert acks(**codes).outcome(expected).exit_code == exit_code


@pytest.mark.parametrize(
    ("refusals", "exit_code"),
    [
        ((Refusal.UNKNOWN_PATTERN, Refusal.UNKNOWN_PATTERN), USAGE),
        ((Refusal.INVALID_PARAMETER, Refusal.INVALID_PARAMETER), USAGE),
        ((Refusal.STALE_EPOCH, Refusal.STALE_EPOCH), REFUSED),
        ((Refusal.UNKNOWN_PATTERN, Refusal.BUSY), REFUSED),
        ((Refusal.UNKNOWN_PATTERN, None), PARTIAL),
    ],
)
def test_a_mistake_that_every_robot_refuses_is_usage(
    refusals: tuple[Refusal | None, ...], exit_code: int
) -> None:
    found = Acks("q")
    for name, refusal in zip("ab", refusals, strict=True):
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


MEMBERS = {
    "alive": member("alive", Presence.ALIVE),
    "just-failed": member("just-failed", Presence.FAILED, 60.0),
    "long-failed": member("long-failed", Presence.FAILED, 60.1),
    "left": member("left", Presence.LEFT),
}


def test_run_counts_robots_that_failed_recently_and_warns_of_others() -> None:
    expected = expected_to_run(MEMBERS, (), MEMBERS)
    assert expected.asked == ("alive",)
    assert expected.absent == ("just-failed",)
    assert len(expected.warnings) == 1
    assert "long-failed failed 60 s ago" in expected.warnings[0]


def test_run_counts_robots_on_the_roster() -> None:
    roster = ("long-failed", "left", "unseen", "not-selected")
    expected = expected_to_run(MEMBERS, roster, {*MEMBERS, "unseen"})
    assert expected.asked == ("alive",)
    assert expected.absent == ("just-failed", "left", "long-failed", "unseen")
    assert expected.warnings == ()


def test_stop_counts_failed_robots() -> None:
    selected = {*MEMBERS, "unseen"}
    assert expected_to_stop(MEMBERS, (), selected) == {"alive", "just-failed", "long-failed"}
    assert expected_to_stop(MEMBERS, ("unseen",), selected) >= {"unseen"}
