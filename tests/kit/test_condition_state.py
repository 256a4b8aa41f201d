"""Runs of any pattern that end by a condition: idle, finished, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from swarmd.core.messages import Code, Reason, State
from swarmd.core.values import Inputs, Scalar, Twist
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, standing_state

WAFFLE = load_platform("waffle_pi")


class Counter(Forward):
    """Drives, and reports a word that changes twice."""

    count = 0

    def drive(self, inputs: Inputs) -> Twist:
        self.count += 1
        return Twist(0.05)

    def report(self) -> Mapping[str, Scalar]:
        return {"word": "abc"[min(self.count // 10, 2)]}


class Fragile(Counter):
    """Fails once."""

    def drive(self, inputs: Inputs) -> Twist:
        if inputs.now < 1001.2:
            raise RuntimeError("not yet")
        return super().drive(inputs)


def story_of(until: Any, pattern: str = "counter") -> RobotHarness:
    story = RobotHarness(patterns={**PATTERNS, "counter": Counter, "fragile": Fragile})
    story.advance(1.0)
    story.reply = story.ask("run", pattern=pattern, until=until)  # type: ignore[attr-defined]
    return story


def seconds_until_idle(story: RobotHarness) -> float:
    began = story.now
    while story.status.state is State.RUNNING and story.now < began + 30.0:
        story.advance(0.05)
    return story.now - began


def test_a_timeout_ends_the_run() -> None:
    story = story_of(["timeout:2"])
    assert seconds_until_idle(story) == pytest.approx(2.0, abs=0.2)
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)
    assert story.status.detail == "until 2 s have passed"
    assert story.twist.is_zero


def test_an_obstacle_ends_the_run() -> None:
    story = story_of(["nearer:0.5"])
    story.advance(2.0)
    assert story.status.state is State.RUNNING
    near = scan_of(WAFFLE, [Disc(-0.5, 0.0)])
    story.scans = lambda seq, now: replace(near, seq=seq, stamp=now)
    assert seconds_until_idle(story) < 1.0
    assert story.status.detail == "until something is nearer than 0.5 m"


def test_the_first_of_several_conditions_ends_the_run() -> None:
    story = story_of(["timeout:9", "report:word=c", "settled:word:8"])
    assert seconds_until_idle(story) < 3.0
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)
    assert story.status.detail == "until word is c"


def test_all_conditions_met_at_one_step_are_named() -> None:
    story = story_of(["timeout:2", "timeout:9", "timeout:1.999"])
    seconds_until_idle(story)
    assert story.status.detail == "until 2 s have passed and 1.999 s have passed"


def test_a_pattern_that_is_done_first_gives_the_reason() -> None:
    story = story_of(["done", "timeout:9"], "finisher")
    seconds_until_idle(story)
    assert story.status.detail == "arrived"


def test_conditions_survive_a_reload_of_a_failed_pattern() -> None:
    story = story_of(["timeout:2"], "fragile")
    assert seconds_until_idle(story) < 4.0
    assert standing_state(story) == (State.IDLE, Reason.FINISHED)


@pytest.mark.parametrize(
    ("until", "words"),
    [
        (["setled:opinion:5"], "'settled'"),
        (["nearer:-1"], "'-1'"),
        ("done", "'done'"),
        ([1], "until"),
    ],
)
def test_a_malformed_condition_refuses_the_run(until: Any, words: str) -> None:
    story = story_of(until)
    reply = story.reply  # type: ignore[attr-defined]
    assert reply.code is Code.REFUSED
    assert words in reply.text
    assert standing_state(story) == (State.IDLE, Reason.NEVER_ASKED)
