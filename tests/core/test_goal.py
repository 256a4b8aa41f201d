from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from swarmd.core.errors import CodecError
from swarmd.core.goal import (
    MAX_GOAL,
    Goal,
    HeldGoal,
    decode_goal,
    digest_of,
    encode_goal,
    signed_part,
)
from swarmd.core.record import generation_of


def test_a_goal_is_read_as_it_was_written() -> None:
    goal = Goal(generation=7, issuer="alice", id="ab", pattern="drive", params={"speed": 0.1})
    assert decode_goal(encode_goal(goal)) == goal
    assert generation_of(digest_of(goal)) == 7
    assert generation_of(digest_of(None)) == 0


@pytest.mark.parametrize(
    ("targets", "is_target"),
    [((), True), (("r01",), True), (("r*",), True), (("label:red",), True), (("label:r",), False)],
)
def test_targets_are_names_globs_and_labels(targets: tuple[str, ...], is_target: bool) -> None:
    goal = Goal(generation=1, issuer="alice", id="ab", targets=targets)
    assert goal.is_for("r01", {"red"}) is is_target


def test_the_order_is_by_generation_and_then_by_issuer() -> None:
    goals = [(2, "alice"), (1, "bob"), (2, "bob")]
    ordered = sorted(
        (Goal(generation=n, issuer=who, id="x") for n, who in goals), key=lambda goal: goal.order
    )
    assert [goal.order for goal in ordered] == [(1, "bob"), (2, "alice"), (2, "bob")]


def test_the_signature_is_no_part_of_what_is_signed() -> None:
    goal = Goal(generation=1, issuer="alice", id="ab")
    signed = Goal(generation=1, issuer="alice", id="ab", signature=bytes(64))
    assert signed_part(goal) == signed_part(signed)
    assert digest_of(goal) == digest_of(signed)
    held, again = HeldGoal.of(goal, None), HeldGoal.of(signed, None)
    assert (held.order, held.content) == (again.order, again.content)


@pytest.mark.parametrize(
    "change",
    [
        lambda content: b"\xde\x00" + bytes([content[0] & 0x0F]) + content[1:],
        lambda content: bytes([content[0] + 1]) + content[1:] + b"\xa4more\x01",
        lambda content: bytes([content[0] + 1]) + b"\xa6issuer\xa3eve" + content[1:],
        lambda content: content.replace(b"\xa5alice", b"\xd9\x05alice"),
        lambda content: content.replace(b"\x82\xa1a\x01\xa1b\x02", b"\x82\xa1b\x02\xa1a\x01"),
        lambda content: content.replace(b"\xa1a\x01", b"\xa1a\xd3" + bytes(7) + b"\x01"),
    ],
    ids=["head", "unknown field", "field twice", "string head", "order of parameters", "integer"],
)
def test_another_encoding_is_the_same_goal(change: Callable[[bytes], bytes]) -> None:
    goal = Goal(generation=7, issuer="alice", id="x", pattern="drive", params={"a": 1, "b": 2})
    changed = change(encode_goal(goal))
    assert changed != encode_goal(goal)
    again = decode_goal(changed)
    assert signed_part(again) == signed_part(goal)
    assert digest_of(again) == digest_of(goal)
    assert HeldGoal.of(again, None).order == HeldGoal.of(goal, None).order


def test_bytes_after_a_goal_are_refused() -> None:
    with pytest.raises(CodecError):
        decode_goal(encode_goal(Goal(generation=1, issuer="alice", id="ab")) + b"\0")


def test_two_goals_of_one_generation_and_issuer_have_an_order() -> None:
    goals = [Goal(generation=1, issuer="alice", id=id, signature=bytes(64)) for id in ("a", "b")]
    one, two = (HeldGoal.of(goal, None) for goal in goals)
    assert one.order < two.order
    assert one.digest != two.digest


@pytest.mark.parametrize("content", [b"", b"\xc1", b"\x80", bytes(1001)])
def test_what_is_no_goal_is_refused(content: bytes) -> None:
    with pytest.raises(CodecError):
        decode_goal(content)


def test_a_goal_that_no_datagram_carries_is_refused() -> None:
    goal = Goal(generation=1, issuer="a", id="b", targets=tuple(f"robot-{n:04}" for n in range(99)))
    with pytest.raises(CodecError, match="fewer targets"):
        encode_goal(goal)


def test_a_goal_that_would_be_handed_on_with_more_bytes_is_refused() -> None:
    """An encoding may leave out defaults, which the goal of a robot's own has."""
    names = tuple(f"robot-{n:04}" for n in range(85))
    short = {"generation": 1, "issuer": "a", "id": "b", "targets": names}
    content = msgspec.msgpack.encode(short)
    assert len(content) <= MAX_GOAL
    with pytest.raises(CodecError, match="at most"):
        decode_goal(content)
