"""Random walk: straight, turn, straight ..., and away from what is ahead."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Inputs, Scan, Twist, Value
from swarmd.patterns.random_walk.pattern import RandomWalk
from swarmd.settings.settings import load_platform
from swarmd.testing.pattern_contract import PatternContract, Subject
from swarmd.testing.scans import Disc, scan_of

PLATFORM = load_platform("waffle_pi")
FREE = scan_of(PLATFORM)


class TestRandomWalk(PatternContract):
    pattern = RandomWalk


class TestRandomWalkOfThePaper(PatternContract):
    pattern = RandomWalk
    params = {"law": "paper"}  # noqa: RUF012 - read only


def walk(
    see: Callable[[float], Scan], seconds: float, *, seed: int = 0, **params: Value
) -> list[Twist]:
    """The requested commands at 10 Hz."""
    pattern = Subject(RandomWalk, PLATFORM, params).make(seed)
    twists = []
    for now in np.arange(0.0, seconds, 0.1).tolist():
        twist = pattern.step(Inputs(now=now, dt=0.1, scan=see(now))).twist
        assert twist is not None
        twists.append(twist)
    return twists


def straights(twists: Sequence[Twist]) -> list[float]:
    """The durations in s of the straights that were walked to their end."""
    is_straight = np.array([twist.linear > 0.0 for twist in twists])
    edges = np.flatnonzero(np.diff(is_straight.astype(int)))
    lengths = np.diff(edges)
    return [
        0.1 * n for n, edge in zip(lengths.tolist(), edges, strict=False) if not is_straight[edge]
    ]


def test_straights_last_within_the_bounds_of_the_parameters() -> None:
    lengths = straights(walk(lambda now: FREE, 300.0, straight_min=2.0, straight_max=4.0))
    assert len(lengths) > 20
    assert all(1.9 <= length <= 4.1 for length in lengths)
    assert max(lengths) - min(lengths) > 1.0


def test_turns_in_place_both_ways_at_a_fifth_to_four_fifths_of_the_turn_rate() -> None:
    twists = walk(lambda now: FREE, 600.0, straight_min=0.1, straight_max=0.1, turn=1.0)
    rates = np.array([twist.angular for twist in twists if twist.linear == 0.0])
    assert set(np.sign(rates)) == {-1.0, 1.0}
    assert np.abs(rates).min() >= 0.2
    assert np.abs(rates).max() <= 0.8


def test_turns_last_up_to_the_turn_time() -> None:
    twists = walk(lambda now: FREE, 600.0, straight_min=0.1, straight_max=0.1, turn_time=3.0)
    is_turn = np.array([twist.linear == 0.0 for twist in twists]).astype(int)
    edges = np.flatnonzero(np.diff(is_turn, prepend=0, append=0))
    lengths = 0.1 * (edges[1::2] - edges[::2])
    assert 2.5 < lengths.max() <= 3.1
    assert lengths.min() < 0.5


@pytest.mark.parametrize(("side", "turn"), [(0.2, -1.0), (-0.2, 1.0)])
def test_turns_away_from_an_obstacle_ahead(side: float, turn: float) -> None:
    ahead = scan_of(PLATFORM, [Disc(0.7, side)])
    twists = walk(lambda now: FREE if now < 1.0 else ahead, 2.0)
    assert twists[9].linear > 0.0
    assert all(t.linear == 0.0 and np.sign(t.angular) == turn for t in twists[10:])


def test_turns_until_the_way_is_free() -> None:
    ahead = scan_of(PLATFORM, [Disc(0.7, 0.1)])
    twists = walk(lambda now: ahead if 1.0 <= now < 30.0 else FREE, 40.0)
    assert all(twist.linear == 0.0 for twist in twists[10:300])
    assert twists[-1].linear > 0.0


def test_an_obstacle_aside_does_not_stop_it() -> None:
    aside = scan_of(PLATFORM, [Disc(0.0, 0.7), Disc(-0.5, -0.5)])
    assert all(twist.linear > 0.0 for twist in walk(lambda now: aside, 9.0)[1:])


def test_without_clearance_it_ignores_obstacles() -> None:
    ahead = scan_of(PLATFORM, [Disc(0.5, 0.0)])
    assert all(twist.linear > 0.0 for twist in walk(lambda now: ahead, 9.0, clearance=0.0))


def test_a_shortest_straight_longer_than_the_longest_is_refused() -> None:
    with pytest.raises(ConfigError, match="straight_min"):
        walk(lambda now: FREE, 1.0, straight_min=20.0)


def test_starts_with_a_turn_if_an_obstacle_is_ahead() -> None:
    blocked = scan_of(PLATFORM, [Disc(0.6, 0.1)])
    twists = walk(lambda now: blocked if now < 2.0 else FREE, 8.0)
    assert twists[0].linear == 0.0
    assert abs(twists[0].angular) > 0.0
    assert any(twist.linear > 0.0 for twist in twists[20:])


def test_the_law_of_the_paper_waits_and_ignores_obstacles() -> None:
    ahead = scan_of(PLATFORM, [Disc(0.5, 0.0)])
    twists = walk(lambda now: ahead, 14.9, law="paper")
    assert all(twist == Twist() for twist in twists[:50])
    assert all(twist == Twist(linear=0.26) for twist in twists[50:])
