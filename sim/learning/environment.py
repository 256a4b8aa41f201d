"""An environment for learning: PettingZoo's parallel API over lockstep, with protection.

::

    import swarmd

    env = swarmd.env("aggregation", seed=1)
    observations, infos = env.reset()
    while env.agents:
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, rewards, terminations, truncations, infos = env.step(actions)

An action is the requested command of a pattern: the robot's state machine, holds and protection
apply as on robots.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import astuple
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, PluginError, unknown
from swarmd.core.values import Array, lacks_text
from swarmd.kit.observation import Observation, PolicySpec, check_spec, default_spec
from swarmd.sim.experiments.plan import check_seeds
from swarmd.sim.learning.agents import (
    PATTERN,
    Seat,
    agent_class,
    learners_of,
    lives_of,
    name_of,
    with_agents,
)
from swarmd.sim.learning.rewards import (
    Reward,
    Rewards,
    State,
    check_weights,
    default_reward,
)
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.contacts import ContactEpisodes

if TYPE_CHECKING:
    from swarmd.sim.learning.pictures import Pictures

try:
    from gymnasium.spaces import Box
    from pettingzoo import ParallelEnv
except ImportError as error:
    text = "environments need pettingzoo and gymnasium: pip install 'swarmd[learn]'"
    raise ImportError(text) from error

RENDER_MODES = ("rgb_array",)
_FIRST_INPUTS = 2.0  # s within which each robot has its first scan, else it starts without

Info = dict[str, Any]
Step = tuple[
    dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, Info]
]


def env(
    scenario: str | Path | Scenario,
    seed: int | None = None,
    *,
    set: Mapping[str, Any] | None = None,
    agents: str | None = None,
    spec: PolicySpec | None = None,
    reward: Reward | None = None,
    render_mode: str | None = None,
) -> SwarmEnv:
    """The environment of a scenario.

    - `seed`: the seed of the first `reset` that is called without a seed. None: a random seed.
    - `set`: overrides by dotted key of the scenario's file: `{"groups.tb3.count": 5}`.
    - `agents`: the group of the robots that learn; the robots of all other groups run their own
      pattern. None: all robots learn.
    - `spec`: observations and actions. None: `default_spec` of the platform.
    - `reward`: weights by name (metrics of the catalog, `contacts` and `limited`), or a function
      of the state (see `State`) that gives rewards by robot. None: the scenario's reward, if any.
    - `render_mode`: with "rgb_array" `render` gives pictures.

    ConfigError if an argument is invalid. PluginError for a `render_mode` without the extra plot.
    """
    if render_mode is not None and render_mode not in RENDER_MODES:
        raise ConfigError(f"render_mode: {unknown('mode', str(render_mode), RENDER_MODES)}")
    if render_mode is not None and find_spec("matplotlib") is None:
        raise PluginError("render_mode rgb_array needs matplotlib; run: pip install 'swarmd[plot]'")
    loaded = _scenario(scenario, set)
    learners = learners_of(loaded, agents)
    spec = spec or default_spec(loaded.robots[learners[0]])
    check_spec(spec)
    _check_needs(spec, loaded, learners)
    chosen_reward = default_reward(loaded.name) if reward is None else reward
    if not callable(chosen_reward):
        check_weights(chosen_reward)
    learning = with_agents(loaded, learners)
    return SwarmEnv(learning, learners, spec, chosen_reward, seed, render_mode)


def _scenario(scenario: str | Path | Scenario, overrides: Mapping[str, Any] | None) -> Scenario:
    """The scenario with overrides by dotted key."""
    if not isinstance(scenario, Scenario):
        return load_scenario(scenario, overrides, source="set")
    if overrides:
        return scenario_of(scenario.effective, overrides, source="set")
    return scenario


def _check_needs(spec: PolicySpec, scenario: Scenario, learners: Sequence[str]) -> None:
    """ConfigError if a robot that learns does not provide what the spec needs."""
    for robot in learners:
        if lack := lacks_text(spec.needs, scenario.robots[robot]):
            raise ConfigError(f"{robot}: spec {lack}; or leave these parts out")


@dataclass(slots=True)
class _Episode:
    """The state of one run."""

    swarm: Lockstep
    seats: dict[str, Seat]  # the exchange of observation and action with the pattern, by robot
    rewards: Rewards
    episodes: ContactEpisodes
    lives: dict[str, int]
    """How often each robot has joined; each time the robot is another agent."""
    contacts: NDArray[np.int64]  # (n,) contacts that began in this step
    present: dict[str, bool]  # whether a robot has a daemon
    is_over: bool = False
    pictures: Pictures | None = None
    """None before the first picture of the run."""


class SwarmEnv(ParallelEnv[str, Observation, Array]):  # type: ignore[misc]  # it has no types
    """An environment as PettingZoo's ParallelEnv; `env` makes one.

    An agent is a robot that learns, while the robot is present in the swarm. An agent appears when
    its robot joins, is terminated when its robot leaves or is killed, and is truncated at the end
    of the scenario. A robot that is stopped or held stays an agent, whose actions have no effect.
    `infos` have three keys for each agent. `state` is the state of the robot, such as `running`, or
    `absent`. `limited` is true if protection changed the request. `contacts` is the number of
    contacts that began in this step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - read only
        "name": "swarmd",
        "render_modes": list(RENDER_MODES),
        "is_parallelizable": True,
    }

    def __init__(
        self,
        scenario: Scenario,
        learners: tuple[str, ...],
        spec: PolicySpec,
        reward: Reward,
        seed: int | None,
        render_mode: str | None = None,
    ) -> None:
        """Make an environment without a run; the arguments are those of `env`, checked.

        `scenario`: its robots `learners` run the pattern that takes actions (`with_agents`).
        """
        self.scenario = scenario
        self.spec = spec
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": round(1.0 / spec.period)}
        # An agent for each time that a robot may join.
        self.possible_agents = lives_of(scenario, learners)
        self.agents: list[str] = []
        self._learners = learners
        self._reward = reward
        # The seed of the next `reset`; None: drawn by `_seeds`.
        self._next_seed = None if seed is None else check_seeds([seed])[0]
        self._seeds = np.random.default_rng(self._next_seed)
        self.seed: int | None = None
        """The seed of the run that the last `reset` began; `exp run` with it has the same start."""
        self.observation_spaces = {
            agent: Box(-1.0, 1.0, (spec.size,), np.float32) for agent in self.possible_agents
        }
        self.action_spaces = {
            agent: Box(-1.0, 1.0, (spec.actions,), np.float32) for agent in self.possible_agents
        }
        self._episode: _Episode | None = None

    def observation_space(self, agent: str) -> Box:
        """The space of an agent's observations: (spec.size,) in [-1, 1]."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """The space of an agent's actions: (spec.actions,) in [-1, 1]."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, Info]]:
        """Begin a run, and simulate until each robot has its first scan; `options` has no effect.

        Returns the observations and infos by agent. Equal seeds give equal runs, bit by bit.
        Without `seed`, a random generator draws the seed; the last given seed is the seed of this
        generator. ConfigError if there is no room for the robots.
        """
        self.seed = self._seed(seed)
        # Each learner's pattern exchanges observations and actions by a seat.
        seats = {robot: Seat(np.zeros(self.spec.actions)) for robot in self._learners}
        patterns = {PATTERN: agent_class(self.spec, seats)}
        swarm = Lockstep(self.scenario, self.seed, patterns=patterns)
        self.close()  # not before the new run exists: after a ConfigError the old run goes on
        present_robots = [robot for robot in self._learners if robot not in self.scenario.absent]
        # The first life of a robot that is present now has begun; that of an absent robot has not.
        lives = {robot: 1 if robot in present_robots else 0 for robot in self._learners}
        self._episode = _Episode(
            swarm=swarm,
            seats=seats,
            rewards=Rewards(self._reward, self.scenario, self.seed, swarm.world),
            episodes=ContactEpisodes(),
            lives=lives,
            contacts=np.zeros(len(swarm.world.ids), dtype=np.int64),
            present={robot: robot in present_robots for robot in self._learners},
        )
        self._await_inputs(swarm, [seats[robot] for robot in present_robots])
        self._episode.contacts[:] = 0  # contacts while inputs were awaited belong to no step
        # The agent of a robot's first life has the robot's name.
        self.agents = [robot for robot in self._learners if self._episode.lives[robot]]
        state = self._state(0.0)
        self._episode.rewards.begin(state)
        infos = self._infos(state, self.agents)
        return {agent: self._observed(agent) for agent in self.agents}, infos

    def _seed(self, given: int | None) -> int:
        """The seed of the next run: given, else that of the constructor once, else drawn."""
        if given is not None:
            self._next_seed = check_seeds([given])[0]
            self._seeds = np.random.default_rng(self._next_seed)
        seed = self._next_seed
        self._next_seed = None
        return int(self._seeds.integers(2**31)) if seed is None else seed

    def _await_inputs(self, swarm: Lockstep, seats: Sequence[Seat]) -> None:
        """Simulate until each seat has inputs, for _FIRST_INPUTS s at most.

        At least a period before the end of the scenario is left, so that a step is possible.
        """
        deadline = min(_FIRST_INPUTS, self.scenario.duration - self.spec.period)
        while swarm.world.time < deadline and any(seat.inputs is None for seat in seats):
            self._advance(swarm.world.dt)

    def step(self, actions: dict[str, Array]) -> Step:
        """Apply the actions by agent, and simulate one period of the spec.

        An agent without an action repeats its last action. The action of an absent agent has no
        effect. Returns observations, rewards, terminations, truncations and infos of all agents
        that were present before or after the step. ConfigError, without any effect, before the
        first `reset`, after the end of a run, for an unknown agent, and for an action that is not
        (spec.actions,) finite numbers.
        """
        episode = self._running()
        if episode.is_over:
            raise ConfigError("the run is over; call reset for the next one")
        self._set_actions(episode, actions)
        agents_before = list(self.agents)
        start = episode.swarm.world.time
        episode.contacts[:] = 0
        self._advance(self.spec.period)
        end = episode.swarm.world.time
        # The end of the scenario, to the nearest whole period.
        episode.is_over = end > self.scenario.duration - 0.5 * self.spec.period
        present_robots = [robot for robot, is_present in episode.present.items() if is_present]
        agents_after = [name_of(robot, episode.lives[robot]) for robot in present_robots]
        joined = [agent for agent in agents_after if agent not in agents_before]
        # The results are those of all agents that were present before or after the step.
        agents = [*agents_before, *joined]
        state = self._state(end - start)
        robot_rewards = episode.rewards.of(state)
        rewards = dict.fromkeys(agents, 0.0)  # an agent that has just joined gets none
        rewards |= {agent: robot_rewards.get(_robot_of(agent), 0.0) for agent in agents_before}
        terminations = {agent: agent not in agents_after for agent in agents}
        truncations = {agent: episode.is_over and not terminations[agent] for agent in agents}
        self.agents = [] if episode.is_over else agents_after
        observations = {agent: self._observed(agent) for agent in agents}
        return observations, rewards, terminations, truncations, self._infos(state, agents)

    def _set_actions(self, episode: _Episode, actions: Mapping[str, Array]) -> None:
        """Set the actions of present agents; ConfigError, before any is set, if one is invalid."""
        if strange := sorted({*map(str, actions)} - {*self.possible_agents}):
            raise ConfigError(f"actions: {unknown('agent', strange[0], self.possible_agents)}")
        present = {agent: action for agent, action in actions.items() if agent in self.agents}
        checked = {agent: self._checked(agent, action) for agent, action in present.items()}
        for agent, action in checked.items():
            episode.seats[_robot_of(agent)].action = action

    def trace(self) -> Trace:
        """The trace of the run up to now, as `exp run` keeps it: metrics and plots take it."""
        return self._running().swarm.trace()

    def render(self) -> NDArray[np.uint8]:
        """The present state from above, as films show it: (480, 640, 3) uint8.

        ConfigError before the first `reset`, or without a `render_mode`.
        """
        if self.render_mode is None:
            raise ConfigError(
                "render needs a mode; make the environment with render_mode='rgb_array'"
            )
        episode = self._running()
        if episode.pictures is None:
            # Imported here: training loads no library for drawing.
            from swarmd.sim.learning.pictures import Pictures

            episode.pictures = Pictures(episode.swarm)
        return episode.pictures.picture()

    def close(self) -> None:
        """Discard the run."""
        self._episode = None
        self.agents = []

    def _running(self) -> _Episode:
        if self._episode is None:
            raise ConfigError("the environment has no run; call reset first")
        return self._episode

    def _advance(self, seconds: float) -> None:
        episode = self._running()
        world = episode.swarm.world

        def count(now: float) -> None:
            self._follow_daemons()
            for contact in world.contacts():
                if episode.episodes.add(now, contact.a, contact.b):
                    for name in (contact.a, contact.b):
                        if name in self.scenario.robots:
                            episode.contacts[world.ids.index(name)] += 1

        episode.swarm.advance(seconds, count)

    def _follow_daemons(self) -> None:
        """Update `present` and `lives`; clear the seats of robots that have left."""
        episode = self._running()
        swarm = episode.swarm
        for robot, has_daemon in zip(swarm.world.ids, swarm.has_daemon, strict=True):
            is_learner = robot in episode.present
            if not is_learner or episode.present[robot] == has_daemon:
                continue
            episode.present[robot] = has_daemon
            if has_daemon:
                episode.lives[robot] += 1
            else:
                episode.seats[robot].leave()

    def _observed(self, agent: str) -> Observation:
        """The observation from the newest inputs; zeros before an agent has any."""
        seat = self._running().seats[_robot_of(agent)]
        if seat.pattern is None or seat.inputs is None:
            return np.zeros(self.spec.size, dtype=np.float32)
        return seat.pattern.observed(seat.inputs)

    def _checked(self, agent: str, action: Array) -> Array:
        try:
            numbers = np.array(action, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (self.spec.actions,) or not np.isfinite(numbers).all():
            wanted = f"{self.spec.actions} finite numbers in [-1, 1]"
            raise ConfigError(f"the action of {agent} is {action!r}; expected {wanted}")
        return numbers

    def _state(self, period: float) -> State:
        swarm = self._running().swarm
        episode = self._running()
        n = len(swarm.world.ids)
        requested = np.zeros((n, 3))
        limited = np.zeros(n, dtype=np.bool_)
        for row, shell in enumerate(swarm.shells):
            if shell is not None:
                decision = shell.robot.decision
                requested[row] = astuple(decision.requested)
                limited[row] = decision.is_active
        return State(
            tuple(swarm.world.ids),
            swarm.world.time,
            period,
            swarm.world.poses().copy(),
            requested,
            swarm.commands.copy(),
            np.array(swarm.has_daemon),
            limited,
            episode.contacts.copy(),
        )

    def _infos(self, state: State, agents: list[str]) -> dict[str, Info]:
        swarm = self._running().swarm
        rows = {robot: i for i, robot in enumerate(state.ids)}
        infos = {}
        for agent in agents:
            row = rows[_robot_of(agent)]
            shell = swarm.shells[row]
            infos[agent] = {
                "state": "absent" if shell is None else str(shell.robot.state),
                "limited": bool(state.limited[row]),
                "contacts": int(state.contacts[row]),
            }
        return infos


def _robot_of(agent: str) -> str:
    return agent.partition("#")[0]
