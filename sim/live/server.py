"""The world as a process: `python -m swarmd.sim.live.server JSON`, for daemons on this machine.

Prints one JSON line on standard output once drivers can connect: `endpoint` for viewers, `driver`
and `driver_options` for daemons. SIGTERM and SIGINT end the process, which then writes the trace,
if any.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import logging
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path

from msgspec import DecodeError, json
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.keys import check_id
from swarmd.core.processes import die_with_parent, noted_signals
from swarmd.core.values import Value
from swarmd.plugins import load_emulator
from swarmd.settings.driver_options import stops_after
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import DRIVER, EmulatorTransport, WorldLink
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.simulation import has_live_radio, meta_of, radio_of, world_of
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.radio import RadioSettings
from swarmd.sim.world.realism import REALISMS, Realism


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a world until a signal. Exit codes: 0 ended, 1 failed, 2 invalid options."""
    parser = argparse.ArgumentParser(prog="python -m swarmd.sim.live.server")
    parser.add_argument("options", metavar="JSON", help="WorldOptions of swarmd.sim.live.state")
    parser.add_argument("--die-with-parent", type=int, metavar="PID")
    given = parser.parse_args(arguments)
    if given.die_with_parent is not None:
        die_with_parent(given.die_with_parent)
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s"
    )
    try:
        with noted_signals(signal.SIGTERM, signal.SIGINT) as signals:
            _serve(_read_options(given.options), lambda: bool(signals))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except SwarmError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _read_options(text: str) -> WorldOptions:
    try:
        return json.decode(text, type=WorldOptions)
    except DecodeError as error:
        raise ConfigError(f"options of the world: {error}") from error


def _serve(options: WorldOptions, is_over: Callable[[], bool]) -> None:
    """Run the world of `options` in real time until `is_over`, then write the trace, if any.

    Prints one JSON line once daemons and viewers can connect.
    """
    # 1. The world and its recorder.
    swarm = check_id(options.swarm, "swarm")
    scenario = _scenario(options)
    # All rays of a sector of a simulated scan are measured at one time. A ROS message has one
    # `time_increment` from ray to ray, so for ROS the sectors must be small.
    world = world_of(scenario, options.seed, sectors=10 if options.emulator is None else 100)
    if options.shared_frame or any(one.layers for one in scenario.settings.values()):
        world.posed = frozenset(range(len(world.ids)))  # all robots get their poses in the world
    recorder = LiveRecorder(world, options, _meta(options, scenario))

    with ExitStack() as exit_stack:
        # 2. The link to daemons and viewers.
        link = WorldLink(swarm, scenario.robots, options.endpoint)
        exit_stack.callback(link.close)
        side = _driver_side(options, scenario, link, exit_stack)
        ready = {"endpoint": link.viewers, "swarm": swarm, "driver": side.driver}
        print(json.encode({**ready, "driver_options": side.options}).decode(), flush=True)

        # 3. The loop. Garbage collections skip the objects of the set-up, which stay alive.
        gc.collect()
        gc.freeze()
        # The default settings of the radio mean that all robots hear each other. The world then
        # simulates no radio and publishes no neighbors, and daemons assume the same. Any other
        # setting, also range and bearing, needs the radio, which gives the neighbors.
        has_radio = scenario.radio != RadioSettings() or has_live_radio(scenario)
        live = RealTimeWorld(
            world,
            link,
            recorder,
            radio=radio_of(scenario, options.seed) if has_radio else None,
            emulated=side.emulated,
            command_timeouts=side.command_timeouts,
            seed=options.seed,
        )
        live.run(is_over)


def _meta(options: WorldOptions, scenario: Scenario) -> Mapping[str, object]:
    """What the trace holds of the world."""
    meta = {**meta_of(scenario, options.seed), "swarm": options.swarm}
    plain = {"layout": options.layout, "realism": options.realism}
    return meta if options.scenario is not None else meta | plain


