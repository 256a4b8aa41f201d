"""Bounds of the relay of stops: what a stranger can make a robot send, or keep it from sending."""

from __future__ import annotations

import pytest

from swarmd.core.messages import Code
from swarmd.network.datagram import Ack, Stop
from swarmd.network.stop_relay import ACK_PERIOD, ACKS_AT_ONCE, MAX_ACKS, StopRelay

OPERATOR, PEER, STRANGER = ("10.0.0.9", 1), ("10.0.0.2", 7440), ("10.0.0.66", 1)


def stop(**changes: object) -> Stop:
    fields = {"id": "s", "verb": "stop", "operator": "anna", "targets": ("r2",)} | changes
    return Stop(**fields)  # type: ignore[arg-type]


def ack(robot: str) -> Ack:
    return Ack(id="s", robot=robot, instance=b"abcdef", revision=1, code=Code.APPLIED)


def copies(relay: StopRelay, seconds: float, began: float = 0.0) -> list[Stop]:
    found: list[Stop] = []
    for tick in range(1, round(seconds / 0.05) + 1):
        found += relay.advance(began + tick * 0.05)
    return found


def test_a_repeat_returns_few_acks_of_others_and_in_the_end_all() -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(targets=None), OPERATOR, 0.0)
    for number in range(2 * MAX_ACKS):
        relay.on_ack(ack(f"x{number}"), PEER, 0.0)
    handed: set[str] = set()
    for repeat in range(1, 40):
        sends = relay.on_stop(stop(targets=None), OPERATOR, repeat * 0.1)
        assert len(sends) <= ACKS_AT_ONCE
        handed |= {body.robot for body, _ in sends if isinstance(body, Ack)}
    assert len(handed) == MAX_ACKS
    assert relay.on_stop(stop(targets=None), OPERATOR, 3.9 + ACK_PERIOD / 2) == []


@pytest.mark.parametrize("attack", ["ack", "age", "copies"])
def test_a_stranger_does_not_keep_a_robot_from_handing_a_stop_on(attack: str) -> None:
    relay = StopRelay("r1", seed=1)
    relay.on_stop(stop(), OPERATOR, 0.0)
    for _ in range(5):
        if attack == "ack":
            relay.on_ack(ack("r2"), STRANGER, 0.0)
        elif attack == "age":
            relay.on_stop(stop(age=2**40), STRANGER, 0.0)
        else:
            relay.on_stop(stop(hops=1), STRANGER, 0.0, is_member=False)
    sent = copies(relay, 2.0)
    assert len(sent) >= 2
    assert max(one.age for one in sent) <= 4500
