"""Environments in worker processes give what single ones give, as stacked arrays."""

from __future__ import annotations

import numpy as np
import pytest

import swarmd
from swarmd.core.errors import ConfigError
from swarmd.sim.learning.vector import JointEnv, vector_env

SET = {
    "arena.boxes": [],
    "arena.poles": [],
    "arena.size": [4, 4],
    "groups.tb3.count": 3,
    "duration": 2,
    "events": [{"at": 1.0, "kill": "tb3-02"}],
}


@pytest.mark.integration
@pytest.mark.long
def test_two_processes_give_what_two_environments_give() -> None:
    envs = vector_env(2, "aggregation", seed=4, set=SET)
    singles = [JointEnv(swarmd.env("aggregation", seed, set=SET)) for seed in (4, 5)]
    try:
        observations, _ = envs.reset()
        alone = [single.reset()[0] for single in singles]
        np.testing.assert_array_equal(observations, np.stack(alone))
        assert observations.shape == (2, 3, 26)
        actions = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 3, 2)).astype(np.float32)
        is_over = np.array([False, False])
        while not is_over.any():
            observations, rewards, _, is_over, infos = envs.step(actions)
            found = [single.step(action) for single, action in zip(singles, actions, strict=True)]
            np.testing.assert_array_equal(observations, np.stack([one[0] for one in found]))
            np.testing.assert_array_equal(rewards, [one[1] for one in found])
            np.testing.assert_array_equal(is_over, [one[3] for one in found])
            np.testing.assert_array_equal(infos["present"], [one[4]["present"] for one in found])
    finally:
        envs.close()


def test_the_row_of_a_robot_that_was_killed_is_zero() -> None:
    env = JointEnv(swarmd.env("aggregation", 4, set=SET))
    rows, info = env.reset()
    assert info["present"].tolist() == [True, True, True]
    assert rows.any(axis=1).all()
    while info["present"][1]:
        rows, _, is_terminated, _, info = env.step(np.zeros((3, 2), dtype=np.float32))
        assert not is_terminated
    assert info["present"].tolist() == [True, False, True]
    assert rows.any(axis=1).tolist() == [True, False, True]


def test_a_fault_is_raised_before_any_process_starts() -> None:
    with pytest.raises(ConfigError, match="no_such"):
        vector_env(2, "no_such")
    with pytest.raises(ConfigError, match="vector_env of 0"):
        vector_env(0, "aggregation")
    with pytest.raises(ConfigError, match="4294967296 is no seed"):
        vector_env(2, "aggregation", seed=2**32 - 1)
