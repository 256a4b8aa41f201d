"""The claims of docs/paper.md: one run each in the suite, three seeds in `make evidence`."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from studies.paper import ORIGINAL, STILL, changes
from swarmd.core.values import Array
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.scenarios.scenariofile import load_scenario

pytestmark = pytest.mark.long

SEEDS = (0, 1, 2)
NAMES = ("burger", "waffle_pi")
VISIBILITIES = ("body", "real")
LATE_BOUND = {"burger": 0.65, "waffle_pi": 0.75}
MDC = "mean_distance_to_centroid"
ALTERED = {"burger": 0.05, "waffle_pi": 0.25}
"""Waffle Pis kept 0.15 before protection computed the stop from a command. Now it reduces a turn by
quarters if the turn would swing a corner, 0.25 m from the axle, past a neighbour. The medians of 40
runs each are 0.15 with visibility `body` and 0.10 with `real`; the highest value is 0.23."""


@cache
def runs(
    name: str,
    visibility: str,
    law: str = "settling",
    mode: str = "",
    seeds: tuple[int, ...] = SEEDS,
    duration: float = 60.0,
) -> dict[str, Array]:
    """The values (seeds,) of each metric; `mode` of protection, empty: the platform's."""
    some = {"lidar_visibility": visibility, "duration": duration, **changes(name, law)}
    some |= {f"platforms.{name}.protection.mode": mode} if mode else {}
    results = simulate(f"paper_exp1_{name}", seeds, set=some, traces=False)
    return {metric: results.metric(metric) for metric in results.metrics}


@pytest.mark.evidence
@pytest.mark.parametrize("visibility", VISIBILITIES)
@pytest.mark.parametrize("name", NAMES)
def test_turtlebots_gather_in_one_cluster_and_rest_without_contact(
    name: str, visibility: str
) -> None:
    found = runs(name, visibility)
    assert (found["one_cluster_at_end"] == 1.0).all()
    assert (found["time_in_one_cluster_late"] >= 0.9).all()
    # The bound is 0.86 m. Waffle Pis with visibility `body` keep it in the median of 20 runs, which
    # is 0.84 m. The runs differ by 0.06 m, so the median of three is sometimes above the bound.
    early = 0.90 if (name, visibility) == ("waffle_pi", "body") else 0.86
    assert np.median(found["mean_distance_to_centroid_30s"]) <= early
    # The bound on the late distance holds after 120 s; with visibility `body`, in half the runs.
    assert (found["mean_distance_to_centroid_late"] <= 1.2 * LATE_BOUND[name]).all()
    assert (found["robot_contacts"] + found["arena_contacts"] == 0.0).all()
    assert (found["mean_speed_late_share"] <= 0.2).all()
    # Each change by the filter counts, even a small one.
    assert (found["command_alteration"] <= ALTERED[name]).all()


@pytest.mark.evidence
@pytest.mark.parametrize("visibility", VISIBILITIES)
@pytest.mark.parametrize("name", NAMES)
def test_the_potential_field_is_rarely_active(name: str, visibility: str) -> None:
    found = runs(name, visibility, mode="potential_field")
    assert (found["protection_duty_late"] <= 0.2).all()


@pytest.mark.evidence
@pytest.mark.parametrize("visibility", VISIBILITIES)
def test_jackals_are_one_cluster_and_looser(visibility: str) -> None:
    jackals, burgers = runs("jackal", visibility), runs("burger", visibility)
    assert (jackals["one_cluster_at_end"] == 1.0).all()
    nearest = "nearest_neighbor_median_late"
    assert jackals[nearest].min() > 1.1
    assert jackals[nearest].min() > burgers[nearest].max()


def test_the_original_law_never_rests_and_ours_does() -> None:
    """Short form: Waffle Pis under the potential field, seed 0, for 30 s."""
    ours, original = (
        runs("waffle_pi", "real", law, seeds=(0,), duration=30.0) for law in ("settling", ORIGINAL)
    )
    assert ours["one_cluster_at_end"] == 1.0
    assert ours["robot_contacts"] + ours["arena_contacts"] == 0.0
    assert ours["mean_speed_late_share"] <= 0.2
    for metric in ("mean_speed_late_share", "protection_duty_late"):
        assert original[metric] > 2.0 * ours[metric]


@pytest.mark.evidence
def test_the_original_law_under_the_original_protection_never_rests() -> None:
    ours, original = runs("burger", "body"), runs("burger", "body", ORIGINAL)
    for metric in ("mean_speed_late_share", "protection_duty_late"):
        assert original[metric].min() > 2.0 * ours[metric].max()


@pytest.mark.parametrize("name", ["waffle_pi", "jackal", "hardware_free"])
def test_the_control_never_moves_whatever_lidars_see(name: str) -> None:
    for visibility in VISIBILITIES:
        found = runs(name, visibility, STILL, seeds=(0,), duration=6.0)
        assert found["path_length"] == 0.0
        assert found[f"{MDC}_end"] == found[f"{MDC}_start"]
        assert found["robot_contacts"] + found["arena_contacts"] == 0.0


def test_no_two_robots_are_linked_at_the_free_start() -> None:
    scenario = load_scenario("paper_exp1_hardware_free")
    assert {platform.name for platform in scenario.robots.values()} == {"waffle_pi"}
    assert (scenario.arena.length, scenario.arena.width, scenario.duration) == (6.6, 4.8, 120)
    for seed in range(10):
        places = scenario.starts(seed)[:, :2]
        one, other = np.triu_indices(len(places), 1)
        assert np.hypot(*(places[one] - places[other]).T).min() > 1.0
