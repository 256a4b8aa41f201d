"""What the base classes do for a pattern."""

from __future__ import annotations

import numpy as np
import pytest

from swarmd.core.errors import PluginError
from swarmd.core.values import Inputs, Outputs, Twist
from swarmd.kit.behavior import Context, MovementPattern
from swarmd.kit.params import Params
from swarmd.settings.settings import load_platform
from swarmd.testing.scans import scan_of

PLATFORM = load_platform("burger")


def context() -> Context:
    return Context("robot-1", PLATFORM, np.random.default_rng(0))


class Straight(MovementPattern[Params]):
    """Drives."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(0.1)

    def report(self) -> dict[str, str]:
        return {"state": "straight"}


class Blind(Straight):
    """Needs no scan."""

    needs = frozenset[str]()


def test_movement_pattern_outputs_what_drive_returns() -> None:
    inputs = Inputs(now=0.0, dt=0.0, scan=scan_of(PLATFORM))
    assert Straight(Params(), context()).step(inputs) == Outputs(
        twist=Twist(0.1), report={"state": "straight"}
    )


def test_without_the_scan_it_needs_there_is_no_command() -> None:
    outputs = Straight(Params(), context()).step(Inputs(now=0.0, dt=0.0))
    assert outputs == Outputs(twist=None, report={"state": "straight"})


class Warm(Blind):
    """Needs a reading."""

    needs = frozenset({"reading:temperature"})


def test_without_the_reading_it_needs_there_is_no_command() -> None:
    cold = Inputs(now=0.0, dt=0.0, readings={"light": 1.0})
    warm = Inputs(now=0.0, dt=0.0, readings={"temperature": 20.0})
    outputs = [Warm(Params(), context()).step(inputs) for inputs in (cold, warm)]
    assert [one.twist for one in outputs] == [None, Twist(0.1)]


def test_without_a_scan_that_it_does_not_need_it_drives() -> None:
    assert Blind(Params(), context()).step(Inputs(now=0.0, dt=0.0)).twist == Twist(0.1)


def test_a_bare_context_makes_no_parts() -> None:
    with pytest.raises(PluginError, match="no pattern 'drive' here"):
        context().make("drive")
