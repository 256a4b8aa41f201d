"""The limits on what a robot's pattern says."""

from __future__ import annotations

import pytest

from swarmd.core.codec import MAX_MESSAGE, encode_value
from swarmd.core.message_limits import (
    BYTE_BURST,
    BYTE_RATE,
    CHANNEL_BURST,
    CHANNEL_RATE,
    SENDER_BURST,
    SENDER_RATE,
)
from swarmd.core.values import Value
from swarmd.robot.message_limits import Outbox

SECONDS = 20.0


def passed(channels: int, value: Value, rate: float = 100.0) -> tuple[float, float, Outbox]:
    """Messages and bytes per second that pass, if each channel has a value at `rate` Hz."""
    outbox, names = Outbox(), frozenset(f"c{n}" for n in range(channels))
    count = size = 0
    for step in range(round(SECONDS * rate)):
        messages = outbox.take(dict.fromkeys(names, value), names, 1e4 + step / rate)
        count += len(messages)
        size += sum(len(encode_value(one)) for one in messages.values())
    return count / SECONDS, size / SECONDS, outbox


def test_undeclared_channels_are_dropped_and_counted() -> None:
    outbox = Outbox()
    assert outbox.take({"a": 1, "b": 2}, frozenset({"a"}), 1.0) == {"a": 1}
    assert outbox.dropped == 1


def test_each_channel_has_its_rate() -> None:
    count, _, outbox = passed(1, 7)
    assert count == pytest.approx(CHANNEL_RATE, abs=CHANNEL_BURST / SECONDS + 0.1)
    assert outbox.dropped == round((100.0 - count) * SECONDS)


def test_many_channels_share_the_messages_of_one_robot() -> None:
    count, _, _ = passed(60, 7)
    assert count == pytest.approx(SENDER_RATE, abs=SENDER_BURST / SECONDS + 0.1)


def test_large_messages_share_the_bytes_of_one_robot() -> None:
    _, size, _ = passed(60, "x" * 900)
    assert size == pytest.approx(BYTE_RATE, abs=BYTE_BURST / SECONDS + MAX_MESSAGE)


@pytest.mark.parametrize(("channels", "rate"), [(2, 2.0), (4, 10.0), (5, 20.0)])
def test_voting_and_chat_stay_within_the_limits(channels: int, rate: float) -> None:
    assert passed(channels, [12, "r01", 3, "x" * 60], rate)[2].dropped == 0


def test_a_value_that_cannot_be_encoded_is_left_to_the_shell() -> None:
    assert Outbox().take({"a": object()}, frozenset({"a"}), 1.0)  # type: ignore[dict-item]
