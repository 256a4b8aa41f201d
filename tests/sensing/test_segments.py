"""Segments of a turn: which are taken, how old their rays are, and which are ignored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from swarmd.core.values import Array, Scan, Sweep
from swarmd.sensing.segments import ScanSegment, SegmentCheck
from swarmd.settings.platforms import load_platform

SPEC = replace(load_platform("burger").scan, segments=8)
TURN = 0.2  # s
DELAY = 0.01  # s, of the newest ray on arrival
RAYS = 45  # of a segment
RNG = np.random.default_rng(5)


def segment(number: int, turn: int = 1, **changes: Any) -> Scan:
    """Segment `number` of the turn that begins at the stamp `turn` * TURN, clockwise."""
    bearings = -np.radians(np.arange(RAYS) + 1.0 + RAYS * number)
    stamp = turn * TURN + number * TURN / 8
    ages = TURN / 360 * np.arange(RAYS - 1, -1, -1.0)
    scan = Scan(turn, stamp, RNG.uniform(0.3, 3.0, RAYS), bearings, 0.12, 3.5, ages)
    return structs.replace(scan, **changes)


def after_turn(seq: int = 0, sweep: Sweep | None = SPEC.sweep) -> SegmentCheck:
    """A check that has taken the turn of the stamps 0 to TURN, which arrived at once."""
    check = SegmentCheck(replace(SPEC, sweep=sweep))
    whole = Scan(seq, 0.0, np.ones(360), SPEC.bearings, 0.12, 3.5)
    check.on_turn(whole, TURN * 359 / 360, 100.0 - TURN / 360)
    return check


def taken(check: SegmentCheck, scan: Scan, late: float = 0.0) -> ScanSegment:
    """The segment that arrives DELAY + `late` s after its newest ray."""
    found = check.take(scan, arrival(scan) + late, DELAY)
    assert isinstance(found, ScanSegment), found
    return found


def arrival(scan: Scan) -> float:
    """The time on the robot's clock, which is 100 s at the stamp TURN."""
    span = 0.0 if scan.ages is None else float(scan.ages[0])
    return 100.0 - TURN + scan.stamp + span + DELAY


def test_segments_of_a_turn_follow_each_other() -> None:
    check = after_turn()
    for number in range(7):
        found = taken(check, segment(number))
        assert found.age == pytest.approx(DELAY)
        assert found.gap == pytest.approx(TURN / 360)
        assert found.ages[0] == pytest.approx(TURN * 44 / 360)


@pytest.mark.parametrize("has_ages", [True, False])
def test_ages_are_those_of_the_driver_or_of_the_sweep(has_ages: bool) -> None:
    scan = segment(3)
    assert scan.ages is not None
    found = taken(after_turn(), scan if has_ages else structs.replace(scan, ages=None))
    np.testing.assert_allclose(found.ages, scan.ages, atol=1e-12)


def test_a_ray_is_never_younger_than_its_latency_and_its_stamp_say() -> None:
    for late in (-0.005, 0.0, 0.05):
        found = taken(after_turn(), segment(0), late)
        assert found.age == pytest.approx(DELAY + max(late, 0.0))


def test_a_missing_segment_is_a_gap() -> None:
    check = after_turn()
    taken(check, segment(0))
    assert taken(check, segment(2)).gap == math.inf
    assert taken(check, segment(3)).gap == pytest.approx(TURN / 360)
    assert taken(after_turn(), segment(1)).gap == math.inf


def test_segments_wait_for_a_whole_turn() -> None:
    check = SegmentCheck(SPEC)
    assert check.take(segment(0), 1.0, DELAY) is None
    check = after_turn()
    check.forget()
    assert check.take(segment(0), 1.0, DELAY) is None


def turned(values: Array) -> Array:
    return values[::-1].copy()


BEARINGS = segment(1).bearings
SPREAD = np.append(BEARINGS[:-1], BEARINGS[-1] - 1.0)
WRONG: Mapping[str, Mapping[str, Any]] = {
    "an earlier turn": {"seq": 0},
    "another turn": {"seq": 2},
    "an earlier stamp": {"stamp": TURN},
    "a stamp of the last turn": {"stamp": 0.5 * TURN},
    "a stamp of a later turn": {"stamp": 2.2 * TURN},
    "a stamp that is no number": {"stamp": math.nan},
    "an infinite stamp": {"stamp": math.inf},
    "no rays": {"ranges": np.empty(0), "bearings": np.empty(0), "ages": np.empty(0)},
    "a table": {"ranges": np.ones((RAYS, 1))},
    "fewer bearings": {"bearings": BEARINGS[:-1]},
    "fewer ages": {"ages": np.zeros(RAYS - 1)},
    "an age below 0": {"ages": np.full(RAYS, -0.1)},
    "an age that is no number": {"ages": np.full(RAYS, math.nan)},
    "an age of a minute": {"ages": np.full(RAYS, 60.0)},
    "ages that rise": {"ages": turned(segment(1).ages)},  # type: ignore[arg-type]
    "the other direction": {"bearings": turned(BEARINGS)},
    "equal bearings": {"bearings": np.zeros(RAYS)},
    "bearings that are no numbers": {"bearings": np.full(RAYS, math.nan)},
    "infinite bearings": {"bearings": np.full(RAYS, math.inf)},
    "a wide gap": {"bearings": SPREAD},
    "more than half a turn": {"bearings": np.linspace(0.0, -4.0, RAYS)},
    "more rays than a turn": {
        "ranges": np.ones(400),
        "bearings": -np.linspace(0.0, 3.0, 400),
        "ages": np.zeros(400),
    },
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG)
def test_what_is_in_doubt_is_ignored_with_a_reason(wrong: Mapping[str, Any]) -> None:
    check = after_turn()
    taken(check, segment(0))
    refused = check.take(structs.replace(segment(1), **wrong), 100.05, DELAY)
    assert isinstance(refused, str)
    assert "\n" not in refused
    assert taken(check, segment(1)).gap < math.inf  # the right segment is still taken


def test_a_repeated_an_early_and_a_late_segment_are_ignored() -> None:
    check = after_turn()
    for number in (0, 2):
        taken(check, segment(number))
    for again in (segment(0), segment(1), segment(2)):
        assert isinstance(check.take(again, arrival(again), DELAY), str)
    late = segment(3)
    assert isinstance(check.take(late, arrival(late) + TURN, DELAY), str)


def test_a_frozen_sensor_is_ignored() -> None:
    check, ranges = after_turn(), segment(0).ranges
    taken(check, segment(0, ranges=ranges))
    refused = check.take(segment(1, ranges=ranges), arrival(segment(1)), DELAY)
    assert isinstance(refused, str)
    empty = np.zeros(RAYS)  # an open field repeats
    taken(check, segment(1, ranges=empty))
    taken(check, segment(2, ranges=empty))


def test_a_lidar_may_turn_the_other_way() -> None:
    check = after_turn(sweep=Sweep(0.0, 1.0, TURN))
    scan = segment(0, bearings=np.radians(np.arange(float(RAYS))))
    assert taken(check, scan).gap < math.inf
