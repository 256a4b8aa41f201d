"""What a stop of an operator does with the answers, without a network."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import pytest
from msgspec import msgpack

from swarmd.core.codec import Decoder
from swarmd.core.errors import RequestError
from swarmd.core.messages import Code, Reply
from swarmd.operator.session.members_view import MembersView
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.session.session import Session
from swarmd.operator.session.targets import Targets
from swarmd.operator.verbs.stop.ask import send_stop

APPLIED = {"a": Reply(id="s", robot="a", code=Code.APPLIED)}


class Signing:
    """An operator whose stops get these outcomes; a roster that it looks up may change its keys."""

    def __init__(self, *outcomes: Outcome, roster: tuple[str, ...], has_newer: bool) -> None:
        self.outcomes, self.sent, self.looked_up = [*outcomes], 0, 0
        self.identity, self._has_newer = object(), has_newer
        self.notices = list[str]()
        self.view = MembersView({}, roster=frozenset(roster))

    def send_stop(self, verb: str, **_: Any) -> Outcome:
        self.sent += 1
        return self.outcomes.pop(0)

    def update_roster(self) -> None:
        self.looked_up += 1
        if self._has_newer:
            self.identity = object()

    def seen(self) -> MembersView:
        return self.view


@pytest.mark.parametrize("has_newer", [False, True])
@pytest.mark.parametrize(
    ("first", "looks_up"),
    [
        (Outcome(APPLIED), False),
        (Outcome(APPLIED, missing=("b",)), True),  # b may have newer keys
        (Outcome({}, missing=("a", "b"), reached=1), True),
        (Outcome({}), True),  # each robot that was not heard may have newer keys
    ],
)
def test_a_stop_that_a_robot_did_not_take_is_sent_again_with_newer_keys(
    first: Outcome, looks_up: bool, has_newer: bool
) -> None:
    """Operators take a newer roster at their next verb (docs/security.md)."""
    operator: Any = Signing(first, Outcome(APPLIED), roster=("a", "b"), has_newer=has_newer)
    is_again = looks_up and has_newer
    with suppress(RequestError):  # no robot is targeted
        outcome = send_stop(Session(operator), "stop", Targets())
        assert outcome.replies == (APPLIED if is_again else first.replies)
    assert (operator.looked_up, operator.sent) == (looks_up, 1 + is_again)


def test_an_answer_without_is_moving_is_of_a_base_at_rest() -> None:
    """An answer *with* `is_moving` says that the base does not rest yet (docs/zenoh.md)."""
    decode = Decoder(Reply)
    fields = {"id": "s", "robot": "a", "code": "applied"}
    assert decode(b"\x01" + msgpack.encode(fields)).is_moving is False
    assert decode(b"\x01" + msgpack.encode({**fields, "is_moving": True})).is_moving is True
