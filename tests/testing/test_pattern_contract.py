"""The contract finds faults: each broken pattern fails the named test."""

from __future__ import annotations

import math
import random
import sys
import time
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.values import Inputs, Outputs, Twist
from swarmd.kit.behavior import MovementPattern, Pattern
from swarmd.kit.params import Params, about
from swarmd.sensing.rays import nearest
from swarmd.testing.pattern_contract import PatternContract

pytest_plugins = ["pytester"]


class Good(MovementPattern[Params]):
    """Turns towards the nearest thing."""

    is_symmetric = True

    def drive(self, inputs: Inputs) -> Twist:
        near = nearest(inputs.scan)
        return Twist(0.1, near.bearing / 4.0) if near else Twist()


class OneSided(Good):
    def drive(self, inputs: Inputs) -> Twist:
        near = nearest(inputs.scan)
        return Twist(0.1, abs(near.bearing) / 4.0) if near else Twist()


class FirstRay(Good):
    is_symmetric = False

    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        return Twist(float(0.01 * np.clip(inputs.scan.ranges[0], 0.0, 5.0)))


class NotANumber(Good):
    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        return Twist(float(np.mean(inputs.scan.ranges)) if len(inputs.scan.ranges) else 0.0)


class ExpectsARay(Good):
    is_symmetric = False

    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        return Twist(0.1 if inputs.scan.ranges[0] > 0.0 else 0.0)


class ExpectsKnown(Good):
    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        known = inputs.scan.ranges[~np.isnan(inputs.scan.ranges)]
        lacks_all = len(inputs.scan.ranges) > 0 and len(known) == 0
        return Twist(math.nan if lacks_all else 0.1)


class ExpectsRoom(Good):
    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        is_near = inputs.scan.ranges == -math.inf
        return Twist(-math.inf if len(is_near) and is_near.all() else 0.1)


class TurnsForEver(Good):
    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(twist=Twist(angular=math.inf))


class TooFast(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(9.0)


class NeedsAScan(Good):
    def step(self, inputs: Inputs) -> Outputs:
        if inputs.scan is None:
            raise ValueError("no scan")
        return Outputs()


class Writes(Good):
    def drive(self, inputs: Inputs) -> Twist:
        assert inputs.scan is not None
        inputs.scan.ranges[:] = 1.0
        return Twist()


class Gambles(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1 * random.random())


class Unseeded(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1 * float(np.random.default_rng().random()))


class SeedsTheShared(Good):
    def drive(self, inputs: Inputs) -> Twist:
        random.seed(0)
        return Twist(0.1 * random.random())


class ReadsTheClock(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.0 * time.monotonic())


class KnowsAClock(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.0 * perf_counter())


class Speaks(Good):
    def drive(self, inputs: Inputs) -> Twist:
        print("here")
        return Twist()


class WritesAloud(Good):
    def drive(self, inputs: Inputs) -> Twist:
        sys.stdout.write("here")
        return Twist()


class Sleeps(Good):
    def drive(self, inputs: Inputs) -> Twist:
        time.sleep(1e-4)
        return Twist()


class ReadsAPath(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.0 * len(Path(__file__).read_text()))


class Dawdles(Good):
    def drive(self, inputs: Inputs) -> Twist:
        begin = time.thread_time()
        while time.thread_time() < begin + 0.015:
            pass
        return Twist()


class NeverEnds(Good):
    def drive(self, inputs: Inputs) -> Twist:
        while True:
            pass


class SharesMemory(Good):
    steps: list[int] = []  # noqa: RUF012 - the mistake

    def drive(self, inputs: Inputs) -> Twist:
        self.steps.append(1)
        return Twist(1e-6 * len(self.steps))


class OpensAFile(Good):
    def drive(self, inputs: Inputs) -> Twist:
        with open(__file__) as file:
            return Twist(0.0 * len(file.readline()))


class SpeaksOutOfTurn(Good):
    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(messages={"undeclared": 1})


class SaysTooMuch(Good):
    channels = {"words": str}  # noqa: RUF012 - read only

    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(messages={"words": "a" * 5000})


class ReportsAList(Good):
    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(report={"seen": [1, 2]})  # type: ignore[dict-item]  # the mistake


class TrustsMessages(Good):
    channels = {"words": float}  # noqa: RUF012 - read only

    def step(self, inputs: Inputs) -> Outputs:
        said = [message.value for message in inputs.messages if message.channel == "words"]
        return Outputs(twist=Twist(sum(value for value in said if isinstance(value, float))))


class UndescribedParams(Params, frozen=True):
    speed: float = 0.1


class Undescribed(Good):
    params_type = UndescribedParams


class UnboundedParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0)] = 0.1


class Unbounded(Good):
    params_type = UnboundedParams


class BadDefaultParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0)] = 0.1


