"""Discussed dispersion: phases, distances by opinion, and refused parameters."""

from __future__ import annotations

import math

import msgspec
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Message, Outputs, Value
from swarmd.patterns.discussed_dispersion.pattern import DiscussedDispersion
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

WAFFLE = load_platform("waffle_pi")


class TestDiscussedDispersion(PatternContract):
    pattern = DiscussedDispersion


class TestDispersingAtOnce(PatternContract):
    pattern = DiscussedDispersion
    params = {"discuss": 0.0, "law": "paper"}  # noqa: RUF012 - read only


def made(platform: str = "waffle_pi", **params: Value) -> DiscussedDispersion:
    pattern = Subject(DiscussedDispersion, load_platform(platform), params).make()
    assert isinstance(pattern, DiscussedDispersion)
    return pattern


def step(pattern: DiscussedDispersion, now: float, *votes: tuple[str, int]) -> Outputs:
    messages = tuple(Message(sender, "majority_rule/opinion", vote, 0.0) for sender, vote in votes)
    near = scan_of(WAFFLE, [Disc(-0.7, 0.1)])
    return pattern.step(Inputs(now, 0.1, scan=near, is_new_scan=True, messages=messages))


@pytest.mark.parametrize(
    ("platform", "distances"),
    [("waffle_pi", (0.6, 1.0, 1.4)), ("burger", (0.6, 1.0, 1.4)), ("jackal", (1.44, 2.4, 3.36))],
)
def test_opinions_mean_the_distances_of_the_paper(
    platform: str, distances: tuple[float, ...]
) -> None:
    for opinion, distance in enumerate(distances):
        pattern = made(platform, initial=opinion)
        report = step(pattern, 0.0).report
        assert report["opinion"] == opinion
        assert report["distance"] == pytest.approx(distance)
        assert pattern.parts["move"].params.distance == pytest.approx(distance)


def test_it_only_votes_for_the_time_to_discuss() -> None:
    pattern = made(initial=2)
    for now in (100.0, 110.0, 119.9):
        outputs = step(pattern, now)
        assert outputs.twist is None
        assert outputs.report["phase"] == "discuss"
    outputs = step(pattern, 120.0)
    assert outputs.report["phase"] == "disperse"
    assert outputs.twist is not None
    assert outputs.twist.linear > 0.1


def test_it_shares_its_opinion_with_majority_rule_in_both_phases() -> None:
    pattern = made(initial=1, discuss=3.0)
    sent = [step(pattern, 0.5 * i).messages.get("majority_rule/opinion") for i in range(20)]
    assert sent[0] == 1
    assert sent[:6].count(1) >= 2
    assert sent[7:].count(1) >= 5


def test_a_change_of_opinion_changes_the_distance() -> None:
    pattern = made(initial=2, discuss=0.0)
    assert step(pattern, 0.0, ("a", 0), ("b", 0)).report["distance"] == pytest.approx(1.4)
    for now in (2.5, 4.0, 5.5):
        outputs = step(pattern, now, ("a", 0), ("b", 0))
    assert outputs.report["opinion"] == 0
    assert outputs.report["distance"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("params", "opinion"),
    [({"base": 0.5}, 0), ({"base": 0.4}, 0), ({"base": 1.4, "step": -0.5}, 2), ({"step": 60.0}, 2)],
)
def test_a_distance_within_protection_or_above_100_m_is_refused(
    params: dict[str, Value], opinion: int
) -> None:
    with pytest.raises(ConfigError, match=f"opinion {opinion} "):
        made("waffle_pi", **params)


def test_a_refused_change_leaves_the_pattern_unchanged() -> None:
    pattern = made(initial=0)
    before = pattern.params
    with pytest.raises(ConfigError, match="opinion 0 "):
        pattern.update(msgspec.structs.replace(before, base=0.3))
    assert pattern.params is before
    pattern.update(msgspec.structs.replace(before, base=0.8, window=2.0, speed=0.1))
    assert step(pattern, 0.0).report["distance"] == pytest.approx(0.8)
    assert pattern.parts["vote"].params.window == 2.0
    assert math.isclose(pattern.parts["move"].params.speed, 0.1)


def test_an_initial_opinion_out_of_range_is_refused() -> None:
    with pytest.raises(ConfigError, match="initial"):
        made(initial=3)
