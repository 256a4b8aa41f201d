"""The radio: neighbors, losses, delays, line of sight, and range-and-bearing boards."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.values import Array, Neighbor
from swarmd.sim.world.arena import Arena, Box, Pole, Segment
from swarmd.sim.world.line_of_sight import LineOfSight
from swarmd.sim.world.radio import Radio, RadioSettings, check_radio

ARENA = Arena(40.0, 40.0)
ROW = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [5.0, 0.0, 0.0]])


def names(n: int) -> list[str]:
    return [f"r-{row}" for row in range(n)]


def radio(n: int = 3, arena: Arena = ARENA, seed: int = 2, **values: Any) -> Radio:
    return Radio(RadioSettings(**values), names(n), arena, seed=seed)


def heard(neighbors: tuple[Neighbor, ...]) -> list[str]:
    return [neighbor.id for neighbor in neighbors]


def crowd(n: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(-15.0, 15.0, (n, 3))


def test_all_hear_each_other_and_not_themselves() -> None:
    air = radio()
    assert [heard(air.neighbors(row, ROW)) for row in range(3)] == [
        ["r-1", "r-2"],
        ["r-0", "r-2"],
        ["r-0", "r-1"],
    ]


def test_the_radio_ends_at_its_range() -> None:
    air = radio(neighborhood="range", range=3.0)
    assert [air.hearers(row, ROW).tolist() for row in range(3)] == [[1], [0, 2], [1]]


def test_a_movable_box_blocks_the_radio_if_given() -> None:
    crate = Box(1.0, 0.0, 0.5, 0.5, mass=1.0)
    air = radio(arena=Arena(40.0, 40.0, boxes=(crate,)), line_of_sight=True)
    movable_boxes = crate.corners[None]
    assert air.hearers(0, ROW).tolist() == [1, 2]
    assert air.hearers(0, ROW, movable_boxes).tolist() == []
    assert radio(arena=ARENA).hearers(0, ROW, movable_boxes).tolist() == [1, 2]
    air.carry(air.send(0, "a/b", 1, 0.0, ROW, movable_boxes))
    assert air.arrived(0.0) == []


def test_a_message_without_delay_arrives_at_once_and_once() -> None:
    air = radio()
    air.carry(air.send(1, "voting/opinion", {"option": 2}, 3.0, ROW))
    assert air.arrived(2.99) == []
    assert air.arrived(3.0) == [
        (0, 1, "voting/opinion", {"option": 2}),
        (2, 1, "voting/opinion", {"option": 2}),
    ]
    assert air.arrived(9.0) == []


def test_a_delay_of_whole_steps_ends_with_its_step_despite_rounding() -> None:
    air = radio(delay=0.2)
    air.carry(air.send(0, "a/b", 1, 0.1, ROW))
    assert 30 * 0.01 < 0.1 + 0.2  # in floating point
    assert air.arrived(29 * 0.01) == []
    assert len(air.arrived(30 * 0.01)) == 2


def test_simultaneous_arrivals_come_in_a_random_order_of_senders() -> None:
    """Each of the two others is the first to be heard equally often; each says two words."""
    from scipy.stats import binomtest

    air, first = radio(delay=0.1), []
    for second in range(300):
        for sender in (0, 1):
            for word in ("a", "b"):
                air.carry(air.send(sender, "a/b", word, float(second), ROW))
        got = [
            (sender, word) for hearer, sender, _, word in air.arrived(second + 0.5) if hearer == 2
        ]
        assert [word for _, word in got] == ["a", "b", "a", "b"]
        first.append(got[0][0])
    assert binomtest(sum(first), len(first), 0.5).pvalue > 1e-4


def test_loss_is_the_stated_share_of_messages_and_hearers() -> None:
    n, times = 21, 400
    air, poses = radio(n, loss=0.3), crowd(n)
    counts = np.zeros(n)
    for _ in range(times):
        air.carry(air.send(4, "a/b", 1, 0.0, poses))
        for hearer, *_ in air.arrived(0.0):
            counts[hearer] += 1.0
    assert counts[4] == 0.0
    sd = math.sqrt(0.3 * 0.7 / times)
    assert np.delete(counts, 4) / times == pytest.approx(0.7, abs=5.0 * sd)
    assert counts.sum() / times / (n - 1) == pytest.approx(0.7, abs=5.0 * sd / math.sqrt(n - 1))


def test_all_is_lost_and_nothing_at_the_ends_of_loss() -> None:
    deaf = radio(loss=1.0)
    deaf.carry(deaf.send(0, "a/b", 1, 0.0, ROW))
    assert deaf.arrived(99.0) == []


def test_jitter_is_even_within_its_bounds_and_each_hearers_own() -> None:
    n = 200
    air, poses = radio(n, delay=0.1, jitter=0.04), crowd(n)
    air.carry(air.send(0, "a/b", 1, 5.0, poses))
    arrivals = []
    for step in range(200):
        now = 5.0 + 0.001 * step
        arrivals += [now] * len(air.arrived(now))
    assert len(arrivals) == n - 1
    assert min(arrivals) >= 5.06
    assert max(arrivals) <= 5.141
    assert np.mean(arrivals) == pytest.approx(5.1, abs=5.0 * 0.04 / math.sqrt(3.0 * n) + 0.001)
    assert np.std(arrivals) == pytest.approx(0.04 / math.sqrt(3.0), rel=0.2)


def test_messages_are_in_order_of_arrival() -> None:
    n = 30
    whole, poses = radio(n, delay=0.1, jitter=0.1), crowd(n)
    steps = radio(n, delay=0.1, jitter=0.1)
    for sender in (3, 1, 2):
        whole.carry(whole.send(sender, "a/b", sender, 0.01 * sender, poses))
        steps.carry(steps.send(sender, "a/b", sender, 0.01 * sender, poses))
    one_by_one = [arrival for step in range(300) for arrival in steps.arrived(0.001 * step)]
    assert whole.arrived(1.0) == one_by_one


def test_losses_do_not_depend_on_other_senders() -> None:
    alone, among = radio(20, loss=0.5), radio(20, loss=0.5)
    poses = crowd(20)
    for _ in range(5):
        among.carry(among.send(7, "a/b", "noise", 0.0, poses))
        alone.carry(alone.send(3, "a/b", 1, 0.0, poses))
        among.carry(among.send(3, "a/b", 1, 0.0, poses))
    of_three = [arrival for arrival in among.arrived(0.0) if arrival[1] == 3]
    assert alone.arrived(0.0) == of_three


def test_the_seed_decides_what_is_lost() -> None:
    poses, got = crowd(40), []
    for seed in (1, 1, 2):
        air = radio(40, seed=seed, loss=0.5)
        air.carry(air.send(0, "a/b", 1, 0.0, poses))
        got.append(air.arrived(0.0))
    assert got[0] == got[1] != got[2]


@pytest.mark.parametrize(
    ("poses", "bearing", "heading"),
    [
        ([[0.0, 0.0, 0.0], [0.0, 3.0, 0.0]], 90.0, 0.0),  # to the left, looking the same way
        ([[0.0, 0.0, 0.0], [0.0, -3.0, math.pi / 2.0]], -90.0, 90.0),
        ([[1.0, 1.0, math.pi / 2.0], [1.0, 4.0, math.pi / 2.0]], 0.0, 0.0),  # ahead
        ([[1.0, 1.0, math.pi / 2.0], [4.0, 1.0, 0.0]], -90.0, -90.0),
        ([[0.0, 0.0, 3.0], [-3.0, 0.0, -3.0]], 180.0 - math.degrees(3.0), 360 - 2 * 171.887),
    ],
)
def test_bearing_and_heading_are_the_hearers_and_left_is_positive(
    poses: list[list[float]], bearing: float, heading: float
) -> None:
    air = radio(2, range_and_bearing=True)
    many = [air.neighbors(0, np.array(poses))[0] for _ in range(100)]
    assert np.mean([n.bearing or 0.0 for n in many]) == pytest.approx(
        math.radians(bearing), abs=0.02
    )
    assert np.mean([n.heading or 0.0 for n in many]) == pytest.approx(
        math.radians(heading), abs=0.02
    )
    assert np.mean([n.distance or 0.0 for n in many]) == pytest.approx(3.0, abs=0.05)


def test_bearings_noise_has_the_stated_size() -> None:
    air, poses = radio(2, range_and_bearing=True), np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]])
    many = [air.neighbors(0, poses)[0] for _ in range(2000)]
    accuracy = 5.0 / math.sqrt(4000.0)
    assert np.std([n.distance or 0.0 for n in many]) == pytest.approx(0.1, rel=accuracy)
    assert np.std([n.bearing or 0.0 for n in many]) == pytest.approx(math.radians(2), rel=accuracy)
    assert np.std([n.heading or 0.0 for n in many]) == pytest.approx(math.radians(2), rel=accuracy)


def posed(poses: Array, seconds: float = 0.0, **values: Any) -> Iterator[tuple[float, Neighbor]]:
    """The time and robot r-1 as r-0 knows it, ten times a second, of a swarm that stands."""
    air = radio(len(poses), places="shared", **values)
    for tick in range(round(10.0 * seconds) + 1):
        air.measure_poses(range(len(poses)), poses, 0.1 * tick)
        yield 0.1 * tick, air.neighbors(0, poses, now=0.1 * tick)[0]


def test_places_by_shared_poses_have_the_noise_of_two_poses() -> None:
    # r-0 looks along +y, and r-1 is 3 m to its left and looks back along +x.
    poses = np.array([[1.0, 1.0, math.pi / 2.0], [-2.0, 1.0, 0.0]])
    known = [near for _, near in posed(poses, 400.0) if near.distance is not None]
    assert np.mean([n.distance or 0.0 for n in known]) == pytest.approx(3.0, abs=0.003)
    assert np.std([n.distance or 0.0 for n in known]) == pytest.approx(0.02 * 2**0.5, rel=0.07)
    assert np.mean([n.bearing or 0.0 for n in known]) == pytest.approx(math.pi / 2.0, abs=0.004)
    yaw_sd = math.radians(2.0)
    across = math.hypot(yaw_sd, 0.02 * 2**0.5 / 3.0)
    assert np.std([n.bearing or 0.0 for n in known]) == pytest.approx(across, rel=0.07)
    assert np.mean([n.heading or 0.0 for n in known]) == pytest.approx(-math.pi / 2.0, abs=0.005)
    assert np.std([n.heading or 0.0 for n in known]) == pytest.approx(yaw_sd * 2**0.5, rel=0.07)
    assert known[0].error == pytest.approx(2 * 0.06 + math.radians(6.0) * 3.0, rel=0.05)


def test_places_by_shared_poses_have_gaps_of_half_a_second_in_five() -> None:
    poses = np.zeros((2, 3))
    poses[1, 0] = 2.0
    ages = np.array([near.age for _, near in posed(poses, 100.0)])
    assert ages.max() == pytest.approx(0.5)
    # Each of the two robots has no new pose in a tenth of the time.
    assert 0.1 <= np.mean(ages > 0.05) <= 0.2


def test_places_of_robots_that_never_measured_their_pose_are_not_known() -> None:
    air, poses = radio(3, places="shared"), np.zeros((3, 3))
    for tick in range(6):  # longer than a gap
        air.measure_poses([0, 2], poses, 0.1 * tick)
    one, two = air.neighbors(0, poses, now=0.5)
    assert (one.id, one.distance, two.distance is None) == ("r-1", None, False)
    assert air.neighbors(0, poses, now=2.0)[1].distance is None  # too old


def test_bearings_stay_within_half_a_turn_and_distances_above_zero() -> None:
    air = radio(2, range_and_bearing=True)
    poses = np.array([[0.0, 0.0, 9.0], [-0.01, 0.0, 9.0 + math.pi]])
    for _ in range(200):
        neighbor = air.neighbors(0, poses)[0]
        assert neighbor.distance is not None
        assert neighbor.bearing is not None
        assert neighbor.heading is not None
        assert neighbor.distance >= 0.0
        assert abs(neighbor.bearing) <= math.pi
        assert abs(neighbor.heading) <= math.pi


@pytest.mark.parametrize(
    ("values", "key"),
    [
        ({"neighborhood": "range"}, "radio.range"),
        ({"places": "shared", "range_and_bearing": True}, "radio.places"),
        ({"range": 5.0}, "radio.range"),
        ({"delay": 0.1, "jitter": 0.2}, "radio.jitter"),
    ],
)
def test_contradicting_settings_are_refused(values: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=key):
        check_radio(RadioSettings(**values))
    with pytest.raises(ConfigError, match=key):
        radio(**values)


def clear(arena: Arena, a: tuple[float, float], b: tuple[float, float]) -> bool:
    forth = LineOfSight(arena).is_clear(np.array([a]), np.array([b]))
    back = LineOfSight(arena).is_clear(np.array([b]), np.array([a]))
    assert forth == back
    return bool(forth[0])


@pytest.mark.parametrize(
    "arena",
    [
        Arena(20.0, 20.0, boxes=(Box(0.0, 0.0, 1.0, 1.0, 0.4),)),
        Arena(20.0, 20.0, poles=(Pole(0.0, 0.0, 0.3),)),
        Arena(20.0, 20.0, segments=(Segment(0.1, -1.0, -0.1, 1.0),)),
    ],
)
def test_box_pole_and_inner_wall_block_the_sight(arena: Arena) -> None:
    assert not clear(arena, (-2.0, 0.0), (2.0, 0.0))
    assert not clear(arena, (-2.0, -0.2), (3.0, 0.25))
    assert clear(arena, (-2.0, 0.0), (-1.0, 0.0))  # in front of it
    assert clear(arena, (1.0, 0.0), (2.0, 0.0))  # behind it
    assert clear(arena, (-2.0, 1.5), (2.0, 1.5))  # beside it
    assert clear(arena, (-2.0, 0.0), (0.0, 3.0))  # past its corner


def test_movable_boxes_block_only_where_they_are() -> None:
    crate = Box(0.0, 0.0, 1.0, 1.0, mass=2.0)
    sight = LineOfSight(Arena(20.0, 20.0, boxes=(crate,)))
    a, b = np.array([[-2.0, 0.0]]), np.array([[2.0, 0.0]])
    elsewhere, away = crate.corners + np.array([0.0, 4.0]), np.full((4, 2), np.nan)
    assert sight.is_clear(a, b)[0]
    assert not sight.is_clear(a, b, np.array([away, crate.corners]))[0]
    assert sight.is_clear(a, b, np.array([away, elsewhere]))[0]
    assert sight.is_clear(a, b, np.empty((0, 4, 2)))[0]


def test_many_ways_at_once_are_each_as_alone() -> None:
    rng = np.random.default_rng(3)
    boxes = tuple(Box(x, y, 0.4, 0.2, x) for x, y in rng.uniform(-4.0, 4.0, (30, 2)).tolist())
    sight = LineOfSight(Arena(10.0, 10.0, boxes, (Pole(3.0, -3.0, 0.5),)))
    a, b = rng.uniform(-5.0, 5.0, (2, 3000, 2))
    together = sight.is_clear(a, b)
    alone = [sight.is_clear(a[i : i + 1], b[i : i + 1])[0] for i in range(3000)]
    assert together.tolist() == alone
    assert 0.1 < together.mean() < 0.9
