"""Lockstep: a whole swarm in one process, fast and reproducible bit by bit.

`Lockstep` uses the `World` and the `Robot` of live runs. Patterns run inline, and messages pass the
radio model. No code sleeps or reads a clock, and every random number comes from the seed.

Several processes may share the robots of one run (`processes.py`). Each process simulates the
world, the radio and the timeline of the whole swarm, but the robots and patterns of its own rows
alone. Commands, messages and latches (emergency stops that hold until a reset) take effect at
`exchange`, which hands them to all processes. The result does not depend on the order in which
robots or processes produce them.

A row is the index of a robot in all arrays. Rows follow the names of the robots, so the order of a
file changes no bit. An event that concerns several robots at one instant reaches all of them before
any robot acts on the event.
"""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from itertools import compress
from operator import itemgetter
from types import MappingProxyType
from typing import Any

import numpy as np

from swarmd.core import events
from swarmd.core.clock import TICK
from swarmd.core.codec import decode_value, encode_value
from swarmd.core.errors import CodecError
from swarmd.core.messages import Body, Latch
from swarmd.core.pin import is_pinned, processor
from swarmd.core.values import Array, Value
from swarmd.kit.behavior import Pattern
from swarmd.make_robot import make_robot
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.robot import ticker
from swarmd.robot.latches import LatchRecord
from swarmd.robot.protection.compatibility import body_of
from swarmd.robot.setup import EarlierLives, RobotIdentity, RobotSetup
from swarmd.sim.lockstep.beacons import BEACON_RATE, CHANNEL, ShownBeacon
from swarmd.sim.lockstep.huge_pages import use_huge_pages
from swarmd.sim.lockstep.processes import TIMEOUT, RunProcess, run_processes
from swarmd.sim.lockstep.recorder import LockstepRecorder
from swarmd.sim.lockstep.schedules import Alarms, EventTimeline, Schedules
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.scenarios.pseudo_reality import drawn
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.simulation import meta_of, radio_of, world_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.active_faults import Flight
from swarmd.sim.world.faults import FaultKind
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.odometer import ODOMETRY_RATE
from swarmd.sim.world.radio import neighbors_rate
from swarmd.sim.world.realism import configured
from swarmd.sim.world.scalar_fields import READINGS_RATE
from swarmd.sim.world.seeding import generator
from swarmd.sim.world.sensors import SENSORS, SensorTimes, sensors_due

BASE_TIMEOUT = 0.5
"""Seconds without a daemon after which a base stops."""
# s, robots; a shorter or smaller run gains less than it takes
_HUGE_PAGES_AT = 5.0
_MANY = 64
_PARTS = 50  # of a run, between which garbage is collected

_NO_PATTERNS: Mapping[str, type[Pattern[Any]]] = MappingProxyType({})


def _made() -> dict[str, str]:
    """What a trace says of the process that made it: `pinned` (`yes`, `no`) and `processor`."""
    return {"pinned": "yes" if is_pinned() else "no", "processor": processor()}


def simulate_run(
    scenario: Scenario,
    seed: int,
    on_progress: Callable[[float], None] | None = None,
    *,
    cores: int = 1,
    timeout: float = TIMEOUT,
    seconds: float = math.inf,
    on_failure: Callable[[str], None] | None = None,
) -> Trace:
    """Simulate a whole run, or its first `seconds`.

    `on_progress` is called after every step with the simulated share 0..0.99, and with 1 at the
    end. `on_failure` is called at the end with `Lockstep.failure`, if a pattern failed. `cores`:
    the number of processes that share the robots; the trace does not depend on it. SwarmError for
    an impossible start, for a refused request, and for a process that ends or makes no progress for
    `timeout` s.
    """

    def simulate(process: RunProcess) -> Trace:
        run = Lockstep(scenario, seed, process)
        duration = min(scenario.duration, seconds)

        def report(share: float) -> None:
            if process.index == 0 and on_progress is not None:
                on_progress(share)

        # In parts, since `advance` collects garbage only at its end.
        for part in range(1, _PARTS + 1):
            part_end = part / _PARTS * duration
            run.advance(
                part_end - run.world.time,
                lambda now: report(min(now / duration, 0.99)),
            )
        report(1.0)
        failure = run.failure()
        if failure and on_failure is not None:
            on_failure(failure)
        return run.trace()

    return run_processes(simulate, min(cores, len(scenario.robots)), timeout)


