"""A simulated world in real time: steps on deadlines, publishes sensor data, applies commands.

A command that was decided with a scan older than `stale_after` counts as zero. Such commands come
from a frozen daemon: they wait in the daemon's socket and arrive when it resumes. Commands to an
emulated robot do not name their scan. The emulated robot obeys them, as a real base would.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import CodecError, ConfigError, SwarmError, unknown
from swarmd.core.events import (
    NeighborsInput,
    OdometryInput,
    ScanInput,
)
from swarmd.core.values import Array
from swarmd.driver_api.hw_codec import MessageWire
from swarmd.sim.live.link import EmulatorTransport, PendingRequest, WorldLink
from swarmd.sim.live.pacing import Staggered, StepPacer
from swarmd.sim.live.recording import LiveRecorder
from swarmd.sim.live.state import Triple, WorldReply, WorldRequest, WorldState, decode_request
from swarmd.sim.world.faults import fault_of
from swarmd.sim.world.geometry import transform
from swarmd.sim.world.odometer import ODOMETRY_RATE
from swarmd.sim.world.radio import Radio, RadioSettings, neighbors_rate
from swarmd.sim.world.seeding import generator
from swarmd.sim.world.sensors import ALL_NEEDS, SENSORS, SensorTimes, sensors_due
from swarmd.sim.world.world import World

COMMAND_TIMEOUT = 0.5
"""Real seconds without a command after which a simulated base stops."""

STATE_RATE = 10.0


class RealTimeWorld:
    """Runs one world for many daemons."""

    def __init__(
        self,
        world: World,
        link: WorldLink,
        recorder: LiveRecorder,
        *,
        radio: Radio | None = None,
        emulated: EmulatorTransport | None = None,
        command_timeouts: Sequence[float] | None = None,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start the schedules of all sensors now; no command has arrived yet.

        - `clock`: gives the time in s. `link` and `emulated` must stamp arrivals with this clock.
        - `radio`: gives the neighbors. Without a radio, no neighbors are published and each robot
          hears all robots.
        - `emulated`: exchanges sensor data and commands with daemons in place of `link`.
        - `command_timeouts`: for each robot the seconds without a command after which its base
          stops, inf for never; None: COMMAND_TIMEOUT for all.
        - `seed`: of the random order in which lidars and odometry of the robots measure.
        """
        self._world = world
        self._link = link
        self._recorder = recorder
        self._clock = clock
        self._radio = radio
        self._emulated = emulated
        if radio is not None:
            radio.faults = world.faults
        self._transport = emulated or link
        n = len(world.ids)
        start = world.time

        # Commands; row i of each array belongs to robot i.
        self._rows = {robot: row for row, robot in enumerate(world.ids)}
        self._commands = np.zeros((n, 3))  # linear, angular, lateral
        self._arrivals = np.full(n, -np.inf)  # s, of the newest command; -inf: no command yet
        self._command_timeouts: Array = np.array(command_timeouts or [COMMAND_TIMEOUT] * n)
        self._sent_seq = np.full(n, -1)  # the number of the newest scan; -1: no scan yet
        # A command is stale if the robot got more newer scans than this since the command's scan.
        self._stale_scans = np.array([p.scan.stale_after * p.scan.rate for p in world.platforms])
        self._unreadable = 0  # requests of viewers

        # Schedules of sensors and states, in simulated time. Lidars, odometry and radios take turns
        # in a random order of the rows, so that no row is favoured. Other sensors take turns in the
        # order of the rows.
        order = np.argsort([generator(seed, "phase", robot).random() for robot in world.ids])
        self._sensor_times = _sensor_times(world, order)
        self._odometry_due = Staggered(np.full(n, ODOMETRY_RATE), start, order)
        radio_settings = RadioSettings() if radio is None else radio.settings
        radio_rates = np.full(n, neighbors_rate(radio_settings))
        self._neighbors_due = Staggered(radio_rates, start, order)  # asked only with a radio
        # Whether each robot (n,) had a fresh command at the last step, for `_publish_radio`.
        self._last_commanded: NDArray[np.bool_] = np.zeros(n, dtype=np.bool_)
        self._state_due = Staggered(np.array([STATE_RATE]), start)
        self._pacer = StepPacer(world.dt, clock())

    def run(self, is_over: Callable[[], bool]) -> None:
        """Step until `is_over`, then finish the recording."""
        self._pacer = StepPacer(self._world.dt, self._clock())
        try:
            while not is_over():
                self.run_due()
                time.sleep(max(0.0, self._pacer.deadline - self._clock()))
        finally:
            self._recorder.finish()

    def run_due(self) -> None:
        """Run what is due: apply commands, step, publish sensor data, answer requests."""
        now = self._clock()
        steps = self._pacer.steps(now)
        if not steps:
            return
        self._take_commands()
        safe = np.where(self._is_fresh(now)[:, None], self._commands, 0.0)
        self._world.set_commands(safe)
        for _ in range(steps):
            self._world.step()
            self._recorder.note(safe)
        self._publish()
        for pending in self._link.take_requests():
            self._answer(pending)

    def _is_fresh(self, now: float) -> NDArray[np.bool_]:
        """Which robots (n,) have a command that is not older than their command timeout."""
        # NaN before the first command, so that the timeout inf does not make it fresh.
        command_age = np.where(np.isfinite(self._arrivals), now - self._arrivals, np.nan)
        return np.less_equal(command_age, self._command_timeouts)

    def _take_commands(self) -> None:
        for robot, command in self._transport.take_commands().items():
            row = self._rows[robot]
            seq = command.scan_seq
            twist = command.twist
            # A frozen daemon's queued commands arrive when the daemon resumes.
            is_stale = seq is not None and self._sent_seq[row] - seq > self._stale_scans[row]
            received = (twist.linear, twist.angular, twist.lateral)
            self._commands[row] = (0.0, 0.0, 0.0) if is_stale else received
            self._arrivals[row] = command.arrival
        for robot, is_closed in self._link.take_grips().items():
            self._world.grips[self._rows[robot]] = is_closed

    def _publish(self) -> None:
        world = self._world
        transport = self._transport
        stamp = self._clock()  # real time: simulated time may lag behind
        for row, input in sensors_due(
            world, self._sensor_times, lambda row: ALL_NEEDS, stamp=stamp
        ):
            if isinstance(input, ScanInput):
                self._sent_seq[row] = input.scan.seq
            transport.send(world.ids[row], input)
        due = self._odometry_due.due(world.time)
        if len(due):
            for row, odometry in zip(due, world.odometry(due), strict=True):
                transport.send(world.ids[row], OdometryInput(odometry))
        if self._radio is not None:
            self._publish_radio(self._radio)
        if len(self._state_due.due(world.time)):
            self._link.publish_state(self._state())

    def _publish_radio(self, radio: Radio) -> None:
        """Send robots their neighbors, and carry messages of patterns by the simulated radio.

        A robot counts as a neighbor only while its daemon sends commands. Each robot gets its
        neighbors at its own instants. When a daemon begins or ends to command, all robots get their
        neighbors at once, so that robots that start together hear one another from then on.
        """
        world = self._world
        ids = self._world.ids
        messages = self._link.take_messages()
        # The rows of robots that get their neighbors now.
        due_rows = self._neighbors_due.due(world.time)
        is_commanded = self._is_fresh(self._clock())
        if not np.array_equal(is_commanded, self._last_commanded):
            self._last_commanded = is_commanded
            due_rows = np.arange(len(ids))
        if messages or len(due_rows):
            # The corners of the movable boxes, which block a radio that needs a line of sight.
            poses = world.poses()
            boxes = transform(world.box_shapes, world.box_poses())
            for wire in messages:
                row = self._rows[wire.robot]
                radio.carry(radio.send(row, wire.channel, wire.payload, world.time, poses, boxes))
            radio.measure_poses(due_rows.tolist(), poses, world.time)
            for row in due_rows.tolist():
                neighbors = radio.neighbors(row, poses, boxes, now=world.time)
                commanded = tuple(n for n in neighbors if is_commanded[self._rows[n.id]])
                self._transport.send(ids[row], NeighborsInput(commanded))

        # Messages whose delay is over go to their receivers.
        arrived: dict[int, list[MessageWire]] = {}
        for receiver, sender, channel, payload in radio.arrived(world.time):
            wire = MessageWire(ids[sender], channel, cast(bytes, payload))
            arrived.setdefault(receiver, []).append(wire)
        for receiver, wires in arrived.items():
            self._link.messages(ids[receiver], wires)

    def _answer(self, pending: PendingRequest) -> None:
        try:
            request = decode_request(pending.payload)
            path = self._do(request)
        except SwarmError as error:
            self._unreadable += isinstance(error, CodecError)
            pending.answer(WorldReply(is_done=False, text=str(error)[:200], state=self._state()))
            return
        done = WorldReply(is_done=True, text=request.action, state=self._state(), path=path)
        pending.answer(done)

    def _do(self, request: WorldRequest) -> str:
        """Carry a request out; returns the path of the trace if one was written."""
        match request.action:
            case "start":
                self._recorder.begin()
            case "finish":
                return str(self._recorder.finish() or "")
            case "place":
                self._world.place(request.box, request.pose)
            case "remove":
                self._world.remove(request.box)
            case "fields":
                self._world.change_fields(request.fields)
            case "take_out":
                self._world.take_out(self._row(request.robot))
            case "fault" | "mend":
                self._change_fault(request)
        return ""

    def _row(self, robot: str) -> int:
        if robot not in self._rows:
            raise ConfigError(unknown("robot", robot, self._rows))
        return self._rows[robot]

    def _change_fault(self, request: WorldRequest) -> None:
        fault = fault_of(request.fault, "fault")
        world = self._world
        rows = [self._row(robot) for robot in request.robots]
        if fault.carried_by == "daemon":
            raise ConfigError(f"{fault.text}: the world has no daemons; signal their processes")
        if fault.carried_by == "radio" and self._radio is None:
            text = "this world simulates no radio; start it with a range (--radio-range 100)"
            raise ConfigError(f"{fault.text}: {text}")
        for row in rows:
            misfit = fault.misfit(world.platforms[row], is_posed=row in world.posed)
            if misfit:
                raise ConfigError(f"{fault.text}: {world.ids[row]} {misfit}")
        world.change_fault(fault, rows, is_on=request.action == "fault")

    def _state(self) -> WorldState:
        world = self._world
        record = self._recorder
        emulated = self._emulated.side.dropped if self._emulated else 0
        poses = world.poses()
        twists = world.twists()
        commanded = self._is_fresh(self._clock())
        present = np.flatnonzero(np.isfinite(poses[:, 0]))
        boxes = zip(world.loose, _triples(world.loose_poses()), strict=True)
        return WorldState(
            time=world.time,
            real_time_factor=self._pacer.real_time_factor(),
            arena=(world.arena.length, world.arena.width),
            ids=tuple(world.ids[row] for row in present.tolist()),
            poses=_triples(poses[present]),
            twists=_triples(twists[present]),
            commanded=tuple(commanded[present].tolist()),
            contacts=record.contacts,
            arena_contacts=record.arena_contacts,
            is_recording=record.is_running,
            recorded=record.seconds,
            overruns=self._pacer.overruns,
            dropped=self._link.dropped + emulated + self._unreadable,
            boxes={name: pose for name, pose in boxes if np.isfinite(pose).all()},
            touching=record.touching(),
            faults=world.faults.texts(),
        )


def _triples(rows: Array) -> tuple[Triple, ...]:
    return tuple((a, b, c) for a, b, c in rows.tolist())


def _sensor_times(world: World, lidar_order: NDArray[np.int64]) -> SensorTimes:
    """The schedules of lidars, rings of range sensors and further sensors, from now on.

    `lidar_order` (n,): the rows in the order in which their lidars take turns.
    """
    now = world.time
    scan_rates = np.array([platform.scan.rate for platform in world.platforms])
    further = [sensor for sensor in SENSORS if sensor.is_there(world)]
    return SensorTimes(
        Staggered(scan_rates, now, lidar_order),
        Staggered(world.ring_rates, now),
        [(sensor, Staggered(np.full(len(world.ids), sensor.rate), now)) for sensor in further],
    )
