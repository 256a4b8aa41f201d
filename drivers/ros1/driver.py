"""A robot that speaks ROS 1, through an adapter under the system's Python with rospy.

The adapter (`adapter_process.py`) passes serialised messages on; they are read and written here.
It is a process of its own, so it is also this base's watchdog: it sends zeros when the daemon is
silent or gone.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from swarmd.core.errors import CodecError, DriverError
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Platform, Twist, Value
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, Sink, ZeroSenderSpec
from swarmd.drivers.ros.diagnosis import (
    Report,
    driven_by_others,
    has_enough,
    scan_conflict,
    unconnected,
    unreachable,
)
from swarmd.drivers.ros.from_ros import twist_of
from swarmd.drivers.ros.options import Ros1Options, read_options
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros1 import adapter_process, serialization
from swarmd.drivers.ros1.adapter import (
    AdapterProcess,
    Event,
    ForeignMessage,
    MasterState,
)
from swarmd.drivers.ros1.master_graph import MasterGraph, Ros1

log = logging.getLogger(__name__)

MIN_RESTART_DELAY, MAX_RESTART_DELAY = 0.1, 5.0
"""Seconds before an adapter that has ended is started again, doubled from the first to the last.

An adapter that had connected to its base is replaced after the first pause: the base may keep its
velocity until the next adapter.
"""

TOPIC_TIMEOUT = 2.5
"""Seconds without a message after which a needed topic counts as lost; scans may come at 1 Hz."""

_Reported = tuple[bool, str, Reason | None, bool]
_NOTHING: _Reported = (False, "", None, False)
_WATCH_PERIOD = 0.1
_MIN_LOGGED_LOSS = 1.0  # s for which a base must have been lost for one reason that it is logged


class Ros1Driver:
    """Talks to one robot through a node of its own, `/swarmd_<robot>_<number>`."""

    is_simulated = False

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet. Options: `Ros1Options`."""
        self._options = read_options(Ros1Options, options, "ros1", robot)
        self._platform = platform
        self._node = "swarmd_" + re.sub(r"[^A-Za-z0-9_]", "_", robot)
        self._script = str(Path(adapter_process.__file__).resolve())
        self._sink: Sink | None = None
        self._child: AdapterProcess | None = None
        self._reported: _Reported = _NOTHING
        self._reported_at = math.inf
        self._logged = ""
        self._gate = CommandGate()
        self._count = 0
        self._begin()

    @property
    def adapter_pid(self) -> int | None:
        """The adapter's process id; None while there is none."""
        return None if self._child is None else self._child.pid

    def zero_sender(self) -> ZeroSenderSpec | None:
        """None: the adapter outlives the daemon and sends the zeros."""
        return None

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the adapter is started again as often as it ends."""
        self._sink, pause = sink, MIN_RESTART_DELAY
        self._report_state(False, "its adapter is starting")
        try:
            while True:
                end = await self._run_adapter(is_check=False)
                end = f"{end}; the adapter is started again"
                self._report_state(False, end)
                self._log(False, end)
                if self._was_up or self._is_planned_end:
                    pause = MIN_RESTART_DELAY
                await asyncio.sleep(pause)
                pause = min(2.0 * pause, MAX_RESTART_DELAY)
        finally:
            self._sink, self._reported, self._logged = None, _NOTHING, ""
            self._gate.end()

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back.

        A stopped robot is sent zero also while the base is lost: another node may command it.
        For the first 2 s of a loss each command is sent as zero. The adapter then knows that the
        base stands; after a moving command it would take the silence for that of a dead daemon and
        send zeros against the node that drives the base next.
        """
        command = self._gate.filter(twist, is_stopped=is_stopped)
        if command is None and self._gate.repeats_zero(time.monotonic()):
            command = ZERO
        if command is not None:
            self._put(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Topics, rates, types, clocks and what is missing, each with the next step."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        task = asyncio.create_task(self._run_adapter(is_check=True))
        try:
            async with asyncio.timeout(seconds):
                while not (task.done() or self._has_enough(loop.time() - begun)):
                    await asyncio.sleep(_WATCH_PERIOD)
        except TimeoutError:
            pass  # the findings name what is missing
        report = self._report()
        task.cancel()
        ended = (await asyncio.gather(task, return_exceptions=True))[0]
        if isinstance(ended, str):
            return (Finding("adapter", False, ended),)
        if report is None:
            return (Finding("adapter", False, f"not ready within {seconds:g} s; give it longer"),)
        return report.findings()

    def _begin(self) -> None:
        """Nothing is known yet, in one life of the adapter."""
        self._subscriptions = Subscriptions(self._options, self._platform, serialization.decode)
        self._master = MasterGraph(self._options, self._subscriptions.topics)
        self._end, self._is_planned_end, self._was_up = "", False, False
        self._conflict = ""
        self._foreign_commands, self._hears_motion = 0, False

    def _report(self) -> Report | None:
        """What a check has found out; None if the adapter told nothing yet."""
        state = self._master.state
        if state is None:
            return None
        return Report(
            graph=self._master.graph(),
            endpoint=self._options.master_uri,
            connection_fault="" if state.master else self._unreachable(state),
            subscriptions=self._subscriptions,
            spec=self._platform.scan,
            cmd_vel=self._master.cmd_vel,
            command_type=self._options.command_type,
            has_subscriber=bool(state.listeners),
            foreign_commands=self._foreign_commands,
            foreign_publishers=state.others,
            now=asyncio.get_running_loop().time(),
            is_exclusive=self._master.blocks,
        )

    def _has_enough(self, seconds: float) -> bool:
        state = self._master.state
        return bool(state and state.listeners) and has_enough(self._subscriptions, seconds)

    async def _run_adapter(self, *, is_check: bool) -> str:
        """One life of the adapter; how it ended."""
        self._begin()
        options = self._options
        try:
            child = AdapterProcess(
                self._script, options.python, self._config(is_check), options.environ, self
            )
        except DriverError as error:
            return str(error)
        self._child = child
        try:
            while not await child.until_end(_WATCH_PERIOD):
                self._update_state()
        except BaseException:
            self._disconnect()
            await child.close(politely=True)
            raise
        self._disconnect()
        end = await child.close(politely=False)
        return self._end or f"the adapter {end}"

    def _disconnect(self) -> None:
        self._child = None
        self._gate.cut()

    def _config(self, is_check: bool) -> dict[str, Any]:
        options, topics = self._options, self._subscriptions.topics.values()
        text, md5sum = serialization.definition(options.command_type)
        command = {
            "topic": self._master.cmd_vel,
            "type": serialization.type_name(options.command_type),
            "md5sum": md5sum,
            "full_text": text,
            "frame_id": options.cmd_vel_frame,
        }
        return {
            "master": options.master_uri,
            "name": self._node,
            "topics": [stats.topic for stats in topics],
            "types": [serialization.type_name(stats.message_type) for stats in topics],
            "md5sums": [serialization.definition(stats.message_type)[1] for stats in topics],
            "command_topic": self._master.cmd_vel,
            "command_md5sum": md5sum,
            "command": None if is_check else command,
            "holds": not is_check and self._gate.has_sent,
        }

    # Called by the adapter

    def on_event(self, event: Event) -> None:
        """The master's state, a message of another type, or why the adapter ends."""
        if isinstance(event, MasterState):
            self._master.on_state(event)
        elif isinstance(event, ForeignMessage):
            self._master.on_foreign(event)
            self.on_dropped("type")
        elif event.kind == "fatal":
            self._end = no_rospy(self._options.python, event.text)
        else:
            self._end, self._is_planned_end = event.text, event.kind == "restart"
        self._update_state()

    def on_message(self, topic: int, data: bytes) -> None:
        """A serialised message."""
        topics = [*self._subscriptions.topics.values()]
        if topic == len(topics):
            self._on_foreign_command(data)
            return
        if topic > len(topics):
            self.on_dropped("garbage")
            return
        stats = topics[topic]
        now = asyncio.get_running_loop().time()
        try:
            deliver = self._subscriptions.read(stats.name, data, now)
        except CodecError as error:
            stats.record_fault(now, f"cannot be read: {error}")
            self.on_dropped(stats.name)
            return
        if not self._gate.is_open:
            self._update_state()
        if (self._gate.is_open or self._master.blocks) and self._sink is not None:
            deliver(self._sink)  # also while another node drives: a stop tells the measured speed

    def _on_foreign_command(self, data: bytes) -> None:
        """Another node publishes a command; a zero does not count as driving."""
        self._foreign_commands += 1
        try:
            command: Any = serialization.decode(self._options.command_type, data)
            is_zero = twist_of(command).is_zero
        except CodecError:
            is_zero = False  # of another type than ours: it may well move the robot
        if is_zero:
            return
        if self._gate.is_stopped:
            self._put(ZERO)
        self._hears_motion = True

    def on_dropped(self, what: str) -> None:
        """Count one input that could not be read or used."""
        if self._sink is not None:
            self._sink.dropped(f"ros1/{what}")

    def _update_state(self) -> None:
        """Open or close the gate, and report it when that or the reason has changed."""
        if self._sink is None or self._child is None:
            return
        if stale := self._subscriptions.stale_readings(asyncio.get_running_loop().time()):
            stale(self._sink)
        state = self._master.state
        self._hears_motion &= bool(state and state.others)
        fault = self._end or self._fault(asyncio.get_running_loop().time())
        before = self._conflict
        self._conflict = scan_conflict(self._master.graph(), self._subscriptions.topics.values())
        if fault:
            self._report_state(False, fault)
        elif not self._gate.is_open or self._conflict != before:
            others = f", as is {', '.join(state.others)}" if state and state.others else ""
            where = f"{self._master.cmd_vel} at {self._options.master_uri}"
            self._report_state(True, self._conflict or f"drives on {where}{others}")

    def _fault(self, now: float) -> str:
        """Why the base cannot be driven, and the next step; empty if it can."""
        state, master = self._master.state, self._master
        if state is None:
            return "its adapter is starting"
        if not state.master:
            return self._unreachable(state)
        if master.blocks:
            return driven_by_others(master.cmd_vel, state.others, is_heard=self._hears_motion)
        graph = master.graph()
        for stats in self._subscriptions.silent(now, TOPIC_TIMEOUT):
            is_unreadable = bool(stats.recent_fault(now))
            return graph.unreadable(stats) if is_unreadable else graph.silence(stats)
        if state.connected:
            return ""
        return graph.no_subscriber(
            master.cmd_vel, self._options.command_type, has_subscriber=bool(state.listeners)
        ) or unconnected(master.cmd_vel, state.listeners)

    def _unreachable(self, state: MasterState) -> str:
        return unreachable(Ros1(), self._options.master_uri, state.text)

    def _put(self, twist: Twist) -> None:
        if self._child is None:
            return
        self._count += 1
        if self._options.cmd_vel_type == "twist":
            command = serialization.encode_twist(twist)
        else:
            frame = self._options.cmd_vel_frame
            command = serialization.encode_twist_stamped(twist, self._count, time.time_ns(), frame)
        self._child.send(command)

    def _report_state(self, is_up: bool, text: str) -> None:
        now, was_up = time.monotonic(), self._gate.is_open
        self._was_up |= is_up
        if is_up and not was_up:
            self._gate.open()
        elif not is_up and self._gate.close(now):
            self._put(ZERO)
        state = self._master.state
        gets_zero = self._child is not None and state is not None and state.connected > 0
        hold = Reason.SCAN_CONFLICT if self._conflict else None
        report = (is_up, text, hold, gets_zero)
        if self._reported[:2] != report[:2]:
            self._reported_at = now
        if self._sink is not None and self._reported != report:
            self._reported = report
            self._sink.state(is_up, text, hold=hold, gets_zero=gets_zero)
        if is_up or was_up or now - self._reported_at > _MIN_LOGGED_LOSS:
            self._log(is_up, text)

    def _log(self, is_up: bool, text: str) -> None:
        if text != self._logged:
            self._logged = text
            log.log(logging.INFO if is_up else logging.WARNING, "driver ros1: %s", text)


def no_rospy(python: str, fault: str) -> str:
    """The interpreter has no rospy."""
    return (
        f"no rospy for {python} ({fault}); install python3-rospy, or correct driver_options.python"
    )
