"""A simulated swarm that a Python program starts: a world and a daemon for each robot.

::

    import swarmd

    with swarmd.demo(robots=5) as demo, demo.connect() as swarm:
        swarm.run("attraction", seconds=10)
        swarm.wait("state=idle")
"""

from __future__ import annotations

import logging
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from swarmd.core.closing import Closing
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.keys import check_id
from swarmd.core.numbers import python_value
from swarmd.link.settings import NetworkSettings
from swarmd.operator.client.connect import Connection
from swarmd.operator.session.operator import Operator
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.sim.live.fleet import Fleet, FleetSpec
    from swarmd.sim.live.link import WorldView


class SimulatedSwarm(Closing):
    """A world and daemons, whose processes run in a `with` block or from `start` to `close`.

    `name`: the name of the swarm, which `swarmctl --swarm NAME` commands, too.
    """

    def __init__(self, make_spec: Callable[[Path], FleetSpec], name: str) -> None:
        self.name = name
        self._make_spec = make_spec
        self._left = ExitStack()
        self._fleet: Fleet | None = None
        self._world: WorldView | None = None

    def __enter__(self) -> Self:
        return self.start()

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots whose daemons were started."""
        return () if self._fleet is None else self._fleet.robots

    def start(self) -> Self:
        """Start the world and the daemons; returns once all robots are up, after about 2 s.

        Call `start` from the main thread, since the processes end with the thread that started
        them. If a process ends during the start, all processes are ended, and SwarmError names the
        log of the process.
        """
        from swarmd.sim.live.fleet import Fleet
        from swarmd.sim.live.link import WorldView
        from swarmd.sim.live.starting import await_robots

        if self._fleet is not None:
            raise ConfigError(f"the demo {self.name!r} runs already")
        with ExitStack() as opened, self._operator() as operator:
            spec = self._make_spec(opened.enter_context(kept_folder(None)))
            check_free(operator, spec, "demo(swarm=NAME)")
            fleet = opened.enter_context(Fleet(spec))
            world = opened.enter_context(WorldView(self.name, fleet.endpoint))
            await_robots(operator, fleet)
            self._world = world
            self._fleet = fleet
            self._left = opened.pop_all()
        return self

    def close(self) -> None:
        """End all processes, within 4 s."""
        self._fleet = None
        self._world = None
        self._left.close()

    def connect(
        self, *, timeout: float | None = None, tell: Callable[[str], object] | None = None
    ) -> Connection:
        """A connection as of `swarmd.connect`, whose maps show true positions."""
        return Connection(lambda _: self._operator(), timeout=timeout, tell=tell, places=self.poses)

    def poses(self) -> dict[str, tuple[float, float, float]]:
        """The true pose of each robot in the world: x and y in m, yaw in rad."""
        if self._world is None:
            raise SwarmError("the demo has not started, or has ended")
        state = self._world.ask("poses").state
        return dict(zip(state.ids, state.poses, strict=True))

    def _operator(self) -> Operator:

        return Operator(NetworkSettings(swarm=self.name))


def demo(
    scenario: str | Path | None = None,
    *,
    robots: int = 7,
    platform: str = "waffle_pi",
    arena: str | None = None,
    layout: str | None = None,
    seed: int = 0,
    realism: Literal["realistic", "ideal"] = "realistic",
    lidar_visibility: Literal["body", "real"] = "body",
    radio_range: float | None = None,
    plugin_dir: str | Path | None = None,
    set: Mapping[str, Any] | None = None,
    swarm: str | None = None,
) -> SimulatedSwarm:
    """A simulated swarm on this machine for a `with` block; the robots start idle.

    The parameters are those of `swarmctl sim up`.

    - `scenario`: a name of `swarmctl exp list`, or a YAML file. A scenario replaces all parameters
      from `robots` to `plugin_dir` except for `seed`.
    - `set`: overrides of the scenario by dotted key.
    - `swarm`: the name of the swarm; None: a new name.

    ConfigError for a wrong value. Most values are checked when the swarm starts. PluginError
    without MuJoCo (`pip install 'swarmd[sim]'`).
    """
    from swarmd.sim.live.fleet_spec import MAX_ROBOTS, plain_fleet, scenario_fleet

    need("mujoco", extra="sim")
    name = check_id(f"demo-{secrets.token_hex(3)}" if swarm is None else swarm, "swarm")
    tell = logging.getLogger("swarmd.client").info
    robots, seed, radio_range = python_value([robots, seed, radio_range])
    if not isinstance(robots, int) or not 1 <= robots <= MAX_ROBOTS:
        raise ConfigError(f"robots is {robots!r}; expected 1 to {MAX_ROBOTS}")

    def make_spec(folder: Path) -> FleetSpec:
        if scenario is not None:
            overrides = dict(set or {})
            return scenario_fleet(
                name, folder, str(scenario), overrides, seed=seed, emulator=None, tell=tell
            )
        if set:
            raise ConfigError(f"set has {next(iter(set))}: there is no scenario that it changes")
        return plain_fleet(
            name,
            folder,
            count=robots,
            platform=platform,
            arena=arena,
            layout=layout,
            emulator=None,
            tell=tell,
            seed=seed,
            realism=realism,
            lidar_visibility=lidar_visibility,
            radio_range=radio_range,
            plugin_dir=None if plugin_dir is None else Path(plugin_dir),
        )

    return SimulatedSwarm(make_spec, name)


def check_free(operator: Operator, spec: FleetSpec, how: str) -> None:
    """ConfigError if robots of these names are alive; the message says `how` to name a swarm."""
    taken = sorted(frozenset(operator.members().alive) & frozenset(spec.robots))
    if taken:
        raise ConfigError(
            f"swarm {spec.swarm!r} already has {', '.join(taken)};"
            f" end those, or use another swarm: {how}"
        )


@contextmanager
def kept_folder(keep: Path | None) -> Iterator[Path]:
    """Yield the folder for logs and state: `keep`, or for None a temporary folder.

    The temporary folder is removed at the end, except after a SwarmError, for its logs.
    """
    if keep is not None:
        yield keep
        return
    folder = Path(tempfile.mkdtemp(prefix="swarmd-sim-"))
    has_logs_of_failure = False
    try:
        yield folder
    except SwarmError:
        has_logs_of_failure = any(folder.iterdir())
        raise
    finally:
        if not has_logs_of_failure:
            shutil.rmtree(folder, ignore_errors=True)
