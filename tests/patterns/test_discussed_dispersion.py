"""Discussed dispersion: phases, what an opinion stands for, and what is refused."""

from __future__ import annotations

import math

import msgspec
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Message, Outputs, Value
from swarmd.patterns.discussed_dispersion import DiscussedDispersion
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
    messages = tuple(Message(who, "majority_rule/opinion", vote, 0.0) for who, vote in votes)
    near = scan_of(WAFFLE, [Disc(-0.7, 0.1)])
    return pattern.step(Inputs(now, 0.1, scan=near, is_new_scan=True, messages=messages))


@pytest.mark.parametrize(
    ("platform", "distances"),
    [("waffle_pi", (0.6, 1.0, 1.4)), ("burger", (0.6, 1.0, 1.4)), ("jackal", (1.44, 2.4, 3.36))],
)
def test_an_opinion_stands_for_the_papers_distance(
    platform: str, distances: tuple[float, ...]
) -> None:
    for opinion, distance in enumerate(distances):
        pattern = made(platform, initial=opinion)
        report = step(pattern, 0.0).report
        assert report["opinion"] == opinion
        assert report["distance"] == pytest.approx(distance)
        assert pattern.parts["move"].params.distance == pytest.approx(distance)


def test_it_stands_and_votes_until_there_was_time_to_discuss() -> None:
    pattern = made(initial=2)
    for now in (100.0, 110.0, 119.9):
        outputs = step(pattern, now)
        assert outputs.twist is None
        assert outputs.report["phase"] == "discuss"
    outputs = step(pattern, 120.0)
    assert outputs.report["phase"] == "disperse"
    assert outputs.twist is not None
    assert outputs.twist.linear > 0.1


def test_it_shares_its_opinion_in_both_phases_with_all_who_vote_so() -> None:
    pattern = made(initial=1, discuss=3.0)
    said = [step(pattern, 0.5 * i).messages.get("majority_rule/opinion") for i in range(20)]
    assert said[0] == 1
    assert said[:6].count(1) >= 2
    assert said[7:].count(1) >= 5


def test_it_keeps_the_distance_of_what_it_is_persuaded_of() -> None:
    pattern = made(initial=2, discuss=0.0)
    assert step(pattern, 0.0, ("a", 0), ("b", 0)).report["distance"] == pytest.approx(1.4)
    for now in (2.5, 4.0, 5.5):
        outputs = step(pattern, now, ("a", 0), ("b", 0))
    assert outputs.report["opinion"] == 0
    assert outputs.report["distance"] == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"base": 0.5}, "opinion 0 stands for 0.5 m; wanted is more than 0.5 m"),
        ({"base": 0.4}, "opinion 0 stands for 0.4 m; wanted is more than 0.5 m"),
        ({"base": 1.4, "step": -0.5}, "opinion 2 stands for 0.4 m"),
        ({"step": 60.0}, "opinion 2 stands for 120.6 m"),
    ],
)
def test_a_distance_that_protection_keeps_anyway_is_refused_when_it_is_made(
    params: dict[str, Value], words: str
) -> None:
    with pytest.raises(ConfigError, match=words.replace(".", r"\.")):
        made("waffle_pi", **params)


def test_and_while_it_runs_and_all_stays_as_it_was() -> None:
    pattern = made(initial=0)
    before = pattern.params
    with pytest.raises(ConfigError, match=r"opinion 0 stands for 0\.3 m"):
        pattern.update(msgspec.structs.replace(before, base=0.3))
    assert pattern.params is before
    pattern.update(msgspec.structs.replace(before, base=0.8, window=2.0, speed=0.1))
    assert step(pattern, 0.0).report["distance"] == pytest.approx(0.8)
    assert pattern.parts["vote"].params.window == 2.0
    assert math.isclose(pattern.parts["move"].params.speed, 0.1)


def test_an_opinion_that_is_not_there_cannot_be_the_first() -> None:
    with pytest.raises(ConfigError, match="initial is 3, opinions end at 2"):
        made(initial=3)
