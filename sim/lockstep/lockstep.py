"""Lockstep: a whole swarm in one process, as fast as the processor goes, the same bits each time.

The same `World` and the same `Robot` as with live daemons; patterns run inline, messages go through
the radio model. Nothing sleeps, nothing reads a clock, and every random number comes from the seed.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from swarmd.core.codec import decode_value, encode_value
from swarmd.core.errors import CodecError
from swarmd.core.messages import Latch, Status
from swarmd.core.values import Array, Platform, Scan, Twist, Value
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.robot.latches import LatchRecord
from swarmd.robot.robot import TICK, Robot
from swarmd.robot.status import RobotSettings
from swarmd.sim.lockstep.recorder import LockstepRecorder
from swarmd.sim.lockstep.schedules import Alarms, Schedules
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.lockstep.timeline import Timeline
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.trace import Trace
from swarmd.sim.world.delay_queue import DelayQueue
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.odometer import ODOMETRY_RATE
from swarmd.sim.world.radio import NEIGHBORS_RATE, Radio
from swarmd.sim.world.realism import Realism
from swarmd.sim.world.scalar_fields import READINGS_RATE
from swarmd.sim.world.seeding import generator
from swarmd.sim.world.world import World

BASE_TIMEOUT = 0.5
"""Seconds after which a base whose daemon is gone stops by itself."""


def simulate_run(
    scenario: Scenario, seed: int, on_progress: Callable[[float], None] | None = None
) -> Trace:
    """A whole run. SwarmError if it cannot be set up or a robot refuses what it is asked.

    `on_progress` is called after every step with the share that is done, at last with 1.
    """
    report = on_progress or _ignore
    run, duration = Lockstep(scenario, seed), scenario.duration

    def on_step(now: float) -> None:
        report(min(now / duration, 0.99))

    share = 0.0
    while share < 1.0:
        share = min(share + 0.02, 1.0)
        run.advance(share * duration - run.world.time, on_step)
    report(1.0)
    return run.trace()


class Lockstep:
    """A swarm that goes on for as long as `advance` is told."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        self.scenario, self.seed = scenario, seed
        self.world = World(
            scenario.robots,
            scenario.arena,
            scenario.starts(seed),
            visibility=scenario.visibility,
            realism=scenario.realism,
            fields=scenario.fields,
            seed=seed,
        )
        self._platforms = [_as_sensing(p, scenario.realism) for p in self.world.platforms]
        ids, n = self.world.ids, len(self.world.ids)
        origins = pattern_names(scenario.plugin_dir)
        self._find = PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})
        self._radio = Radio(scenario.radio, ids, scenario.arena, seed=seed)
        phases = np.array([generator(seed, "phase", robot).random() for robot in ids])
        self._scans_due = Schedules(np.array([p.scan.rate for p in self.world.platforms]), phases)
        self._ticks = Schedules(np.full(n, 1.0 / TICK), phases)
        self._odometry_due = Schedules(np.array([ODOMETRY_RATE]))
        self._neighbors_due = Schedules(np.full(n, NEIGHBORS_RATE), phases)
        readers = n if scenario.fields else 0
        self._readings_due = Schedules(np.full(readers, READINGS_RATE), phases[:readers])
        self._record_due = Schedules(np.array([scenario.trace_rate]))
        self._alarms = Alarms(n, self.world.dt)
        self._scans_in_transit: DelayQueue[tuple[int, Scan]] = DelayQueue()
        self._commands = np.zeros((n, 3))
        self._silent_at: dict[int, float] = {}
        self._latches: dict[int, LatchRecord | None] = {}
        self._new_latches: list[tuple[int, dict[str, Latch]]] = []
        self._peer_latches: dict[int, dict[str, Latch]] = {}
        self._boots = [0] * n
        self._steps = 0
        self.shells: list[RobotShell | None] = [None] * n
        self._away = n
        for row, robot in enumerate(ids):
            if robot not in scenario.absent:
                self.start(row)
        self._timeline = Timeline(scenario.events, self)
        self._recorder = LockstepRecorder(self.world)

    # What a scenario does with daemons

    def start(self, row: int) -> None:
        """A daemon starts on robot `row`; latches that an earlier life wrote down hold it."""
        now, robot_id = self.world.time, self.world.ids[row]
        layers = self.scenario.layers
        labels = tuple(name for name, ids in self.scenario.groups.items() if robot_id in ids)
        settings = RobotSettings(
            driver="lockstep",
            layers=lambda p: layers(robot_id, p),
            labels=labels,
            touch=self.scenario.touch.get(robot_id, {}),
        )
        robot = Robot(
            robot_id,
            self._platforms[row],
            settings,
            seed=self.seed,
            instance=f"lockstep-{self._boots[row]}",
            now=now,
            latches=self._latches.get(row),
        )
        self._boots[row] += 1
        self._silent_at.pop(row, None)
        self._away -= 1
        shell = self.shells[row] = RobotShell(row, robot, self._find, self, now)
        for latches in list(self._peer_latches.values()):  # before it takes any request
            shell.settle(robot.on_latches(latches, now), now)
        self._update_neighbors(row)

    def end(self, row: int, *, in_order: bool) -> None:
        """The daemon of robot `row` ends; if it is killed, its base stops by its own timeout."""
        shell, now = self.shells[row], self.world.time
        assert shell is not None
        if in_order:
            shell.leave(now)
        else:
            self._silent_at[row] = now + BASE_TIMEOUT
        self._latches[row] = shell.latches
        self._peer_latches.pop(row, None)
        self._alarms.set(row, None)
        self.shells[row] = None
        self._away += 1

    # What shells hand over

    def command(self, row: int, twist: Twist) -> None:
        """The base's command from now on."""
        self._commands[row] = twist.linear, twist.angular, twist.lateral

    def send_message(self, row: int, name: str, value: Value, now: float) -> None:
        """Through the radio, in the form in which it would go over the network."""
        try:
            plain = decode_value(encode_value(value))
        except CodecError:
            return
        self._radio.send(row, name, plain, now, self.world.poses(), self._boxes())

    def publish_status(self, row: int, status: Status) -> None:
        """Peers act on the latches of a status alone, now and when they join."""
        self._peer_latches.pop(row, None)
        if status.latches:
            self._peer_latches[row] = dict(status.latches)
            self._new_latches.append((row, self._peer_latches[row]))

    def set_alarm(self, row: int, at: float | None) -> None:
        """An alarm between two ticks."""
        self._alarms.set(row, at)

    # Time

    def advance(self, seconds: float, on_step: Callable[[float], None] | None = None) -> None:
        """Go on for so long, to the nearest step. SwarmError if a robot refuses an event.

        `on_step` is called after each with the time.
        """
        report = on_step or _ignore
        with _without_collection():
            for _ in range(round(seconds / self.world.dt)):
                self._step()
                report(self.world.time)

    def trace(self, **meta: Any) -> Trace:
        """The run so far, up to this instant."""
        self._recorder.record_instant(self.world.time, self._commands, self.shells)
        return self._recorder.trace({**self._meta(), **meta})

    def _step(self) -> None:
        world, now = self.world, self.world.time
        self._timeline.apply(now)
        self._deliver(now)
        self._sense(now)
        self._tick(now)
        if len(self._record_due.due(now)):
            self._recorder.record_instant(now, self._commands, self.shells)
        world.set_commands(self._commands)
        world.step()
        self._steps += 1
        self._recorder.record_contacts(world.time)

    def _deliver(self, now: float) -> None:
        for hearer, sender, name, value in self._radio.arrived(now):
            shell = self.shells[hearer]
            if shell is not None:
                shell.hear(self.world.ids[sender], name, value, now)
        told, self._new_latches = self._new_latches, []
        for row, latches in told:
            for shell in self.shells:
                if shell is not None and shell.row != row:
                    shell.settle(shell.robot.on_latches(latches, now), now)
        for row in self._neighbors_due.due(now):
            self._update_neighbors(int(row))

    def _update_neighbors(self, row: int) -> None:
        """Robot `row` learns who is within hearing."""
        shell = self.shells[row]
        if shell is None:
            return
        heard = self._radio.neighbors(row, self.world.poses(), self._boxes())
        if self._away:
            there = {one.robot.id for one in self.shells if one is not None}
            heard = tuple(neighbor for neighbor in heard if neighbor.id in there)
        shell.neighbors(heard, self.world.time)

    def _sense(self, now: float) -> None:
        world = self.world
        due = self._scans_due.due(now)
        if len(due):
            for row, scan in zip(due.tolist(), world.scans(due), strict=True):
                self._scans_in_transit.put(now + float(world.scan_latency[row]), (row, scan))
        for row, scan in self._scans_in_transit.due(now):
            shell = self.shells[row]
            if shell is not None:
                shell.scan(scan, now)
        for row in self._readings_due.due(now):
            shell = self.shells[row]
            if shell is not None:
                shell.robot.on_readings(world.readings(int(row)))

    def _tick(self, now: float) -> None:
        if len(self._odometry_due.due(now)):
            # All wheels are read at once, since reading one takes as long as reading a hundred.
            for shell, odometry in zip(self.shells, self.world.odometry(), strict=True):
                if shell is not None:
                    shell.odometry(odometry, now)
        for row in self._ticks.due(now).tolist():
            shell = self.shells[row]
            if shell is not None:
                shell.tick(now)
        for row in self._alarms.due(self._steps):
            shell = self.shells[row]
            if shell is not None:
                shell.tick(now)
        for row, at in list(self._silent_at.items()):
            if now >= at:
                self._commands[row] = 0.0
                del self._silent_at[row]

    def _boxes(self) -> Array | None:
        """The corners (m, 4, 2) of movable boxes, if the radio must see past them."""
        if not self.scenario.radio.line_of_sight or not self.world.movable_boxes:
            return None
        return transform(self.world.box_shapes, self.world.box_poses())

    def _meta(self) -> dict[str, Any]:
        scenario, platforms = self.scenario, self.world.platforms
        return {
            "scenario": scenario.name,
            "seed": self.seed,
            "duration": scenario.duration,
            "arena": scenario.arena.text,
            "lidar_visibility": scenario.visibility,
            "radio": scenario.effective.get("radio", {}),
            "groups": {name: list(ids) for name, ids in scenario.groups.items()},
            "modes": {p.name: p.protection["mode"] for p in platforms},
            "thresholds": {p.name: p.protection.get("threshold", 0.0) for p in platforms},
            "v_max": {p.name: p.limits.linear for p in platforms},
            "events": [
                {"at": e.at, "action": e.action, "robots": list(e.robots), "pattern": e.pattern}
                for e in scenario.events
            ],
        }


def _as_sensing(platform: Platform, realism: Realism) -> Platform:
    """The platform; without noise, scans that stay the same do not betray a frozen sensor."""
    is_noisy = platform.scan.is_noisy and realism.lidar.differs_each_time
    return replace(platform, scan=replace(platform.scan, is_noisy=is_noisy))


def _ignore(now: float) -> None:
    """Do nothing with the progress."""


@contextmanager
def _without_collection() -> Iterator[None]:
    """No garbage collection: a run makes hardly any cycles, and walking 1000 robots takes long."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