class Lockstep:
    """A simulated swarm that `advance` moves on in time."""

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        process: RunProcess | None = None,
        *,
        patterns: Mapping[str, type[Pattern[Any]]] = _NO_PATTERNS,
    ) -> None:
        """Start the robots of a scenario at time 0.

        `process`: this process of the run; None: the only process. `patterns`: classes by name, in
        place of installed patterns with the same names.
        """
        scenario = drawn(scenario, seed)
        self.scenario = scenario
        self.seed = seed
        self._process = process or RunProcess()
        self.world = world_of(scenario, seed)
        # With several processes `exchange` measures the rays of scans in progress, before it waits
        # for the other processes.
        self.world.measures_late = self._process.count > 1
        # As robots assume them in a world of this realism.
        self._platforms = [configured(p, scenario.realism) for p in self.world.platforms]
        # Made on first use: listing the installed patterns takes as long as a simulated second.
        installed = cache(lambda: _loader(scenario))
        self._find = lambda name: patterns.get(name) or installed()(name)
        self._radio = radio_of(scenario, seed)
        self._radio.faults = self.world.faults
        # A layer that bounds commands needs the pose of each robot in the world.
        self.world.posed = frozenset(
            row
            for row, (robot, platform) in enumerate(
                zip(self.world.ids, self._platforms, strict=True)
            )
            if scenario.settings[robot].layers or "pose" in platform.provides
        )
        self._begin_schedules()
        self._begin_bodies()
        self._begin_robots()
        self._begin_latches()
        # The messages and the latches that this process's robots sent since the last exchange.
        self._flights: list[Flight] = []
        self._published: list[tuple[int, dict[str, Latch]]] = []
        # Time, row and text of each failure of a pattern of this process's robots.
        self._failures: list[tuple[float, int, str]] = []
        ids = self.world.ids
        present_rows = [row for row, robot in enumerate(ids) if robot not in scenario.absent]
        self.start(present_rows)
        self._timeline = EventTimeline(scenario.events, self)
        self._recorder = LockstepRecorder(self.world)

    def _begin_schedules(self) -> None:
        """Begin the schedules, and share the robots among the processes.

        Each robot has a random phase of 0 to 1 s, at which its scans, readings, ticks and neighbors
        are due. All odometry is due together.
        """
        ids = self.world.ids
        n = len(self.world.ids)
        phases = np.array([generator(self.seed, "phase", robot).random() for robot in ids])
        scan_rates = np.array([p.scan.rate for p in self.world.platforms])
        self._sensor_times = SensorTimes(
            Schedules(scan_rates, phases),
            Schedules(self.world.ring_rates, phases[self.world.rings]),
            # All at one rate: a robot's data are then still in the processor's caches.
            [
                (sensor, Schedules(np.full(n, READINGS_RATE), phases))
                for sensor in SENSORS
                if sensor.is_there(self.world)
            ],
        )
        self._ticks = Schedules(np.full(n, 1.0 / TICK), phases)
        self._odometry_due = Schedules(np.array([ODOMETRY_RATE]))
        self._neighbors_due = Schedules(np.full(n, neighbors_rate(self.scenario.radio)), phases)
        # None: no robot may be mute or deaf, and robots tell nothing of each other's messages.
        faults = [event.fault for event in self.scenario.events if event.fault is not None]
        has_radio_fault = any(fault.place == "radio" for fault in faults)
        self._beacons_due = Schedules(np.full(n, BEACON_RATE), phases) if has_radio_fault else None
        self._record_due = Schedules(np.array([self.scenario.trace_rate]))
        # By the time of the first scan, so that the scans of one step are shared by the processes.
        self._process.share(np.argsort(phases % (1.0 / scan_rates), kind="stable"))

    def _begin_bodies(self) -> None:
        """Set what robots know of each other's bodies."""
        bodies = [body_of(p) for p in self._platforms]
        self._bodies = dict(zip(self.world.ids, bodies, strict=True))
        self._heard: dict[str, Body | None] = {}  # bodies of robots that have ever had a daemon

    def _begin_robots(self) -> None:
        """Set the state of bases and daemons, by row; no robot has a daemon."""
        n = len(self.world.ids)
        self.alarms = Alarms(n, self.world.dt)
        self.commands = np.zeros((n, 3))
        self.has_new_commands = True  # `commands` differ from those of the world
        self._silent_at: dict[int, float] = {}  # s at which a base without a daemon stops
        self._frozen: dict[int, RobotShell | None] = {}  # halted daemons by row
        self._boots = [0] * n  # daemons that were started
        # None: the robot has no daemon, or belongs to another process.
        self.shells: list[RobotShell | None] = [None] * n
        self.has_daemon = [False] * n
        self._absent_count = n
        self._steps = 0
        is_large = len(self.world.ids) >= _MANY
        self._huge_pages_at = round(_HUGE_PAGES_AT / self.world.dt) if is_large else -1  # in steps

    def _begin_latches(self) -> None:
        """Set the latches, emergency stops that hold until a reset; no robot has any."""
        self._latches: dict[int, LatchRecord | None] = {}  # that ended daemons stored
        self._peer_latches: dict[int, dict[str, Latch]] = {}  # of present robots
        self._new_latches: list[tuple[int, dict[str, Latch]]] = []  # since the last step
        self._latched: set[int] = set()  # robots whose published latches are not empty

    # For the timeline of a scenario

    def start(self, rows: Sequence[int]) -> None:
        """Start daemons on robots `rows`, with the latches that their earlier daemons stored.

        The new robots and the present robots are neighbors of each other from this instant on.
        """
        now = self.world.time
        for row in rows:
            self._silent_at.pop(row, None)
            self.has_daemon[row] = True
            self._boots[row] += 1
            self.shells[row] = self._shell(row, now) if self._process.owns(row) else None
        self._absent_count -= len(rows)
        for shell in self._present(rows):
            if shell.robot.latches:
                self.publish_latches(shell.row, shell.robot.aged_latches(now))
        self.exchange()
        for shell in self._present(rows):  # peers' latches arrive before any request
            for latches in list(self._peer_latches.values()):
                shell.step(events.LatchesInput(latches), now)
        self.exchange()
        self._update_peers(rows)
        self._update_neighbors(range(len(self.shells)))

    def _instance(self, row: int) -> str:
        """The instance of the last daemon that was started on a robot."""
        return f"lockstep-{self._boots[row] - 1}"

    def _shell(self, row: int, now: float) -> RobotShell:
        robot_id = self.world.ids[row]
        scenario = self.scenario
        setup = RobotSetup(
            driver="lockstep",
            labels=tuple(name for name, ids in scenario.groups.items() if robot_id in ids),
            parameters=scenario.parameters[robot_id],
            settings=scenario.settings[robot_id],
        )
        identity = RobotIdentity(
            robot=robot_id,
            platform=self._platforms[row],
            setup=setup,
            seed=self.seed,
            instance=self._instance(row),
        )
        robot = make_robot(identity, now, EarlierLives(latches=self._latches.get(row)))
        return RobotShell(row, robot, self._find, self, now)

    def end(self, row: int, *, in_order: bool) -> None:
        """End the daemon of robot `row`, in order or as by a kill.

        After a kill the base keeps its last command for BASE_TIMEOUT s.
        """
        shell = self.shells[row]
        now = self.world.time
        if in_order and shell is not None:
            shell.step(events.LeaveInput(), now)
        if not in_order:
            self._silent_at[row] = now + BASE_TIMEOUT
        if shell is not None:
            self._latches[row] = shell.latches
        self.exchange()
        self._peer_latches.pop(row, None)
        self._set_absent(row)
        self._latched.discard(row)

    def change_fault(self, fault: FaultKind, rows: Sequence[int], *, is_on: bool) -> None:
        """Begin or end a fault of robots `rows`.

        A halted daemon is absent for its peers, and its base stops as that of a killed daemon.
        """
        if fault.carried_by != "daemon":
            self.world.change_fault(fault, rows, is_on=is_on)
            return
        for row in rows:
            if is_on:
                self._halt(row)
            else:
                self.resume(row)

    def _halt(self, row: int) -> None:
        """Halt the daemon of robot `row`, if it has one."""
        if self.has_daemon[row]:
            self._frozen[row] = self.shells[row]
            self._silent_at[row] = self.world.time + BASE_TIMEOUT
            self._set_absent(row)

    def resume(self, row: int) -> None:
        """Let the daemon of robot `row` continue, if it is halted."""
        if row not in self._frozen:
            return
        self.has_daemon[row] = True
        self._absent_count -= 1
        self._silent_at.pop(row, None)
        shell = self.shells[row] = self._frozen.pop(row)
        if shell is not None:
            self.alarms.set(row, self.world.time)
            for latches in list(self._peer_latches.values()):
                shell.step(events.LatchesInput(latches), self.world.time)
            self._hand_bodies(shell)  # also of robots that started meanwhile

    def _set_absent(self, row: int) -> None:
        self.alarms.set(row, None)
        self.shells[row] = None
        self.has_daemon[row] = False
        self._absent_count += 1

    def exchange(self, meanwhile: Callable[[], None] = lambda: None) -> None:
        """Give the outputs of this process's robots since the last call to all processes.

        All processes receive the outputs of all: commands, gripper commands, messages in transit
        (flights), and published latches (emergency stops that hold until a reset). With a single
        process, too, messages and latches take effect only here.

        `meanwhile`: work without outputs, to use the time of the wait: with several processes it
        is called once, before this process waits for the others. A single process never waits, and
        does not call `meanwhile`: it has done this work before (`measures_late` of the world).
        """
        process = self._process
        has_to_send = bool(self._flights or self._published)
        if process.count == 1 and not has_to_send:
            return  # the commands of a single process are in place
        # As bytes, since numpy takes 12 us to pickle and read two arrays.
        own_commands = self.commands[process.rows].tobytes()
        own_grips = self.world.grips[process.rows].tobytes()
        outputs = own_commands, own_grips, self._flights, self._published
        self._flights = []
        self._published = []
        all_published: list[tuple[int, dict[str, Latch]]] = []
        for index, (commands, grips, flights, published) in enumerate(
            process.exchange(outputs, meanwhile)
        ):
            if index != process.index:
                rows = process.rows_of[index]
                self.commands[rows] = np.frombuffer(commands).reshape(-1, 3)
                self.world.grips[rows] = np.frombuffer(grips, dtype=np.bool_)
                self.has_new_commands = True
            self._radio.carry(flights, process.own)  # to the receivers of this process
            all_published += published
        # In order of rows, so that the number of processes has no effect.
        for row, latches in sorted(all_published, key=itemgetter(0)):
            # Removed and added again: `_peer_latches` is in the order of the last publications.
            self._peer_latches.pop(row, None)
            if latches:
                self._peer_latches[row] = latches
                self._new_latches.append((row, latches))

    # The outputs of robots

    def send_message(self, row: int, name: str, value: Value, now: float) -> None:
        """Send a pattern's message by radio, after a round trip through the codec."""
        try:
            payload = encode_value(value)
            plain = decode_value(payload)
        except CodecError:
            return
        message = events.MessageInput(self.world.ids[row], name, plain, size=len(payload))
        self.send(row, name, message, now)

    def send(self, row: int, name: str, message: events.Input, now: float) -> None:
        """Send an input of all receivers by radio; no receiver changes it."""
        shell = self.shells[row]
        if shell is not None:
            shell.beacons.sent += 1
        self._flights += self._radio.send(
            row, name, message, now, self.world.poses(), self._boxes()
        )

    def grip(self, row: int, is_closed: bool) -> None:
        """Close or open the gripper of a robot from the next step of the world on."""
        self.world.grips[row] = is_closed

    def publish_latches(self, row: int, latches: Mapping[str, Latch]) -> None:
        """Publish the latches of a robot at the next exchange.

        Present peers receive the latches in the next step, later peers when they join.
        """
        if latches or row in self._latched:
            self._published.append((row, dict(latches)))
            (self._latched.add if latches else self._latched.discard)(row)

    def note_failure(self, row: int, text: str, now: float) -> None:
        """Note that the pattern of a robot raised an error, which the robot bears."""
        self._failures.append((now, row, text))

    def failure(self) -> str:
        """The first error of a pattern, with its line of code, robot and time; empty without one.

        Complete in the first process; all processes must call this.
        """
        failures = [one for part in self._process.collect(self._failures) for one in part]
        if not failures:
            return ""
        at, row, text = min(failures)
        return f"{text}, of {self.world.ids[row]} at {at:.2f} s"

    # Time

    def advance(self, seconds: float, on_step: Callable[[float], None] | None = None) -> None:
        """Simulate `seconds`, to the nearest step. Raises SwarmError if a robot refuses an event.

        `on_step` is called after each step with the time in s.
        """
        with _without_collection():
            for _ in range(round(seconds / self.world.dt)):
                self._step()
                if self._steps == self._huge_pages_at:
                    use_huge_pages()
                if on_step is not None:
                    on_step(self.world.time)

    def trace(self) -> Trace:
        """The trace up to now, complete in the first process; all processes must call this."""
        self._recorder.record_instant(self.world.time, self.commands, self.shells)
        kept = self._process.collect(self._recorder.kept(self._process.rows))
        meta = {**meta_of(self.scenario, self.seed), "made": _made()}
        if any(event.fault for event in self.scenario.events):
            meta["said"] = sorted(
                line for part in self._process.collect(self._said()) for line in part
            )
        return self._recorder.trace(meta, kept)

    def _said(self) -> list[tuple[float, str, str]]:
        """Time in s, robot and text of the events that the robots of this process logged."""
        now = self.world.time
        statuses = [shell.robot.status(now) for shell in self.shells if shell is not None]
        return [
            (round(now - status.uptime + event.at, 3), status.robot, event.text)
            for status in statuses
            for event in status.events
        ]

    def _step(self) -> None:
        world = self.world
        now = self.world.time
        self._timeline.apply(now)
        self._deliver(now)
        self._sense(now)
        self._tick(now)
        if self._beacons_due is not None:
            self._send_beacons(self._beacons_due.due(now), now)
        self.exchange(world.measure_rays)
        if self._record_due.due(now):
            self._recorder.record_instant(now, self.commands, self.shells)
        if self.has_new_commands:
            world.set_commands(self.commands)
            self.has_new_commands = False
        world.step()
        self._steps += 1
        self._recorder.record_contacts(world.time)

    def _deliver(self, now: float) -> None:
        for receivers, sender, _, message in self._radio.due(now):
            # A call for all receivers: a third of the time of a step of each.
            shells = [self.shells[row] for row in receivers]
            if isinstance(message, ShownBeacon):
                for shell in filter(None, shells):
                    shell.beacons.hearing.on_beacon(*message, now)
                continue
            if self._beacons_due is not None:
                self._note_message(sender, filter(None, shells), now)
            robots = [None if shell is None else shell.robot for shell in shells]
            if isinstance(message, events.KinInput):
                kins = ticker.kin_many(robots, message, now)
                if kins:  # one call for all, as in `message_many`
                    kins[0].on_message_many(kins, message.robot, message.message, now)
            else:
                ticker.message_many(robots, message, now)
        received = self._new_latches
        self._new_latches = []
        for row, latches in received:
            for shell in self._present(range(len(self.shells))):
                if shell.row != row:
                    shell.step(events.LatchesInput(latches), now)
        self._update_neighbors(self._neighbors_due.due(now))

    def _note_message(self, row: int, receivers: Iterable[RobotShell], now: float) -> None:
        """Note which robots a message of a robot reached, whatever they do with it."""
        sender = self.world.ids[row]
        instance = self._instance(row).encode()
        for shell in receivers:
            shell.beacons.hearing.on_message(sender, instance, now)

    def _send_beacons(self, rows: Sequence[int], now: float) -> None:
        """Send what these robots tell of messages; faults of the radio let it pass."""
        shells = self._present(rows)
        for shell in shells:
            hearing = shell.beacons.hearing
            if hearing.advance(now):
                shell.step(events.PeerFaultsInput(hearing.faults), now)
            hearers = self._radio.hearers(shell.row, self.world.poses(), self._boxes())
            if len(hearers):
                beacon = shell.beacons.next()
                arrival = now + self.scenario.radio.delay
                self._flights.append((arrival, 0.0, hearers.tolist(), shell.row, CHANNEL, beacon))

    def _update_neighbors(self, rows: Sequence[int]) -> None:
        if not rows:  # the case in most steps
            return
        world = self.world
        there = set[str]()
        poses = world.poses()
        self._radio.measure_poses(rows, poses, world.time)
        shells = self._present(rows)
        if not shells:
            return
        boxes = self._boxes()
        if self._absent_count:
            there.update(compress(world.ids, self.has_daemon))
        for shell in shells:
            neighbors = self._radio.neighbors(shell.row, poses, boxes, now=world.time)
            if self._absent_count:
                neighbors = tuple(neighbor for neighbor in neighbors if neighbor.id in there)
            shell.step(events.NeighborsInput(neighbors), world.time)

    def _update_peers(self, new: Iterable[int]) -> None:
        """Hand the bodies of new robots to all robots, as beacons do."""
        self._heard |= {self.world.ids[row]: self._bodies[self.world.ids[row]] for row in new}
        for shell in self._present(range(len(self.shells))):
            self._hand_bodies(shell)

    def _hand_bodies(self, shell: RobotShell) -> None:
        others = {i: body for i, body in self._heard.items() if i != shell.robot.id}
        shell.step(events.PeersInput(others), self.world.time)

    def _sense(self, now: float) -> None:
        for row, input in sensors_due(
            self.world, self._sensor_times, self._needs, stamp=now, own=self._process.own
        ):
            shell = self.shells[row]
            if shell is not None:
                shell.sense(input, now)

    def _needs(self, row: int) -> frozenset[str] | None:
        shell = self.shells[row]
        return None if shell is None else shell.needs

    def _tick(self, now: float) -> None:
        world = self.world
        if self._odometry_due.due(now):
            # All odometers are read at once: numpy takes as long for one as for a hundred.
            own = self._process.rows
            shells = [self.shells[row] for row in own.tolist()]
            robots = [None if shell is None else shell.robot for shell in shells]
            ticker.odometry_many(robots, world.odometry(own), now)
        self._tick_rows(self._ticks.due(now), now)
        self._tick_rows(self.alarms.due(self._steps), now)
        for row in [row for row, at in self._silent_at.items() if now >= at]:
            self.commands[row] = 0.0
            self.has_new_commands = True
            del self._silent_at[row]

    def _tick_rows(self, rows: Sequence[int], now: float) -> None:
        shells = self._present(rows)
        if shells:
            robots = [shell.robot for shell in shells]
            rows = [shell.row for shell in shells]
            for place, actions in ticker.tick_many(robots, rows, self.commands, now):
                shells[place].carry_out(actions, now)
            self.has_new_commands = True

    def _present(self, rows: Sequence[int]) -> Sequence[RobotShell]:
        """The shells of the robots `rows` that have a daemon and belong to this process."""
        if not rows:  # the case in most steps
            return ()
        return [shell for row in rows if (shell := self.shells[row]) is not None]

    def _boxes(self) -> Array | None:
        """The corners (m, 4, 2) of movable boxes in m; None if no box can block the radio."""
        if not self.scenario.radio.line_of_sight or not self.world.movable_boxes:
            return None
        return transform(self.world.box_shapes, self.world.box_poses())


def _loader(scenario: Scenario) -> PatternLoader:
    origins = pattern_names(scenario.plugin_dir)
    return PatternLoader({name: (o.value, o.is_file) for name, o in origins.items()})


@contextmanager
def _without_collection() -> Iterator[None]:
    """Disable garbage collection: a run makes few cycles, and a pass over 1000 robots is slow."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