class BadDefault(Good):
    params_type = BadDefaultParams

    @classmethod
    def defaults(cls, platform: Any) -> dict[str, float]:
        return {"speed": 5.0}


class Hurried(Good):
    rate = 1000.0


class Forgets(Good):
    def update(self, params: Params) -> None:
        raise NotImplementedError("no update")


class Overflows(Good):
    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.01 * inputs.dt)


def run(kind: type[Pattern[Any]], test: str) -> None:
    contract: Any = type("Contract", (PatternContract,), {"pattern": kind})
    check: Callable[[Any], None] = getattr(contract(), test)
    check(contract.subject("burger"))


SAMPLE = """
from swarmd.api import MovementPattern, Params, Twist
from swarmd.testing import PatternContract


class Stand(MovementPattern[Params]):
    def drive(self, inputs):
        return Twist()


class TestStand(PatternContract):
    pattern = Stand
    platforms = ("burger", "jackal")
"""
TESTS = sorted(name for name in dir(PatternContract) if name.startswith("test_"))


@pytest.mark.parametrize("test", TESTS)
def test_a_good_pattern_passes(test: str) -> None:
    run(Good, test)


@pytest.mark.parametrize(
    ("kind", "test", "reason"),
    [
        (OneSided, "test_mirrored_scans_give_mirrored_commands", "mirrored scan"),
        (FirstRay, "test_the_order_of_rays_means_nothing", "reordered scan"),
        (NotANumber, "test_odd_scans_give_sane_commands", "command is"),
        (ExpectsARay, "test_odd_scans_give_sane_commands", "out of bounds"),
        (ExpectsKnown, "test_odd_scans_give_sane_commands", "all unknown"),
        (ExpectsRoom, "test_odd_scans_give_sane_commands", "all too near"),
        (TurnsForEver, "test_odd_scans_give_sane_commands", "no rays"),
        (TooFast, "test_odd_scans_give_sane_commands", "command is"),
        (NeedsAScan, "test_steps_give_outputs_and_nothing_else", "no scan"),
        (Writes, "test_inputs_are_left_alone", "read-only"),
        (Gambles, "test_steps_give_outputs_and_nothing_else", "random.random; chance"),
        (Unseeded, "test_steps_give_outputs_and_nothing_else", "unseeded"),
        (SeedsTheShared, "test_steps_give_outputs_and_nothing_else", "random.seed"),
        (ReadsTheClock, "test_steps_give_outputs_and_nothing_else", "may not call time.monotonic"),
        (KnowsAClock, "test_steps_give_outputs_and_nothing_else", "may not call time.perf_counter"),
        (Speaks, "test_steps_give_outputs_and_nothing_else", "may not call builtins.print"),
        (WritesAloud, "test_steps_give_outputs_and_nothing_else", "the console"),
        (Sleeps, "test_steps_give_outputs_and_nothing_else", "may not call time.sleep"),
        (ReadsAPath, "test_steps_give_outputs_and_nothing_else", "may not call io.open"),
        (Dawdles, "test_steps_take_little_time", "more than 10.0 ms"),
        (SharesMemory, "test_the_same_seed_gives_the_same_run", "differ"),
        (OpensAFile, "test_steps_give_outputs_and_nothing_else", "may not call builtins.open"),
        (SpeaksOutOfTurn, "test_steps_give_outputs_and_nothing_else", "not in channels"),
        (SaysTooMuch, "test_steps_give_outputs_and_nothing_else", "bytes; at most"),
        (ReportsAList, "test_reports_are_scalars", "report seen is a list"),
        (TrustsMessages, "test_odd_scans_give_sane_commands", "command is"),
        (Undescribed, "test_parameters_are_described", "no description"),
        (Unbounded, "test_parameters_are_described", "no bounds"),
        (BadDefault, "test_defaults_are_valid", "from derived"),
        (Hurried, "test_defaults_are_valid", "outside 1 to 50 Hz"),
        (Forgets, "test_parameters_can_be_set_while_it_runs", "no update"),
        (Overflows, "test_survives_a_jump_of_time", "command is"),
    ],
)
def test_a_broken_pattern_fails(kind: type[Pattern[Any]], test: str, reason: str) -> None:
    errors = (AssertionError, IndexError, NotImplementedError, ValueError, SwarmError)
    with pytest.raises(errors, match=reason):
        run(kind, test)


def test_a_pattern_that_never_ends_fails_in_time() -> None:
    contract: Any = type("Contract", (PatternContract,), {"pattern": NeverEnds, "seconds": 0.2})()
    contract.setup_method()
    try:
        with pytest.raises(TimeoutError, match=r"0\.2 s"):
            contract.test_odd_scans_give_sane_commands(contract.subject("burger"))
    finally:
        contract.teardown_method()


def test_pytest_runs_every_test_for_every_platform(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(SAMPLE)
    result = pytester.runpytest("-q", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=2 * len(TESTS))
