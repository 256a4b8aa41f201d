"""The environment: PettingZoo's own tests, agents that come and go, rewards, and protection."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

import swarmd
from swarmd.core.errors import ConfigError, PluginError, SwarmError
from swarmd.core.values import Inputs
from swarmd.kit.observation import (
    NeighborsPart,
    PolicySpec,
    ReadingPart,
    RobotsPart,
    ScanPart,
    TwistPart,
)
from swarmd.kit.policy_network import PolicyNetwork, network_of, parameter_count, to_text
from swarmd.kit.policy_pattern import PolicyPattern
from swarmd.sim.learning.environment import SwarmEnv
from swarmd.sim.learning.rewards import State
from swarmd.sim.metrics.aggregation import distance_to_centroid
from swarmd.testing.pattern_contract import Subject

ROOM = {"arena.boxes": [], "arena.poles": [], "arena.size": [4, 4], "duration": 4}
SMALL = {**ROOM, "groups.tb3.count": 3}
SPEC = PolicySpec((ScanPart(), RobotsPart(), TwistPart()))
EVENTS = [
    {"at": 1.0, "kill": "tb3-01"},
    {"at": 1.0, "leave": "tb3-02"},
    {"at": 2.0, "join": "tb3-02"},
    {"at": 2.5, "run": "attraction", "targets": "tb3-02", "parameters": {"spacing": 0.6}},
]


def make(changes: Mapping[str, Any] | None = None, **options: Any) -> SwarmEnv:
    made = swarmd.env("aggregation", set={**SMALL, **(changes or {})}, **options)
    assert isinstance(made, SwarmEnv)
    return made


def steps(env: SwarmEnv, action: tuple[float, ...], seed: int = 1) -> list[Any]:
    """What `reset` and each step of a whole run gave, with this action of all."""
    given = [env.reset(seed)]
    while env.agents:
        given.append(env.step({agent: np.array(action) for agent in env.agents}))  # type: ignore[arg-type]
    return given


def test_the_api_test_of_pettingzoo_passes(capsys: pytest.CaptureFixture[str]) -> None:
    parallel_api_test(make({"duration": 2, "events": EVENTS[:1]}), num_cycles=30)
    assert "Passed" in capsys.readouterr().out


def test_the_seed_test_of_pettingzoo_passes() -> None:
    parallel_seed_test(lambda: make({"duration": 2}), num_cycles=10)


def test_a_seed_gives_the_same_run_bit_by_bit_and_another_seed_another() -> None:
    env, other = make(), make()
    first, again = (steps(one, (0.5, 0.2), seed=7) for one in (env, other))
    repeated = steps(env, (0.5, 0.2), seed=7)  # after a run in the same object
    different = steps(env, (0.5, 0.2), seed=8)
    assert repr(first) == repr(again) == repr(repeated)
    assert len(first) > 30
    assert repr(first) != repr(different)


def test_without_a_seed_each_reset_begins_the_next_run_of_the_first_seed() -> None:
    env, other = make(seed=3), make(seed=3)
    seeds = []
    for one in (env, other):
        one.reset()
        seeds.append([one.seed])
        one.reset()
        seeds[-1].append(one.seed)
    assert seeds[0] == seeds[1]
    assert seeds[0][0] == 3 != seeds[0][1]


def test_robots_that_leave_are_killed_and_come_back_are_agents_that_change() -> None:
    env = make({"events": EVENTS}, seed=1)
    assert env.possible_agents == ["tb3-01", "tb3-02", "tb3-02#2", "tb3-03"]
    observations, _ = env.reset()
    assert list(observations) == env.agents == ["tb3-01", "tb3-02", "tb3-03"]
    ended: dict[str, float] = {}
    states: dict[str, list[str]] = {"tb3-02#2": []}
    while env.agents:
        before = set(env.agents)
        observations, rewards, terminations, truncations, infos = env.step(
            {agent: np.ones(2) for agent in env.agents}
        )
        assert set(observations) == set(rewards) == set(terminations) == set(truncations)
        assert set(observations) >= before
        for agent, is_over in terminations.items():
            if is_over:
                ended[agent] = env.trace().duration
                assert infos[agent]["state"] == "absent"
        if "tb3-02#2" in infos:
            states["tb3-02#2"].append(infos["tb3-02#2"]["state"])
    assert set(ended) == {"tb3-01", "tb3-02"}
    assert all(1.0 <= at <= 1.2 for at in ended.values())
    assert truncations == {"tb3-02#2": True, "tb3-03": True}
    assert states["tb3-02#2"][0] == "idle"  # it has joined, and runs nothing yet
    assert states["tb3-02#2"][-1] == "running"


def test_robots_of_other_groups_run_their_own_pattern() -> None:
    groups = {
        "taught": {"platform": "waffle_pi", "count": 1, "pattern": "drive"},
        "tb3": {"count": 2, "pattern": "random_walk"},
    }
    env = swarmd.env("aggregation", 1, set={**ROOM, "groups": groups}, agents="taught")
    steps(env, (0.0, 0.0))
    assert env.possible_agents == ["taught-01"]
    way = np.abs(np.diff(env.trace().pose[:, :, :2], axis=0)).sum(axis=(0, 2))
    assert way[0] < 0.01  # `taught-01` requests zero
    assert way[1:].max() > 0.5  # the others walk, if one is not turning


def test_an_action_is_a_request_that_protection_limits() -> None:
    env = make({"groups.tb3.count": 1, "duration": 12}, seed=1)
    given = steps(env, (1.0, 0.0))
    trace = env.trace()
    assert trace.requested is not None
    assert trace.requested[5:, 0, 0] == pytest.approx(0.26)  # the limit of a Waffle Pi
    assert trace.safe[10, 0, 0] > 0.2
    assert abs(trace.safe[-1, 0, 0]) < 0.01  # at a wall
    assert given[-1][4]["tb3-01"] == {"state": "running", "limited": True, "contacts": 0}


def test_without_protection_the_same_actions_touch_a_wall_and_cost_it() -> None:
    off = {"groups.tb3.count": 1, "duration": 12, "platforms.waffle_pi.protection.mode": "off"}
    env = make(off, seed=1, reward={"contacts": -0.5})
    given = steps(env, (1.0, 0.0))
    contacts = [infos["tb3-01"]["contacts"] for *_, infos in given[1:]]
    rewards = [rewards["tb3-01"] for _, rewards, *_ in given[1:]]
    assert sum(contacts) >= 1
    assert rewards == [-0.5 * count for count in contacts]


def test_the_reward_of_a_metric_adds_up_to_its_change() -> None:
    env = make(seed=1, reward={"mean_distance_to_centroid_end": -2.0})
    given = steps(env, (0.7, 0.2))
    total = sum(rewards["tb3-02"] for _, rewards, *_ in given[1:])
    away = distance_to_centroid(env.trace())
    assert abs(away[-1] - away[0]) > 0.05
    assert total == pytest.approx(-2.0 * (away[-1] - away[0]), abs=2e-3)


def test_a_function_of_the_state_rewards_each_robot() -> None:
    seen: list[State] = []

    def reward(state: State) -> Mapping[str, float]:
        seen.append(state)
        return {"tb3-02": float(state.requested[1, 0])}

    given = steps(make({"duration": 2}, reward=reward), (1.0, 0.0))
    assert [one.ids for one in seen] == [("tb3-01", "tb3-02", "tb3-03")] * (len(given) - 1)
    assert seen[-1].period == pytest.approx(0.1)
    assert given[-1][1] == {"tb3-01": 0.0, "tb3-02": pytest.approx(0.26), "tb3-03": 0.0}


def _random_network(spec: PolicySpec) -> PolicyNetwork:
    numbers = np.random.default_rng(5).normal(0.0, 0.5, parameter_count(spec, (4,)))
    return network_of(spec, numbers, (4,))


def test_a_pattern_on_the_same_inputs_observes_and_requests_the_same() -> None:
    spec = replace_parts(SPEC, NeighborsPart(count=2))
    network = _random_network(spec)
    kind = type("Learned", (PolicyPattern,), {"network": to_text(network)})
    env = make({"radio.range_and_bearing": True}, spec=spec, seed=2)
    observations, _ = env.reset()
    platform = env.scenario.robots["tb3-01"]
    compared = 0
    while env.agents:
        for agent, observation in observations.items():
            seat = env._episode.seats[agent]  # type: ignore[union-attr]
            pattern = Subject(kind, platform, {}).make()
            assert isinstance(pattern, PolicyPattern)
            assert isinstance(seat.inputs, Inputs)
            np.testing.assert_array_equal(pattern.observed(seat.inputs), observation)
            twist, wanted = pattern.step(seat.inputs).twist, network.act(observation)
            assert twist is not None
            # The weights of the text are of 32 bits.
            assert twist.linear == pytest.approx(wanted[0] * platform.limits.linear, abs=1e-6)
            assert twist.angular == pytest.approx(wanted[1] * platform.limits.angular, abs=1e-5)
            compared += 1
        actions = {agent: network.act(observations[agent]) for agent in env.agents}
        observations, *_ = env.step(actions)
    assert compared > 90


def replace_parts(spec: PolicySpec, *more: Any) -> PolicySpec:
    return PolicySpec((*spec.parts, *more), lateral=spec.lateral, period=spec.period)


def test_a_base_that_moves_sideways_has_a_third_action() -> None:
    env = make({"groups.tb3.platform": "rosbot_xl", "groups.tb3.count": 1, "duration": 2}, seed=1)
    assert env.spec.names[-3:] == ("twist.linear", "twist.angular", "twist.lateral")
    steps(env, (0.0, 0.0, -0.25))
    assert env.trace().requested[-1, 0] == pytest.approx([0.0, 0.0, -0.2])  # type: ignore[index]


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: make(reward={"no_such_metric": 1.0}), "no metric"),
        (lambda: make(reward={"gather_time": 1.0}), "no value at an instant"),
        (lambda: make(agents="tb4"), "agents: "),
        (
            lambda: make(spec=PolicySpec((ReadingPart("light"),))),
            "tb3-01: spec needs reading:light",
        ),
        (lambda: swarmd.env("drive"), "reward: scenario drive"),
        (lambda: make().step({}), "call reset first"),
        (lambda: make(seed=-1), "-1 is no seed"),
        (lambda: make(render_mode="human"), "render_mode: no mode 'human'; there are: rgb_array"),
        (lambda: make(render_mode="rgb_array").render(), "call reset first"),
        (lambda: reset(None).render(), "render_mode='rgb_array'"),
        (lambda: make().reset(seed=1.5), "1.5 is no seed"),  # type: ignore[arg-type]
        (lambda: make(spec=PolicySpec((ScanPart(),), period=0.0)), "period"),
        (lambda: make(spec=PolicySpec((ScanPart(sectors=0),))), "sectors"),
        (lambda: make(reward={"contacts": "much"}), "weight of contacts"),
        (lambda: make(reward={"contacts": math.nan}), "weight of contacts"),
        (lambda: over().step({}), "call reset"),
        (lambda: reset(lambda state: None).step({}), "reward: .* by robot"),
        (lambda: reset(lambda state: {"tb3-9": 1.0}).step({}), "tb3-9"),
        (lambda: reset(lambda state: {"tb3-01": math.nan}).step({}), "reward of tb3-01 is nan"),
    ],
)
def test_a_fault_is_named(call: Callable[[], object], text: str) -> None:
    with pytest.raises(ConfigError, match=text) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.integration
def test_without_its_packages_the_remedy_is_named() -> None:
    code = "import sys; sys.modules['pettingzoo'] = None; import swarmd; swarmd.env"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "ImportError" in done.stderr.splitlines()[-1]
    assert "pip install 'swarmd[learn]'" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize("action", [[math.nan, 0.0], [1.0], [0.0, 0.0, 0.0], "left", {}, [[1], []]])
def test_an_action_that_is_none_is_refused(action: Any) -> None:
    env = make(seed=1)
    env.reset()
    with pytest.raises(SwarmError, match="the action of tb3-02"):
        env.step({"tb3-01": np.ones(2), "tb3-02": action})
    env.step({})
    env.step({})
    assert not env.trace().requested.any()  # type: ignore[union-attr]  # none was taken


def test_an_action_of_no_agent_is_refused_and_of_one_that_is_gone_ignored() -> None:
    env = make({"events": EVENTS[:1], "duration": 2}, seed=1)
    env.reset()
    with pytest.raises(ConfigError, match="tb3_01"):
        env.step({"tb3_01": np.zeros(2)})
    while "tb3-01" in env.agents:
        env.step({})
    env.step({"tb3-01": np.zeros(2)})


def test_a_seed_of_numpy_is_a_seed() -> None:
    (first, _), (second, _) = make().reset(3), make(seed=np.int64(3)).reset()
    np.testing.assert_array_equal(first["tb3-01"], second["tb3-01"])


def test_pictures_show_where_the_robots_are() -> None:
    env = make(seed=1, render_mode="rgb_array")
    assert env.render_mode in env.metadata["render_modes"]
    assert env.metadata["render_fps"] == 10
    env.reset()
    first = env.render()
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(env.render(), first)
    while env.agents:
        env.step({agent: np.array([1.0, 0.0]) for agent in env.agents})
    last = env.render()
    for picture, pose in ((first, env.trace().pose[0]), (last, env.trace().pose[-1])):
        # The arena of 4 m with 0.2 m on each side fills the height.
        scale = 480 / 4.4
        columns, rows = (
            (320 + scale * pose[:, 0]).astype(int),
            (240 - scale * pose[:, 1]).astype(int),
        )
        for row, column in zip(rows, columns, strict=True):
            near = picture[row - 15 : row + 16, column - 15 : column + 16].astype(int)
            is_green = near[..., 1] > near[..., 0] + 60  # the colour of a running robot
            assert is_green.sum() > 50
    changed = (first != last).any(axis=2)
    assert 0.001 < changed.mean() < 0.1
    env.reset(1)
    np.testing.assert_array_equal(env.render(), first)
    env.close()
    with pytest.raises(ConfigError, match="call reset first"):
        env.render()


def test_without_matplotlib_a_render_mode_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("swarmd.sim.learning.environment.find_spec", lambda name: None)
    with pytest.raises(PluginError, match=r"pip install 'swarmd\[plot\]'"):
        make(render_mode="rgb_array")
    assert make().render_mode is None


def test_two_environments_draw_their_own_runs() -> None:
    one, two = (make({"groups.tb3.count": n}, seed=1, render_mode="rgb_array") for n in (1, 3))
    for env in (one, two):
        env.reset()
    first = one.render()
    other = two.render()
    np.testing.assert_array_equal(one.render(), first)
    assert (first != other).any()
    one.close()
    np.testing.assert_array_equal(two.render(), other)
    two.close()


def test_a_robot_that_comes_back_within_a_step_is_another_agent() -> None:
    events = [{"at": 0.4, "leave": "tb3-02"}, {"at": 0.6, "join": "tb3-02"}]
    env = make({"events": events, "duration": 3}, spec=PolicySpec((ScanPart(),), period=1.0))
    env.reset(1)
    assert env.agents == ["tb3-01", "tb3-02", "tb3-03"]
    _, _, terminations, _, _ = env.step({"tb3-02": np.ones(2)})
    assert env.agents == ["tb3-01", "tb3-02#2", "tb3-03"]
    assert terminations == {"tb3-01": False, "tb3-02": True, "tb3-03": False, "tb3-02#2": False}


def reset(reward: Any) -> SwarmEnv:
    env = make(reward=reward)
    env.reset(1)
    return env


def over() -> SwarmEnv:
    env = make({"duration": 0.5})
    env.reset(1)
    while env.agents:
        env.step({})
    return env
