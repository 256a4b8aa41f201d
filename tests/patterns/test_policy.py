"""The learned policy: its contract, when it decides, and what it does on simple scans."""

from __future__ import annotations

import numpy as np
import pytest

from studies.learning import measure, random_actions, shipped
from swarmd.core.errors import ConfigError, MissingSensorError
from swarmd.core.values import Inputs, Twist, Value
from swarmd.kit.observation import PolicySpec, ReadingPart, ScanPart
from swarmd.kit.policy_network import network_of, parameter_count, to_text
from swarmd.kit.policy_pattern import PolicyPattern
from swarmd.patterns.policy.pattern import Policy
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of
from tests.support.examples import part

BURGER = load_platform("burger")


class TestPolicy(PatternContract):
    pattern = Policy


def learned(spec: PolicySpec) -> type[PolicyPattern]:
    """A pattern with a random network for this declaration."""
    numbers = np.random.default_rng(2).normal(size=parameter_count(spec))
    return type("Learned", (PolicyPattern,), {"network": to_text(network_of(spec, numbers))})


def step(pattern: PolicyPattern, now: float, distance: float) -> Twist:
    scan = scan_of(BURGER, [Disc(distance, 0.0)])
    twist = pattern.step(Inputs(now, 0.0, scan, is_new_scan=True)).twist
    assert twist is not None
    return twist


def test_decides_once_a_period_and_repeats_between() -> None:
    kind = learned(PolicySpec((ScanPart(sectors=4),), period=0.5))
    pattern = Subject(kind, BURGER, {}).make()
    assert isinstance(pattern, PolicyPattern)
    first = step(pattern, 10.0, 1.0)
    assert step(pattern, 10.3, 0.5) == first  # another scan
    assert step(pattern, 10.49, 0.5) != first  # a tick that is early


@pytest.mark.parametrize(
    ("params", "scale"), [({}, BURGER.limits.linear), ({"speed": 0.1, "turn": 0.5}, 0.1)]
)
def test_an_action_is_a_share_of_the_parameters(params: dict[str, Value], scale: float) -> None:
    pattern = Subject(Policy, BURGER, params).make()
    assert isinstance(pattern, PolicyPattern)
    twist = pattern.requested(np.array([1.0, -1.0]))
    assert twist == Twist(scale, -params.get("turn", BURGER.limits.angular))  # type: ignore[operator]


def test_a_robot_without_what_a_policy_observes_refuses_it() -> None:
    kind = learned(PolicySpec((ReadingPart("light"),)))
    assert kind.needs == {"reading:light"}
    with pytest.raises(MissingSensorError, match="reading:light"):
        Subject(kind, BURGER, {}).make()


def test_a_class_with_a_text_that_is_no_network_is_refused() -> None:
    with pytest.raises(ConfigError, match="policy"):
        type("Broken", (PolicyPattern,), {"network": "UEsD"})


@pytest.mark.long
@pytest.mark.parametrize("runs", part([3], [20]))
def test_beats_random_actions_on_seeds_of_no_training(runs: int) -> None:
    """Also the worst of its runs is better than the mean of random actions."""
    learned_runs = measure(shipped().act, range(runs))
    random_runs = measure(random_actions(), range(runs))
    assert learned_runs.returns.mean() > random_runs.returns.mean() + 0.2
    assert learned_runs.returns.min() > random_runs.returns.mean()
    assert learned_runs.contacts.sum() == 0.0
