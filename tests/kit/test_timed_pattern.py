"""States that end after a time."""

from __future__ import annotations

import numpy as np

from swarmd.core.values import ZERO, Inputs, Twist
from swarmd.kit.behavior import Context
from swarmd.kit.params import Params
from swarmd.kit.timed_pattern import TimedPattern
from swarmd.settings.settings import load_platform


class Pausing(TimedPattern[Params]):
    """Pauses 2 s and turns 1 s, once."""

    needs = frozenset[str]()

    def drive(self, inputs: Inputs) -> Twist:
        if self.state(inputs.now) == "drive" and inputs.now < 1.0:
            self.begin(inputs.now, pause=2.0, turn=1.0)
        return ZERO


def states(*times: float) -> list[object]:
    pattern = Pausing(Params(), Context("r", load_platform("burger"), np.random.default_rng(0)))
    return [pattern.step(Inputs(now=now, dt=0.0)).report["state"] for now in times]


def test_timed_states_follow_one_another_and_end_in_the_default() -> None:
    assert states(0.0, 1.9, 2.0, 2.9, 3.0, 9.0) == [
        *("pause", "pause"),
        *("turn", "turn"),
        *("drive", "drive"),
    ]


def test_a_later_begin_replaces_what_is_left() -> None:
    pattern = Pausing(Params(), Context("r", load_platform("burger"), np.random.default_rng(0)))
    pattern.begin(0.0, pause=5.0)
    pattern.begin(1.0, turn=0.0, rest=2.0)
    assert [pattern.state(now) for now in (1.0, 2.9, 3.0)] == ["rest", "rest", "drive"]


def test_before_the_first_step_it_is_in_the_default_state() -> None:
    pattern = Pausing(Params(), Context("r", load_platform("burger"), np.random.default_rng(0)))
    assert pattern.report() == {"state": "drive"}
