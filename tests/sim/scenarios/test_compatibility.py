"""Before a run, a scenario says which platforms do not see or outrun each other."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of

SPEED = {"protection": {"barrier": {"others_speed": 0.4}}}


def mixed(*platforms: str, **changes: Any) -> Scenario:
    return scenario_of(
        {
            "arena": {"size": [8, 8]},
            "start": {"layout": "row", "spacing": 2.0},
            "platforms": {name: {"extends": name, **SPEED} for name in platforms},
            "groups": {
                name: {"platform": name, "count": 1, "pattern": "drive"} for name in platforms
            },
            "lidar_visibility": "real",
            **changes,
        }
    )


def test_an_unseen_pair_is_refused_with_what_to_set() -> None:
    with pytest.raises(ConfigError, match=r"jackal: burger is not seen.*accepts_unseen.*bearing"):
        mixed("burger", "jackal")


def test_all_pairs_that_would_be_held_are_refused_in_one_line() -> None:
    with pytest.raises(ConfigError) as refused:
        mixed("burger", "waffle_pi", "jackal", platforms={})
    text = str(refused.value)
    assert "\n" not in text
    for pair in (
        "burger: waffle_pi is not seen", "burger: waffle_pi is faster", "burger: jackal is faster",
        "waffle_pi: jackal is faster", "jackal: burger is not seen",
        "jackal: waffle_pi is not seen",
    ):  # fmt: skip
        assert text.count(pair) == 1
    assert text.count("radio.range_and_bearing") == text.count("one protection.barrier") == 1


def test_many_pairs_that_would_be_held_are_counted() -> None:
    names = ("burger", "waffle_pi", "jackal", "thymio")
    with pytest.raises(ConfigError, match=r"; and \d+ more; see accepts_"):
        mixed(*names, platforms={})


def test_a_pair_of_unlike_speeds_is_refused_with_what_to_set() -> None:
    with pytest.raises(ConfigError, match=r"burger: waffle_pi is faster.*0.40.*accepts_faster"):
        mixed("burger", "waffle_pi", platforms={}, lidar_visibility="body")


def test_an_accepted_platform_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"accepts_unseen.*no platform 'burgr'.*'burger'"):
        mixed("burger", "jackal", accepts_unseen=["burgr"])


def test_a_grant_of_the_wrong_type_says_both_types() -> None:
    with pytest.raises(ConfigError, match=r"expected keys and values or a list, each text"):
        mixed("burger", "jackal", accepts_unseen="burger")


@pytest.mark.parametrize(
    ("changes", "note"),
    [
        ({"accepts_unseen": {"burger": "a fence"}}, "accepted: a fence"),
        ({"radio": {"range_and_bearing": True}}, "told by range and bearing"),
    ],
)
def test_a_pair_that_is_accepted_or_told_is_noted(changes: dict[str, Any], note: str) -> None:
    (line,) = mixed("burger", "jackal", **changes).notes
    assert line.startswith("jackal: burger is not seen")
    assert note in line


def test_where_lidars_see_whole_bodies_nothing_is_noted_and_nobody_is_held() -> None:
    scenario = mixed("burger", "jackal", lidar_visibility="body")
    assert scenario.notes == ()
    assert reasons(scenario, 3.0) == {"burger-01": None, "jackal-01": None}


def test_told_neighbours_let_robots_run_and_without_them_the_blind_one_is_held() -> None:
    told = mixed("burger", "jackal", radio={"range_and_bearing": True})
    assert reasons(told, 3.0) == {"burger-01": None, "jackal-01": None}
    # Nobody is told beyond the range of the radio.
    apart = {"range_and_bearing": True, "neighborhood": "range", "range": 1.0}
    assert reasons(mixed("burger", "jackal", radio=apart), 3.0) == {
        "burger-01": None,
        "jackal-01": "incompatible_peer",
    }


def reasons(scenario: Scenario, seconds: float) -> dict[str, str | None]:
    run = Lockstep(scenario, 0)
    run.advance(seconds)
    return {shell.robot.id: shell.robot.reason for shell in run.shells if shell is not None}
