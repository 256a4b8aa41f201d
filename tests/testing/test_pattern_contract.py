"""The contract finds faults: each broken pattern fails the named test."""

from __future__ import annotations

import math
import random
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.core.values import Array, Inputs, Outputs, Twist
from swarmd.kit.behavior import MovementPattern, Pattern
from swarmd.kit.params import Params, about
from swarmd.robot.sensing.rays import nearest
from swarmd.testing.no_side_effects import no_side_effects
from swarmd.testing.pattern_contract import PatternContract

Kind: TypeAlias = type[Pattern[Any]]

pytest_plugins = ["pytester"]


class Good(MovementPattern[Params]):
    """Turns towards the nearest thing."""

    is_symmetric = True

    def drive(self, inputs: Inputs) -> Twist:
        near = nearest(inputs.scan)
        return Twist(0.1, near.bearing / 4.0) if near else Twist()


class Writes(Good):
    def drive(self, inputs: Inputs) -> Twist:
        ranges(inputs)[:] = 1.0
        return Twist()


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


class Forgets(Good):
    def update(self, params: Params) -> None:
        raise NotImplementedError("no update")


def ranges(inputs: Inputs) -> Array:
    assert inputs.scan is not None, "no scan"
    return inputs.scan.ranges


def is_all(rays: Any) -> bool:
    return len(rays) > 0 and bool(rays.all())


def heard(inputs: Inputs) -> list[Any]:
    return [message.value for message in inputs.messages if message.channel == "words"]


def bearing(inputs: Inputs) -> float:
    near = nearest(inputs.scan)
    return 0.0 if near is None else near.bearing


def broken(**members: object) -> Kind:
    """The good pattern with other members."""
    return type("Broken", (Good,), {**members, "__module__": __name__})


def driving(drive: Callable[[Inputs], Twist], **members: object) -> Kind:
    return broken(drive=lambda self, inputs: drive(inputs), **members)


def giving(step: Callable[[Inputs], Any], **members: object) -> Kind:
    return broken(step=lambda self, inputs: step(inputs), **members)


def with_speed(kind: Any, **members: object) -> Kind:
    fields = [("speed", kind, 0.1)]
    params = msgspec.defstruct("SpeedParams", fields, bases=(Params,), frozen=True, kw_only=True)
    return broken(params_type=params, **members)


SYMMETRY = "test_mirrored_scans_give_mirrored_commands"
ODD = "test_odd_scans_give_sane_commands"
STEPS = "test_steps_give_outputs_and_nothing_else"
BROKEN: Mapping[str, tuple[Kind, str, str]] = {
    "one_sided": (driving(lambda i: Twist(0.1, abs(bearing(i)))), SYMMETRY, "mirrored scan"),
    "first_ray": (
        driving(lambda i: Twist(0.01 * min(ranges(i)[0], 5.0)), is_symmetric=False),
        "test_the_order_of_rays_means_nothing",
        "reordered scan",
    ),
    "mean": (driving(lambda i: Twist(float(sum(ranges(i))))), ODD, "command is"),
    "expects_a_ray": (driving(lambda i: Twist(0.0 * ranges(i)[0])), ODD, "out of bounds"),
    "expects_known": (
        driving(lambda i: Twist(math.nan if is_all(np.isnan(ranges(i))) else 0.1)),
        ODD,
        "all unknown",
    ),
    "expects_room": (
        driving(lambda i: Twist(-math.inf if is_all(ranges(i) == -math.inf) else 0.1)),
        ODD,
        "all too near",
    ),
    "infinite": (giving(lambda i: Outputs(Twist(angular=math.inf))), ODD, "no rays"),
    "too_fast": (driving(lambda i: Twist(9.0)), ODD, "command is"),
    "needs_a_scan": (giving(lambda i: Outputs(report={"rays": len(ranges(i))})), STEPS, "scan"),
    "writes": (Writes, "test_inputs_are_left_alone", "read-only"),
    "dawdles": (Dawdles, "test_steps_take_little_time", "more than 10.0 ms"),
    "shares_memory": (SharesMemory, "test_the_same_seed_gives_the_same_run", "differ"),
    "undeclared": (giving(lambda i: Outputs(messages={"undeclared": 1})), STEPS, "channels"),
    "too_long": (
        giving(lambda i: Outputs(messages={"words": "a" * 5000}), channels={"words": str}),
        STEPS,
        "bytes; at most",
    ),
    "reports_a_list": (
        giving(lambda i: Outputs(report={"seen": [1, 2]})),  # type: ignore[dict-item]  # the mistake
        STEPS,
        "report seen is a list",
    ),
    "trusts_messages": (
        giving(lambda i: Outputs(Twist(sum(heard(i)))), channels={"words": float}),
        ODD,
        "command is",
    ),
    "undescribed": (with_speed(float), "test_parameters_are_described", "no description"),
    "unbounded": (
        with_speed(Annotated[float, about("how fast", ge=0.0)]),
        "test_parameters_are_described",
        "no bounds",
    ),
    "bad_default": (
        with_speed(
            Annotated[float, about("how fast", ge=0.0, le=1.0)],
            defaults=classmethod(lambda cls, platform: {"speed": 5.0}),
        ),
        "test_defaults_are_valid",
        "from derived",
    ),
    "hurried": (broken(rate=1000.0), "test_defaults_are_valid", "outside 1 to 50 Hz"),
    "forgets": (Forgets, "test_parameters_can_be_set_while_it_runs", "no update"),
    "overflows": (
        driving(lambda i: Twist(0.01 * i.dt)),
        "test_survives_a_jump_of_time",
        "command is",
    ),
}
FORBIDDEN: Mapping[str, Callable[[], object]] = {
    "random.random": lambda: random.random(),
    "default_rng unseeded": lambda: np.random.default_rng(),
    "random.seed": lambda: random.seed(0),
    "time.monotonic": lambda: time.monotonic(),
    "time.perf_counter": lambda: perf_counter(),
    "builtins.print": lambda: print("here"),
    "the console": lambda: sys.stdout.write("here"),
    "time.sleep": lambda: time.sleep(1e-4),
    "io.open": lambda: Path(__file__).read_text(),
    "builtins.open": lambda: open(__file__),  # noqa: SIM115 - it must not come so far
}


def run(kind: Kind, test: str) -> None:
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


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_pattern_fails(name: str) -> None:
    kind, test, reason = BROKEN[name]
    errors = (AssertionError, IndexError, NotImplementedError, ValueError, SwarmError)
    with pytest.raises(errors, match=reason):
        run(kind, test)


@pytest.mark.parametrize("name", FORBIDDEN)
def test_a_step_with_a_side_effect_fails(name: str) -> None:
    def drive(inputs: Inputs) -> Twist:
        FORBIDDEN[name]()
        return Twist()

    with pytest.raises(AssertionError, match=name):
        run(driving(drive), STEPS)


def test_other_threads_may_call_what_a_step_may_not() -> None:
    with ThreadPoolExecutor(1) as thread:
        thread.submit(int).result()  # it has started
        with no_side_effects(__name__):
            now = thread.submit(lambda: time.monotonic())
            with pytest.raises(AssertionError, match=r"time\.monotonic"):
                time.monotonic()
            assert now.result() > 0.0


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
