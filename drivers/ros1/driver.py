"""A robot that speaks ROS 1, through an adapter under the system's Python with rospy.

The adapter (`ros1_adapter.py`) passes serialised messages on; they are read and written here. It is
a process of its own, so it is also this base's stopper: it sends zeros when the daemon is silent or
gone.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from swarmd.core.errors import CodecError, DriverError
from swarmd.core.values import ZERO, Platform, ScanSpec, Twist, Value
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, SenderSpec, Sink
from swarmd.drivers.ros.from_ros import (
    RangeRing,
    battery_readings,
    imu_readings,
    odometry_of,
    scan_of,
    stamp_of,
)
from swarmd.drivers.ros1 import adapter_process as ros1_adapter
from swarmd.drivers.ros1 import wire
from swarmd.drivers.ros1.adapter import AdapterProcess, Event, Link, State
from swarmd.drivers.ros1.options import Ros1Options, read_options
from swarmd.drivers.ros1.view import Sense, View

if TYPE_CHECKING:
    from swarmd.drivers.ros import messages as ros

log = logging.getLogger(__name__)

FIRST_PAUSE, LONGEST_PAUSE = 0.1, 5.0
"""Seconds before an adapter that has died is started again: growing from the one to the other.

After one that had its base always the first: the base may keep its velocity until the next one.
"""

_WATCH_PERIOD = 0.1
_ENOUGH = 3  # messages of each sense, for a check
_LOOKS_FOR = 1.0
_LASTING = 1.0  # s that a base must have been lost for one reason that it is logged


class Ros1Driver:
    """Talks to one robot through a node of its own, `/swarmd_<robot>_<number>`."""

    is_simulated = False

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet. Options: `ros1_options.Ros1Options`."""
        self._options = read_options(options, robot)
        self._platform = platform
        self._name = "swarmd_" + re.sub(r"[^A-Za-z0-9_]", "_", robot)
        self._reader = _Reader(platform, self._options)
        self._script = str(Path(ros1_adapter.__file__).resolve())
        self._sink: Sink | None = None
        self._view = View(self._options, platform)
        self._child: AdapterProcess | None = None
        self._said: tuple[bool, str] = (False, "")
        self._said_at = math.inf
        self._logged = ""
        self._gate = CommandGate()
        self._was_up = False
        self._count = 0
        self._end = ""
        self._is_planned = False

    @property
    def adapter_pid(self) -> int | None:
        """The adapter's process id; None while there is none."""
        return None if self._child is None else self._child.pid

    def zero_sender(self) -> SenderSpec | None:
        """None: the adapter outlives the guardian and sends the zeros."""
        return None

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the adapter is started again as often as it ends."""
        self._sink, pause = sink, FIRST_PAUSE
        self._say(False, self._view.note)
        try:
            while True:
                end = await self._live(drives=True)
                end = f"{end}; the adapter is started again"
                self._say(False, end)
                self._log(False, end)
                if self._was_up or self._is_planned:
                    pause = FIRST_PAUSE
                await asyncio.sleep(pause)
                pause = min(2.0 * pause, LONGEST_PAUSE)
        finally:
            self._sink, self._said, self._logged = None, (False, ""), ""
            self._gate.end()

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back.

        For the first 2 s of a loss each command is sent as zero. The adapter then knows that the
        base stands; after a moving command it would take the silence for that of a dead daemon and
        send zeros against the node that drives the base next.
        """
        command = self._gate.filter(twist)
        if command is None and self._gate.repeats_zero(time.monotonic()):
            command = ZERO
        if command is not None:
            self._put(command)

    def _put(self, twist: Twist) -> None:
        if self._child is None:
            return
        self._count += 1
        if self._options.command is wire.TWIST:
            command = wire.encode_twist(twist)
        else:
            frame = self._options.cmd_vel_frame
            command = wire.encode_twist_stamped(twist, self._count, time.time_ns(), frame)
        self._child.send(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """What the master knows and what comes, and who takes commands; publishes nothing."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        task = asyncio.create_task(self._live(drives=False))
        try:
            async with asyncio.timeout(seconds):
                while not (task.done() or self._has_seen_all(loop.time() - begun)):
                    await asyncio.sleep(_WATCH_PERIOD)
        except TimeoutError:
            pass  # what is missing stands in the findings
        view, now = self._view, loop.time()
        task.cancel()
        ended = (await asyncio.gather(task, return_exceptions=True))[0]
        if isinstance(ended, str):
            return (Finding("adapter", False, ended),)
        if view.state is None:
            view.note = f"not ready within {seconds:g} s; give it longer"
        return tuple(view.findings(now))

    def _has_seen_all(self, seconds: float) -> bool:
        state = self._view.state
        if seconds < _LOOKS_FOR or state is None or not state.listeners:
            return False
        return all(sense.count >= _ENOUGH for sense in self._view.senses.values())

    async def _live(self, *, drives: bool) -> str:
        """One life of the adapter; how it ended."""
        self._view = View(self._options, self._platform)
        self._end, self._is_planned, self._was_up = "", False, False
        options = self._options
        try:
            child = AdapterProcess(
                self._script, options.python, self._config(drives), options.environ, self
            )
        except DriverError as error:
            return str(error)
        self._child = child
        try:
            while not await child.until_end(_WATCH_PERIOD):
                self._judge()
        except BaseException:
            self._forget_base()
            await child.close(politely=True)
            raise
        self._forget_base()
        end = await child.close(politely=False)
        return self._end or f"the adapter {end}"

    def _forget_base(self) -> None:
        self._child = None
        self._gate.cut()

    def _config(self, drives: bool) -> dict[str, Any]:
        options, view = self._options, self._view
        kind = options.command
        return {
            "master": options.master_uri,
            "name": self._name,
            "topics": list(view.senses),
            "kinds": [sense.kind.name for sense in view.senses.values()],
            "command_topic": view.command_topic,
            "command": {
                "topic": view.command_topic,
                "type": kind.name,
                "md5sum": kind.md5sum,
                "full_text": kind.full_text,
                "frame_id": options.cmd_vel_frame,
            }
            if drives
            else None,
            "holds": drives and self._gate.has_sent,
        }

    # What the adapter tells

    def on_event(self, event: Event) -> None:
        """A state, a publisher's type, or why the adapter ends."""
        view = self._view
        if isinstance(event, State):
            view.state = event
        elif isinstance(event, Link):
            view.on_link(event)
        elif event.kind == "fatal":
            self._end = (
                f"no rospy for {self._options.python} ({event.text}); install python3-rospy, or"
                " correct driver_options.python"
            )
        else:
            self._end, self._is_planned = event.text, event.kind == "restart"
        self._judge()

    def on_message(self, link: int, data: bytes) -> None:
        """A serialised message."""
        sense = self._view.links.get(link)
        if sense is None:
            self.on_dropped("type" if link in self._view.links else "garbage")
            return
        now = asyncio.get_running_loop().time()
        try:
            stamp, detail, deliver = self._reader.read(sense, data)
        except CodecError as error:
            sense.fault = sense.fault or str(error)  # one line, however often it comes
            self.on_dropped(sense.name)
            return
        sense.hear(stamp, detail, now)
        if not self._gate.is_open:
            self._judge()
        if self._gate.is_open and self._sink is not None:
            deliver(self._sink)

    def on_dropped(self, what: str) -> None:
        """Count one input that could not be read or used."""
        if self._sink is not None:
            self._sink.dropped(f"ros1/{what}")

    def _judge(self) -> None:
        """Whether the base is there; said when that has changed, or the reason has."""
        if self._sink is None or self._child is None:
            return
        missing = self._end or self._view.missing(asyncio.get_running_loop().time())
        if missing:
            self._say(False, missing)
        elif not self._gate.is_open:
            topic, node = self._view.command_topic, self._view.state
            others = f", as is {', '.join(node.others)}" if node and node.others else ""
            self._say(True, f"drives on {topic} at {self._options.master_uri}{others}")

    def _say(self, is_up: bool, text: str) -> None:
        now, was_up = time.monotonic(), self._gate.is_open
        self._was_up |= is_up
        if is_up and not was_up:
            self._gate.open()
        elif not is_up and self._gate.close(now):
            self._put(ZERO)
        if self._sink is not None and self._said != (is_up, text):
            self._said, self._said_at = (is_up, text), now
            self._sink.state(is_up, text)
        if is_up or was_up or now - self._said_at > _LASTING:
            self._log(is_up, text)

    def _log(self, is_up: bool, text: str) -> None:
        if text != self._logged:
            self._logged = text
            log.log(logging.INFO if is_up else logging.WARNING, "driver ros1: %s", text)


class _Reader:
    """Messages to values of the core. What is decoded here has the shape of ROS 2's messages."""

    def __init__(self, platform: Platform, options: Ros1Options) -> None:
        self._spec: ScanSpec = platform.scan
        self._yaw, self._hangs = math.radians(options.scan_yaw_deg), options.scan_upside_down
        places = options.placed.values()
        bearings = [math.radians(degrees) for degrees, _ in places]
        self._ring = RangeRing(bearings, [distance for _, distance in places], platform.scan)
        self._scans = 0
        self._readings: dict[str, dict[str, float]] = {}

    def read(self, sense: Sense, data: bytes) -> tuple[float, str, Callable[[Sink], None]]:
        """A message's stamp in s, a remark for `--check`, and its delivery; CodecError."""
        if sense.name == "scan":
            self._scans += 1
            sweep = cast("ros.LaserScan", wire.decode_laser_scan(data))
            sense.scan = scan = scan_of(
                sweep, self._scans, self._spec, self._yaw, is_upside_down=self._hangs
            )
            return scan.stamp, f", {len(scan.ranges)} rays", lambda sink: sink.scan(scan)
        if sense.name == "odometry":
            odometry = odometry_of(cast("ros.Odometry", wire.decode_odometry(data)))
            return odometry.stamp, "", lambda sink: sink.odometry(odometry)
        if sense.name == "range":
            return self._range(sense, cast("ros.Range", wire.decode_range(data)))
        message: wire.Imu | wire.BatteryState
        if sense.name == "imu":
            message = wire.decode_imu(data)
            values = imu_readings(cast("ros.Imu", message))
        else:
            message = wire.decode_battery(data)
            values = battery_readings(cast("ros.BatteryState", message))
        self._readings[sense.name] = values
        together = {name: value for some in self._readings.values() for name, value in some.items()}
        stamp = stamp_of(cast("ros.Time", message.header.stamp))
        return stamp, "", lambda sink: sink.readings(together)

    def _range(self, sense: Sense, message: ros.Range) -> tuple[float, str, Callable[[Sink], None]]:
        scan = self._ring.take(sense.index, message)
        sense.scan = scan or sense.scan
        stamp = stamp_of(message.header.stamp)
        return stamp, "", lambda sink: None if scan is None else sink.scan(scan)
