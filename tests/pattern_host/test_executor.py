"""Outputs of a step: what an executor takes, turns into plain types, or calls a fault."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from swarmd.core.host_messages import (
    Load,
    Loaded,
    PatternFailed,
    SentEvent,
    Step,
    Stepped,
)
from swarmd.core.values import Inputs, Message, Outputs, Twist
from swarmd.kit.behavior import Pattern
from swarmd.kit.params import Params
from swarmd.pattern_host.executor import PatternExecutor
from swarmd.pattern_host.wire import decode_command, encode_command
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_of


def step_giving(outputs: Any, channels: Mapping[str, type]) -> SentEvent | None:
    """The executor's answer to a step of a pattern that gives these outputs."""

    class Giver(Pattern[Params]):
        needs = frozenset[str]()

        def step(self, inputs: Inputs) -> Outputs:
            return outputs  # type: ignore[no-any-return]

    Giver.channels = channels
    executor = PatternExecutor(lambda name: Giver)
    loaded = executor.handle(Load(1, "giver", (), "r1", load_platform("burger"), 1))
    assert isinstance(loaded, Loaded)
    return executor.handle(Step(1, Inputs(now=0.0, dt=0.0)))


@pytest.mark.parametrize(
    ("kind", "value", "sent"),
    [
        (float, 1, 1.0),
        (float, np.float32(0.5), 0.5),
        (int, np.int64(3), 3),
        (bool, np.bool_(True), True),
        (list, (1, 2), [1, 2]),
    ],
)
def test_messages_are_sent_as_the_type_of_their_channel(
    kind: type, value: Any, sent: object
) -> None:
    answer = step_giving(Outputs(messages={"word": value}), {"word": kind})
    assert isinstance(answer, Stepped)
    assert answer.outputs.messages == {"word": sent}
    assert type(answer.outputs.messages["word"]) is type(sent)


@pytest.mark.parametrize(
    ("kind", "value"),
    [(float, "0.5"), (int, 0.5), (int, True), (str, b"x"), (dict, [1]), (float, None)],
)
def test_a_message_of_another_type_than_its_channel_is_a_fault(kind: type, value: Any) -> None:
    answer = step_giving(Outputs(messages={"word": value}), {"word": kind})
    assert isinstance(answer, PatternFailed)
    assert "'word'" in answer.text
    assert kind.__name__ in answer.text


@pytest.mark.parametrize(("kind", "value"), [(list, [1, 2]), (int, 3), (float, 4)])
def test_a_pattern_gets_messages_of_its_own_in_the_type_of_their_channel(
    kind: type, value: Any
) -> None:
    heard: list[Any] = []

    class Hearer(Pattern[Params]):
        needs = frozenset[str]()
        channels: Mapping[str, type] = {"word": kind}

        def step(self, inputs: Inputs) -> Outputs:
            heard.extend(message.value for message in inputs.messages)
            return Outputs()

    executor = PatternExecutor(lambda name: Hearer)
    executor.handle(Load(1, "hearer", (), "r1", load_platform("burger"), 1))
    words = tuple(Message("r2", "word", said, 0.0) for said in (value, "another"))
    answer = executor.handle(Step(1, Inputs(now=0.0, dt=0.0, messages=words)))
    assert isinstance(answer, Stepped)
    assert (heard, answer.dropped) == ([value], 1)
    assert type(heard[0]) is kind
    if kind is list:
        assert heard[0] is not value


def test_a_scan_is_one_object_in_all_its_steps() -> None:
    seen: list[Any] = []

    class Looker(Pattern[Params]):
        def step(self, inputs: Inputs) -> Outputs:
            seen.append(inputs.scan)
            return Outputs()

    platform = load_platform("burger")
    executor = PatternExecutor(lambda name: Looker)
    executor.handle(Load(1, "looker", (), "r1", platform, 1))
    for seq, is_new in ((1, True), (1, False), (2, True), (1, True), (2, False), (2, True)):
        scan = scan_of(platform, seq=seq)
        frame = encode_command(Step(1, Inputs(0.0, 0.0, scan, is_new_scan=is_new)))
        executor.handle(decode_command(frame))
    assert [seen.index(one) for one in seen] == [0, 0, 2, 3, 4, 5]


def test_scans_of_a_robot_share_what_derives_from_them_and_those_of_another_do_not() -> None:
    lent: list[Any] = []

    class Seer(Pattern[Params]):
        needs = frozenset[str]()

        def step(self, inputs: Inputs) -> Outputs:
            for scan in (inputs.scan, inputs.ranges):
                assert scan is not None
                lent.append(scan.__dict__["layouts"])
            return Outputs()

    for robot in ("r1", "r2"):
        executor = PatternExecutor(lambda name: Seer)
        executor.handle(Load(1, "seer", (), robot, load_platform("burger"), 1))
        for seq in (1, 2):
            scans = [scan_of(load_platform("burger"), [], seq=seq) for _ in range(2)]
            step = Step(1, Inputs(0.1 * seq, 0.1, scans[0], True, ranges=scans[1]))
            assert isinstance(executor.handle(step), Stepped)
    assert lent == [lent[0]] * 4 + [lent[4]] * 4
    assert lent[0] is not lent[4]


@pytest.mark.parametrize("outputs", [None, Twist(0.1), Outputs(twist=(0.1, 0.0))])  # type: ignore[arg-type]  # the mistake
def test_a_step_that_gives_anything_but_outputs_is_a_fault(outputs: object) -> None:
    answer = step_giving(outputs, {})
    assert isinstance(answer, PatternFailed)
    assert "expected" in answer.text


def test_commands_and_reports_are_made_plain() -> None:
    given = Outputs(Twist(np.float64(0.1), 1), report={"a": np.int64(1), "b": [1]})  # type: ignore[dict-item]  # the mistake
    answer = step_giving(given, {})
    assert isinstance(answer, Stepped)
    assert answer.outputs == Outputs(Twist(0.1, 1.0), report={"a": 1})
