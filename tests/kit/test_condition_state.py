"""Conditions that end a run: evaluated at each step, and kept over a restart of the pattern."""

from __future__ import annotations

from swarmd.core.messages import Reason, State
from swarmd.core.values import Inputs, Outputs, Scalar, Twist
from swarmd.kit.condition_state import UntilConditions
from swarmd.kit.conditions import parse_conditions
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import Disc, scan_of
from tests.support.robot_harness import RobotHarness
from tests.support.stub_patterns import PATTERNS, Forward, standing_state

BURGER = load_platform("burger")


class Fragile(Forward):
    """Fails once."""

    def drive(self, inputs: Inputs) -> Twist:
        if inputs.now < 1001.2:
            raise RuntimeError("not yet")
        return Twist(0.05)


def ends(
    *until: str, seconds: float = 5.0, done: str | None = None, **report: Scalar
) -> tuple[float, str | None]:
    """When and why a pattern with this report ends; a disc is near from 2 s on."""
    conditions = UntilConditions(parse_conditions(until))
    for tick in range(round(10 * seconds) + 1):
        now = 0.1 * tick
        scan = scan_of(BURGER, [Disc(-0.5, 0.0)] if tick >= 20 else [])
        outputs = Outputs(twist=Twist(0.05), report=report, done=done if tick >= 20 else None)
        after = conditions.apply(Inputs(1000.0 + now, 0.1, scan), outputs)
        if after.done is not None:
            assert after.twist == Twist(0.05)
            return round(now, 6), after.done
    return seconds, None


def test_a_condition_ends_the_run_and_is_named() -> None:
    assert ends("timeout:2") == (2.0, "until 2 s have passed")
    assert ends("nearer:0.6") == (2.0, "until something is nearer than 0.6 m")
    assert ends("settled:word:3", word="a") == (3.0, "until word settled for 3 s")
    assert ends("report:word=b", word="a") == (5.0, None)


def test_the_first_of_several_conditions_ends_the_run() -> None:
    assert ends("timeout:9", "report:word=c", word="c") == (0.0, "until word is c")


def test_all_conditions_met_at_one_step_are_named() -> None:
    found = ends("timeout:2", "timeout:9", "timeout:1.999")
    assert found == (2.0, "until 2 s have passed and 1.999 s have passed")


def test_a_pattern_that_is_done_first_gives_the_reason() -> None:
    assert ends("done", "timeout:9", done="arrived") == (2.0, "arrived")


def test_conditions_survive_a_restart_of_a_failed_pattern() -> None:
    harness = RobotHarness(patterns={**PATTERNS, "fragile": Fragile})
    harness.advance(1.0)
    harness.ask("run", pattern="fragile", until=["timeout:2"])
    harness.advance(1.0)
    assert harness.status.state is State.RUNNING
    harness.advance(3.0)
    assert standing_state(harness) == (State.IDLE, Reason.FINISHED)
    assert harness.status.detail == "until 2 s have passed"
    assert harness.twist.is_zero
