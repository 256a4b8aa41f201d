"""Seven live daemons, obstacles that appear ahead of them, and a simulated robot that rams them.

Walls and poles appear ahead of moving robots, never nearer than the distance in which a robot can
detect them and stop (`hazards.room`). One more simulated robot, without a daemon, drives into one
robot after the other, at the speed that protection assumes of others. Only MuJoCo's contacts, from
the world's trace, are evaluated.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.latency import FULL_GOAL, REFLEX_GOAL, Stamps, between, read_stamps, row
from benchmarks.swarm import Swarm
from benchmarks.table import Row, print_table
from studies.safety.driven import faults
from studies.safety.hazards import OBSTACLES, ObstaclePlacer, Rammer, room
from studies.safety.judge import FAULT, Collision, collisions
from studies.safety.scenes import KINDS, VISIBILITIES
from swarmd.core.errors import SwarmError
from swarmd.core.values import Platform
from swarmd.driver_api.hw_codec import encode_command
from swarmd.link.carriers.robot_link import Connection, Hello, dial, read_endpoint
from swarmd.settings.platforms import load_platform
from swarmd.settings.yamlfile import text_of
from swarmd.sim.live.demo_run import WorldWatcher
from swarmd.sim.live.link import WorldView
from swarmd.sim.trace import Trace, load_trace
from swarmd.sim.world.arena import Arena
from swarmd.sim.world.geometry import gaps, radius, transform

ROBOTS = 7
SECONDS = 120.0  # of simulation
RAMMER = "rammer"

_NEWEST = 2**52  # commands that depend on no scan and are never replaced by one that does
_WALK = {"clearance": 0.0, "straight_min": 3.0, "straight_max": 8.0}  # only protection looks
_THROWN, _INSTANT = 0.3, 0.02  # s after a contact, and between two instants of a trace
_OFTEN = 5  # gaps are evaluated at every fifth instant


@dataclass(frozen=True, slots=True, kw_only=True)
class CourseResult:
    """The result of a course: obstacles that appeared, the trace, stamps, and its span in ns."""

    robots: tuple[str, ...]
    others_speed: float
    appeared: int
    trace: Trace
    stamps: Stamps
    span: tuple[int, int]

    def collisions(self) -> list[Collision]:
        """Every collision of a robot with a daemon, with the closing speed of its own surface."""
        return collisions(self.trace, unprotected=(RAMMER,))

    def faults(self) -> list[Collision]:
        """The collisions in which such a robot drove into the other and was not pushed."""
        return list(faults(self.trace, unprotected=(RAMMER,)))

    def ram_speeds(self) -> list[float]:
        """The true speed in m/s of the ramming robot's fastest corner at instants without contact.

        Instants shortly after a contact are left out: the contact may still move it.
        """
        trace = self.trace
        robot = trace.ids.index(RAMMER)
        corners = transform(trace.footprint(robot), trace.pose[:, robot])
        moved = np.linalg.norm(np.diff(corners, axis=0), axis=-1).max(axis=1)
        touched = trace.contact_t[(trace.contact_pair == robot).any(axis=1)]
        since = trace.t[1:, None] - touched
        is_thrown = ((since > -_INSTANT) & (since < _THROWN)).any(axis=1)
        speeds = moved / np.diff(trace.t)
        return [float(speed) for speed in speeds[~is_thrown]]

    def nearest(self) -> float:
        """The least distance in m between robots that have a daemon and what appeared."""
        trace = self.trace
        if trace.box_pose is None or trace.box_shapes is None:
            return math.inf
        poses = trace.pose[::_OFTEN, : len(self.robots), None]
        robots = transform(trace.footprint(0), poses)
        boxes = transform(trace.box_shapes, trace.box_pose[::_OFTEN, None])
        is_there = np.isfinite(boxes[:, 0, :, 0, 0])
        apart = [gaps(robots[:, :, 0], boxes[:, :, box]) for box in range(len(trace.movable_boxes))]
        found = [some[is_there[:, box]] for box, some in enumerate(apart)]
        return min((float(some.min()) for some in found if some.size), default=math.inf)


def is_ram(touch: Collision) -> bool:
    """Whether the ramming robot is one of the two."""
    return RAMMER in (touch.a, touch.b)


def run_course(
    platform: str,
    mode: str,
    seconds: float,
    *,
    visibility: str = "body",
    seed: int = 1,
    robots: int = ROBOTS,
    appeared: float = math.inf,
    touches: int = 0,
) -> CourseResult:
    """Let robots walk at random among the hazards for at most `seconds` of simulated time.

    `mode` of protection. The course ends earlier after `appeared` obstacles and `touches` contacts.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        protected = _variant(folder / f"{platform}.yaml", platform, protection={"mode": mode})
        body = load_platform(protected)
        speed = float(body.protection["barrier"]["others_speed"])
        rammer = Rammer(speed, radius(body.footprint))
        obstacles = ObstaclePlacer(body, robots, seed)
        trace = folder / "trace.npz"
        options = {"seed": seed, "realism": "realistic", "trace": str(trace)}
        options |= {"lidar_visibility": visibility, **_space(body, robots + 1)}
        fast = _variant(folder / f"{RAMMER}.yaml", platform, limits={"linear": speed})
        with (
            Swarm(robots, protected, others={RAMMER: fast}, world=options) as swarm,
            WorldView(swarm.name, swarm.endpoint) as world,
            _steering(swarm) as steering,
        ):
            watch = WorldWatcher(world)
            swarm.run("random_walk", **_WALK)
            state = world.ask("start").state
            began, end = time.monotonic_ns(), state.time + seconds
            count = 0
            while state.time < end and (count < appeared or state.contacts < touches):
                state = watch.wait(since=state.time)
                twist = rammer.command(state, state.ids.index(RAMMER))
                steering.send("cmd_vel", encode_command(twist, _NEWEST, _NEWEST))
                chosen = obstacles.next(state)
                with contextlib.suppress(SwarmError):  # a wall or another thing is there
                    if chosen is not None:
                        world.place(*chosen)
                        count += 1
            span = began, time.monotonic_ns() - 100_000_000
            world.ask("finish")
            swarm.close()
            return CourseResult(
                robots=swarm.robots,
                others_speed=speed,
                appeared=count,
                trace=load_trace(trace),
                stamps=_of(swarm.robots, read_stamps(swarm)),
                span=span,
            )