@dataclasses.dataclass(frozen=True, slots=True)
class _DriverSide:
    """How daemons reach the bases: the driver of the daemons and its options."""

    driver: str
    options: Mapping[str, Value]
    emulated: EmulatorTransport | None = None  # of an emulated ROS robot
    command_timeouts: Sequence[float] | None = None
    """By robot, s without a command after which its base stops; None: COMMAND_TIMEOUT for all."""


def _driver_side(
    options: WorldOptions, scenario: Scenario, link: WorldLink, exit_stack: ExitStack
) -> _DriverSide:
    """The driver `simulated` at the endpoint of `link`, or the driver that the world emulates.

    `exit_stack` closes the emulator.
    """
    if options.emulator is None:
        driver_options: dict[str, Value] = {"endpoint": link.endpoint}
        if has_live_radio(scenario):  # messages of patterns pass the world, not Zenoh
            driver_options["radio"] = True
        return _DriverSide(DRIVER, driver_options)
    driver = options.emulator
    emulated = _make_emulator(driver, options.emulator_endpoint, scenario)
    exit_stack.callback(emulated.side.close)
    command_timeouts = [
        stops_after(p.drivers.get(driver, {}), f"platform {p.name}: drivers.{driver}")
        for p in scenario.robots.values()
    ]
    return _DriverSide(driver, dict(emulated.side.driver_options), emulated, command_timeouts)


def _make_emulator(name: str, endpoint: str, scenario: Scenario) -> EmulatorTransport:
    if scenario.radio != RadioSettings():
        raise ConfigError(
            f"radio_range and emulator {name}: emulated robots publish no"
            " neighbors; leave one of the two out"
        )
    return EmulatorTransport(load_emulator(name), scenario.robots, endpoint)


def _scenario(options: WorldOptions) -> Scenario:
    """The scenario of the file, or that of the options; ConfigError if it is invalid."""
    if options.scenario is None:
        return _scenario_of_options(options)
    from swarmd.sim.scenarios.scenariofile import scenario_of  # it loads the patterns

    scenario = scenario_of(json.decode(Path(options.scenario).read_bytes()))
    if options.emulator is not None:
        scenario = dataclasses.replace(scenario, realism=_as_daemons_expect(scenario.realism))
    return scenario


def _scenario_of_options(options: WorldOptions) -> Scenario:
    if not options.robots:
        raise ConfigError("the world has no robots and no scenario; give one of them")
    kinds = {name: load_platform(name) for name in options.robots.values()}
    robots = {check_id(i, "robot id"): kinds[name] for i, name in options.robots.items()}
    arena = parse_arena(options.arena)
    footprints = [platform.footprint for platform in robots.values()]
    starts = parse_layout(options.layout, footprints, arena, seed=options.seed)
    return Scenario(
        name="",
        description="",
        duration=options.seconds or 0.0,
        robots=robots,
        groups={},
        starts=lambda seed: starts,
        arena=arena,
        fields=(),
        realism=_as_daemons_expect(REALISMS[options.realism]),
        visibility=options.lidar_visibility,
        radio=_radio_settings(options),
        events=(),
    )


def _as_daemons_expect(realism: Realism) -> Realism:
    """The realism, with rolling scans and at least a micrometre of range noise.

    Daemons rely on the `sweep` of the platform, and take a lidar that repeats a scan for frozen.
    """
    lidar = replace(realism.lidar, rolling=True)
    if not lidar.differs_each_time:
        lidar = replace(lidar, near_sd=1e-6, far_sd=1e-6)
    return replace(realism, lidar=lidar)


def _radio_settings(options: WorldOptions) -> RadioSettings:
    if options.radio_range is None:
        return RadioSettings()
    asked = {"neighborhood": "range", "range": options.radio_range}
    return Layered(("radio_range", asked)).build(RadioSettings)


if __name__ == "__main__":
    sys.exit(main())
