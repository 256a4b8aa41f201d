"""The world as a process: `python -m swarmd.sim.live.server`, for daemons on this machine.

Prints one JSON line on standard output once drivers can connect: `endpoint` for viewers, `driver`
and `driver_options` for daemons. SIGTERM and SIGINT end it; then it writes the trace, if any.
"""

from __future__ import annotations

import argparse
import dataclasses
import gc
import json
import logging
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import FrameType

from msgspec.structs import replace

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.keys import check_id
from swarmd.core.processes import die_with_parent
from swarmd.core.values import Platform, Value
from swarmd.plugins import load_emulator
from swarmd.settings.driver_options import stops_after
from swarmd.settings.layered import Layered
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.body_transport import DRIVER, EmulatorTransport
from swarmd.sim.live.link import WorldLink
from swarmd.sim.live.realtime import RealTimeWorld
from swarmd.sim.live.recording import LiveRecorder, RecorderSettings
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.simulation import meta_of, radio_of, world_of
from swarmd.sim.world.arena import parse_arena
from swarmd.sim.world.layouts import parse_layout
from swarmd.sim.world.radio import RadioSettings, needs_radio
from swarmd.sim.world.realism import REALISMS, Realism


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a world until a signal. Exit codes: 0 ended, 1 failed, 2 invalid options."""
    options = _parser().parse_args(arguments)
    if options.die_with_parent is not None:
        die_with_parent(options.die_with_parent)
    logging.basicConfig(
        level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s"
    )
    try:
        with _stop_signals() as is_over:
            _serve(options, is_over)
    except ConfigError as error:
        print(error, file=sys.stderr)
        return 2
    except SwarmError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def parse_robots(text: str) -> dict[str, Platform]:
    """Platforms by robot id from `id:platform,id:platform`; ConfigError if invalid."""
    robots: dict[str, Platform] = {}
    loaded: dict[str, Platform] = {}
    for item in text.split(","):
        robot, colon, name = item.partition(":")
        if not colon:
            raise ConfigError(f"robots has {item!r}; expected a value such as tb3-01:waffle_pi")
        if robot in robots:
            raise ConfigError(f"robots has {robot!r} twice; every robot needs an id of its own")
        if name not in loaded:
            loaded[name] = load_platform(name)
        robots[check_id(robot, "robot id")] = loaded[name]
    return robots


@contextmanager
def _stop_signals() -> Iterator[Callable[[], bool]]:
    """Yield a function that is True after SIGTERM or SIGINT; restores the handlers at the end."""
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)

    before = {number: signal.signal(number, note) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield lambda: bool(came)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _serve(options: argparse.Namespace, is_over: Callable[[], bool]) -> None:
    swarm = check_id(options.swarm, "swarm")
    scenario = _scenario(options)
    robots = scenario.robots
    # Over ROS, a scan tells one time from each ray to the next.
    world = world_of(scenario, options.seed, sectors=10 if options.emulator is None else 100)
    meta = {**meta_of(scenario, options.seed), "swarm": swarm}
    if options.scenario is None:
        meta |= {"layout": options.layout, "realism": options.realism}
    settings = RecorderSettings(options.trace, options.trace_rate, options.seconds, meta)
    record = LiveRecorder(world, settings)
    with ExitStack() as opened:
        link = WorldLink(swarm, robots, options.endpoint)
        opened.callback(link.close)
        driver, driver_options, timeouts = DRIVER, dict[str, Value](endpoint=link.endpoint), None
        if needs_radio(scenario.radio):
            driver_options["radio"] = True
        emulated = None
        if options.emulator is not None:
            emulated = _make_emulator(options, scenario)
            opened.callback(emulated.side.close)
            driver, driver_options = options.emulator, dict(emulated.side.driver_options)
            timeouts = [
                stops_after(p.drivers.get(driver, {}), f"platform {p.name}: drivers.{driver}")
                for p in robots.values()
            ]
        ready = {"endpoint": link.endpoint, "swarm": swarm, "driver": driver}
        print(json.dumps({**ready, "driver_options": driver_options}), flush=True)
        # What is alive now stays alive; a collection would only walk through it again.
        gc.collect()
        gc.freeze()
        # Without one all robots hear each other, which daemons assume without neighbors.
        radio = radio_of(scenario, options.seed) if scenario.radio != RadioSettings() else None
        live = RealTimeWorld(
            world,
            link,
            record,
            radio=radio,
            emulated=emulated,
            command_timeouts=timeouts,
            has_shared_frame=options.shared_frame,
            seed=options.seed,
        )
        live.run(is_over)


def _make_emulator(options: argparse.Namespace, scenario: Scenario) -> EmulatorTransport:
    if scenario.radio != RadioSettings():
        raise ConfigError(
            f"--radio-range and --emulator {options.emulator}: emulated robots publish no"
            " neighbors; leave one of the two out"
        )
    factory = load_emulator(options.emulator)
    return EmulatorTransport(factory, scenario.robots, options.emulator_endpoint)


def _scenario(options: argparse.Namespace) -> Scenario:
    """The scenario of the file, or that of the options; ConfigError if it is invalid."""
    if options.scenario is None:
        return _scenario_of_options(options)
    from swarmd.sim.scenarios.scenariofile import scenario_of  # it loads the patterns

    scenario = scenario_of(json.loads(options.scenario.read_bytes()))
    if options.emulator is not None:
        scenario = dataclasses.replace(scenario, realism=_as_daemons_expect(scenario.realism))
    return scenario


def _scenario_of_options(options: argparse.Namespace) -> Scenario:
    if options.robots is None:
        raise ConfigError("robots are missing; give --robots ID:PLATFORM,... or --scenario FILE")
    robots, arena = parse_robots(options.robots), parse_arena(options.arena)
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
        layers=lambda robot, pattern: (),
        events=(),
    )


def _as_daemons_expect(realism: Realism) -> Realism:
    """The realism, with rolling scans and at least a micrometre of range noise.

    Daemons rely on the `sweep` of the platform, and take a lidar that repeats a scan for a frozen
    one.
    """
    lidar = replace(realism.lidar, rolling=True)
    if not lidar.differs_each_time:
        lidar = replace(lidar, near_sd=1e-6, far_sd=1e-6)
    return replace(realism, lidar=lidar)


def _radio_settings(options: argparse.Namespace) -> RadioSettings:
    if options.radio_range is None:
        return RadioSettings()
    asked = {"neighborhood": "range", "range": options.radio_range}
    return Layered(("--radio-range", asked)).build(RadioSettings)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m swarmd.sim.live.server",
        description="A simulated world for swarmd daemons on this machine.",
    )
    add = parser.add_argument
    add("--swarm", required=True)
    add("--robots", metavar="ID:PLATFORM,...")
    add(
        "--scenario",
        type=Path,
        metavar="FILE.json",
        help="an effective scenario; --robots, --arena, --layout and what follows are not used",
    )
    add(
        "--arena",
        default="6x6",
        help="LxW in m, then any of ,box:x:y:l:w:deg:kg ,pole:x:y:r ,segment:x1:y1:x2:y2",
    )
    add("--layout", default="grid:1.0", help="row, paper, grid, ring, random or list, with :size")
    add("--seed", type=int, default=0, help="of random layouts and of noise")
    add("--endpoint", default="tcp/127.0.0.1:7790", help="where drivers connect; port 0: any")
    add("--emulator", metavar="NAME", help="emulate the robots of this driver")
    add(
        "--emulator-endpoint",
        default="tcp/127.0.0.1:7447",
        metavar="ENDPOINT",
        help="where these drivers connect; port 0: any",
    )
    add("--lidar-visibility", choices=("body", "real"), default="body")
    add("--realism", choices=sorted(REALISMS), default="ideal")
    add("--radio-range", type=float, metavar="M", help="range of the radio between robots")
    add("--shared-frame", action="store_true", help="robots measure their poses in one frame")
    add("--trace", type=Path, metavar="FILE.npz", help="where to write the trace")
    add("--trace-rate", type=float, default=50.0, metavar="HZ")
    add("--seconds", type=float, help="of simulation to record, from the start or `start`")
    add("--die-with-parent", type=int, metavar="PID")
    return parser


if __name__ == "__main__":
    sys.exit(main())