@contextlib.contextmanager
def busy(cores: int) -> Iterator[None]:
    """Keep that many cores busy with other work, which ends with this process."""
    work = f"import os\nwhile os.getppid() == {os.getpid()}: sum(range(100000))"
    workers = [subprocess.Popen([sys.executable, "-c", work]) for _ in range(cores)]
    try:
        yield
    finally:
        for worker in workers:
            worker.kill()
            worker.wait()


@contextlib.contextmanager
def _steering(swarm: Swarm) -> Iterator[Connection]:
    """A link to the simulated robot RAMMER."""
    where = read_endpoint(str(swarm.driver_options["endpoint"]), "")
    link = dial(where, Hello(swarm.name, RAMMER, listens=False), timeout=10.0)
    assert link is not None
    try:
        yield link
    finally:
        link.close()


def _variant(path: Path, platform: str, **sections: Mapping[str, str | float]) -> str:
    """Write a platform file that extends `platform` with `sections`; its path."""
    path.write_text(text_of({"extends": platform, **sections}))
    return str(path)


def _space(platform: Platform, count: int) -> dict[str, str]:
    """The world's options: an arena with enough room for `count` robots, and for things."""
    grid = 2.0 * room(platform) + radius(platform.footprint)
    side = math.ceil(grid * math.sqrt(count) + 1.0)
    movable_boxes = tuple(OBSTACLES.values())
    return {"arena": Arena(side, side, movable_boxes).text, "layout": f"grid:{grid:.2f}"}


def _of(robots: Sequence[str], stamps: Stamps) -> Stamps:
    """The stamps without those of simulated robots that have no daemon."""
    put = {key: at for key, at in stamps.put.items() if key[0] in robots}
    return Stamps(put, stamps.safe_back, stamps.requested_back)


def _course(platform: str, options: argparse.Namespace) -> Iterator[Row]:
    kind = {"visibility": options.visibility, "seed": options.seed}
    result = run_course(platform, options.mode, options.seconds, **kind)
    if options.traces is not None:
        result.trace.save(options.traces / f"{platform}-{options.visibility}-{options.seed}.npz")
    for fault in result.faults():
        print(fault.text)
    yield from rows(platform, result)


def rows(platform: str, result: CourseResult) -> Iterator[Row]:
    """One platform's course: how fast robots drove into something, and latency meanwhile."""
    count = len(result.robots)
    note = f"in {result.trace.duration * count / 60.0:.0f} robot-minutes"
    yield _speeds(f"{platform}: own speed when rammed", result, True, note)
    note = f"of {result.appeared} things none nearer than {result.nearest():.2f} m"
    yield _speeds(f"{platform}: own speed at other contacts", result, False, note)
    note = f"it commands {result.others_speed:g} m/s"
    what = f"{platform}: ramming robot's fastest corner"
    yield Row(what, result.ram_speeds(), note=note, unit="m/s")
    stamps, span = result.stamps, result.span
    reflex = between(stamps.put, stamps.safe_back, span)
    yield row(f"{platform}: reflex, {count} live daemons", REFLEX_GOAL, reflex)
    full = between(stamps.put, stamps.requested_back, span)
    yield row(f"{platform}: full, {count} live daemons", FULL_GOAL, full)


def _speeds(what: str, result: CourseResult, is_by_rammer: bool, note: str) -> Row:
    touches = [one for one in result.collisions() if is_ram(one) is is_by_rammer]
    driven = [one for one in result.faults() if is_ram(one) is is_by_rammer]
    hits = sum(one.is_hit for one in driven)
    thrown = sum(one.is_fault for one in touches) - len(driven)
    note = (
        f"{len(driven)} at fault (above {FAULT:g} m/s), {hits} from the first;"
        f" {thrown} only thrown; {note}"
    )
    return Row(what, [one.own_speed for one in touches], note=note, unit="m/s")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.safety.live", description=__doc__)
    parser.add_argument("platforms", nargs="*", default=KINDS, help=f"[{' '.join(KINDS)}]")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each course [120]")
    parser.add_argument("--mode", default="barrier", help="of protection [barrier]")
    parser.add_argument("--visibility", choices=VISIBILITIES, default="body", help="[body]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--load", type=int, default=0, help="cores kept busy by other work [0]")
    parser.add_argument("--traces", type=Path, metavar="DIR", help="where traces are kept")
    options = parser.parse_args(arguments)
    if options.traces is not None:
        options.traces.mkdir(parents=True, exist_ok=True)
    for platform in options.platforms:
        title = f"{platform} live, mode {options.mode}, lidar visibility {options.visibility}"
        with busy(options.load):
            print_table(f"{title}, {options.load} busy cores", _course(platform, options))


if __name__ == "__main__":
    try:
        main()
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
