"""The driver of ROS 1 robots, through an adapter process under the system's Python with rospy.

The adapter (`adapter_process.py`) passes serialised messages between rospy and this driver, which
decodes and encodes them. The adapter is also the base's watchdog: it sends zeros when the daemon is
silent or has ended.
"""

from __future__ import annotations

import asyncio
import logging
import math
import re
import time
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from swarmd.core.errors import CodecError, DriverError
from swarmd.core.finding import Finding
from swarmd.core.messages import Reason
from swarmd.core.values import ZERO, Platform, Twist, Value
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Sink, ZeroSenderSpec
from swarmd.drivers.ros import diagnosis
from swarmd.drivers.ros.foreign_commands import ROS1_ACTIONS, ForeignCommands
from swarmd.drivers.ros.messages import String, TwistStamped
from swarmd.drivers.ros.messages import Twist as TwistMessage
from swarmd.drivers.ros.options import Ros1Options, read_options
from swarmd.drivers.ros.stop_topics import StopTopics
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros.zero_answers import ZeroAnswers
from swarmd.drivers.ros1 import adapter_process, serialization
from swarmd.drivers.ros1.adapter import (
    AdapterProcess,
    Event,
    ForeignMessage,
    MasterState,
    PublisherGone,
)
from swarmd.drivers.ros1.master_graph import MasterGraph, Ros1

log = logging.getLogger(__name__)

MIN_RESTART_DELAY = 0.1
MAX_RESTART_DELAY = 5.0
"""Seconds before an adapter that has ended is started again; the pause doubles up to the second.

If the adapter had connected to its base, the first pause is used: until the next adapter sends zero
the base may keep its velocity.
"""

TOPIC_TIMEOUT = 2.5
"""Seconds without a message after which a needed topic is lost; scans may come at 1 Hz."""

_Reported = tuple[bool, str, Reason | None, bool]
_NOTHING: _Reported = (False, "", None, False)
_WATCH_PERIOD = 0.1
_MIN_LOGGED_LOSS = 1.0  # s after which a loss for one reason is logged


class Ros1Driver:
    """Talks to one robot through a node of its own, `/swarmd_<robot>_<number>`."""

    is_simulated = False

    def __init__(
        self, *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
    ) -> None:
        """Not connected yet. Options: `Ros1Options`."""
        self._options = read_options(Ros1Options, options, "ros1", robot, platform)
        self._platform = platform
        self._node = "swarmd_" + re.sub(r"[^A-Za-z0-9_]", "_", robot)
        self._script = str(Path(adapter_process.__file__).resolve())
        self._sink: Sink | None = None
        self._child: AdapterProcess | None = None
        self._reported: _Reported = _NOTHING
        self._reported_at = math.inf
        self._logged = ""
        self._gate = CommandGate()
        self._zeros = ZeroAnswers(self._gate, partial(self._put, ZERO))
        self.command_source = StopTopics(self._options, self._put_state)
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
        self._sink = sink
        pause = MIN_RESTART_DELAY
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
            self._sink = None
            self._reported = _NOTHING
            self._logged = ""
            self._gate.end()

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command, that is a command that protection has checked.

        While the base is lost, commands are dropped, except:

        1. Zero for a stopped robot (`is_stopped`) is sent, since another node may command the base.
        2. For the first 2 s of a loss each command is sent as zero. Half a second of zeros disarms
           the adapter (adapter_process.py). Without these zeros the adapter would take the silence
           for the end of the daemon, and would send zeros against the next node that drives the
           base.

        The first command after a loss is sent as zero.
        """
        twist = ZERO if self._conflict else twist
        command = self._gate.filter(twist, is_stopped=is_stopped)
        if command is None and self._gate.repeats_zero(time.monotonic()):
            command = ZERO
        if command is not None:
            self._put(command)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Check topics, rates, types and clocks for `seconds`; each fault has the next step."""
        loop = asyncio.get_running_loop()
        begun = loop.time()
        task = asyncio.create_task(self._run_adapter(is_check=True))
        while not (task.done() or self._has_enough(loop.time() - begun)):
            graph = self._master.graph()
            if loop.time() - begun >= graph.check_time(self._subscriptions, seconds):
                break  # the findings name what is missing
            await asyncio.sleep(min(_WATCH_PERIOD, seconds))
        report = self._report()
        task.cancel()
        ended = (await asyncio.gather(task, return_exceptions=True))[0]
        if isinstance(ended, str):
            return (Finding("adapter", False, ended),)
        if report is None:
            return (Finding("adapter", False, f"not ready within {seconds:g} s; give it longer"),)
        return report.findings()

    def _begin(self) -> None:
        """Reset all that was received, for a new adapter process."""
        self._subscriptions = Subscriptions(self._options, self._platform, serialization.decode)
        self._master = MasterGraph(self._options, self._subscriptions.topics)
        self._end = ""
        self._is_planned_end = False
        self._was_up = False
        self._conflict: diagnosis.Conflict | None = None
        # Publishers of cmd_vel count as driving by their registration (`MasterGraph.blocks`).
        self._foreign = ForeignCommands(self._options, ROS1_ACTIONS, is_cmd_vel_shared=True)
        self._hears_motion = False

    def _report(self) -> diagnosis.DriverCheck | None:
        """The state of the robot for a check; None before the first event of the adapter."""
        state = self._master.state
        if state is None:
            return None
        return diagnosis.DriverCheck(
            graph=self._master.graph(),
            endpoint=self._options.master_uri,
            connection_fault="" if state.master else self._unreachable(state),
            subscriptions=self._subscriptions,
            spec=self._platform.scan,
            cmd_vel=self._master.cmd_vel,
            command_types=self._options.command_types,
            has_subscriber=bool(state.listeners),
            foreign=self._foreign,
            foreign_publishers=state.others,
            now=asyncio.get_running_loop().time(),
            is_exclusive=self._master.blocks,
        )

    def _has_enough(self, seconds: float) -> bool:
        state = self._master.state
        return bool(state and state.listeners) and diagnosis.has_enough(
            self._subscriptions, seconds
        )

    async def _run_adapter(self, *, is_check: bool) -> str:
        """Run an adapter process until it ends; returns how it ended."""
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
        """The configuration of an adapter process, as JSON values.

        The messages of the socket name a topic by its index in `topics`: first the topics of the
        subscriptions, then those of the states of actions, and behind them those of
        `command_topics`: of commands, then of stops. `definitions`: md5sum and definition of each
        message class of commands and stops. `kept_topics`: indices of topics whose last message
        counts until the next message, and of stops, which count at any age. `holds`: this adapter
        begins with zeros, since an earlier adapter has driven the robot.
        """
        options = self._options
        foreign = self._foreign
        subscriptions = self._subscriptions
        types_by_topic = [
            *((stats.topic, stats.message_type) for stats in subscriptions.topics.values()),
            *((topic, foreign.protocol.message_type) for topic in foreign.actions),
        ]
        definitions = {
            # `definition` gives (definition, md5sum), and the adapter takes (md5sum, definition).
            serialization.type_name(kind): serialization.definition(kind)[::-1]
            for kind in (TwistMessage, TwistStamped, String)
        }
        command_topics = [*foreign.topics, *self.command_source.topics]
        kept_topics = [
            index
            for index, topic in enumerate(
                (*(topic for topic, _ in types_by_topic), *command_topics)
            )
            if topic in subscriptions.kept_topics or topic in self.command_source.topics
        ]
        return {
            "master": options.master_uri,
            "name": self._node,
            "topics": [topic for topic, _ in types_by_topic],
            "types": [serialization.type_name(kind) for _, kind in types_by_topic],
            "md5sums": [serialization.definition(kind)[1] for _, kind in types_by_topic],
            "command_topics": command_topics,
            "state_topic": self.command_source.state_topic,
            "command_types": [serialization.type_name(kind) for kind in options.command_types],
            "definitions": definitions,
            "frame_id": options.cmd_vel_frame,
            "is_check": is_check,
            "kept_topics": kept_topics,
            "holds": not is_check and self._gate.has_sent,
        }

    # Called by the adapter

    def on_event(self, event: Event) -> None:
        """Take an event of the adapter."""
        if isinstance(event, MasterState):
            self._master.on_state(event)
        elif isinstance(event, ForeignMessage):
            self._master.on_foreign(event)
            self.on_dropped("type")
        elif isinstance(event, PublisherGone):
            self._subscriptions.forget([*self._subscriptions.topics.values()][event.topic].topic)
        elif event.kind == "fatal":
            self._end = no_rospy(self._options.python, event.text)
        else:
            self._end = event.text
            self._is_planned_end = event.kind == "restart"
        self._update_state()

    def on_message(self, topic: int, data: bytes) -> None:
        """Read a serialised message of topic number `topic`, and hand its values to the sink.

        The numbers behind those of the subscriptions are action states and commands of other nodes.
        """
        now = asyncio.get_running_loop().time()
        topics = [*self._subscriptions.topics.values()]
        if topic >= len(topics):
            self._on_foreign(topic - len(topics), data, now)
            return
        stats = topics[topic]
        try:
            deliver = self._subscriptions.read(stats.name, data, now)
        except CodecError as error:
            stats.record_fault(now, f"cannot be read: {error}")
            self.on_dropped(stats.name)
            return
        if not self._gate.is_open:
            self._update_state()
        is_driven = self._master.blocks or self._foreign.source(now)
        if (self._gate.is_open or is_driven) and self._sink is not None:
            deliver(self._sink)  # also while another node drives: a stop reports the speed

    def _on_foreign(self, index: int, data: bytes, now: float) -> None:
        """Take the states of an action's goals, or another node's command or stop.

        `index`: in the list of actions and then command topics of the adapter's configuration.
        """
        foreign = self._foreign
        names = [*foreign.actions, *foreign.topics, *self.command_source.topics]
        if index >= len(names):
            self.on_dropped("garbage")
        elif names[index] in self.command_source.topics:
            if not self.command_source.hear(names[index], data, serialization.decode, now):
                self.on_dropped(names[index])
        elif index >= len(foreign.actions):
            self._on_foreign_command(names[index], data, now)
        else:
            try:
                status: object = serialization.decode(foreign.protocol.message_type, data)
            except CodecError:
                self.on_dropped(names[index])
                return
            if foreign.take_status(names[index], status, now):
                self._update_state()

    def _on_foreign_command(self, topic: str, data: bytes, now: float) -> None:
        """Take the command of another node; a zero does not count as driving."""
        if not self._foreign.take_command(topic, data, (), now):
            return
        self._zeros.answer()
        if topic == self._master.cmd_vel:
            self._hears_motion = True
        else:
            self._update_state()

    def on_dropped(self, what: str) -> None:
        """Count one input that could not be read or used."""
        if self._sink is not None:
            self._sink.dropped(f"ros1/{what}")

    def _update_state(self) -> None:
        """Open or close the gate by the present faults, and report a change of state or reason."""
        if self._sink is None or self._child is None:
            return
        now = asyncio.get_running_loop().time()
        if self._gate.is_open:
            self._subscriptions.deliver_inputs(self._sink, now)
        state = self._master.state
        self._hears_motion &= bool(state and state.others)
        fault = self._end or self._fault(now)
        graph = self._master.graph()
        topics = self._subscriptions.topics.values()
        self._conflict = graph.conflict(topics, self._platform.scan)
        if fault:
            self._report_state(False, fault)
            return
        others = f", as is {', '.join(state.others)}" if state and state.others else ""
        text = f"drives on {self._master.cmd_vel} at {self._options.master_uri}{others}"
        doubt = graph.doubt(topics, self._platform.scan)
        self._report_state(True, self._conflict.text if self._conflict else doubt or text)

    def _fault(self, now: float) -> str:
        """Why the base cannot be driven, and the next step; empty if it can."""
        state = self._master.state
        master = self._master
        if state is None:
            return "its adapter is starting"
        if not state.master:
            return self._unreachable(state)
        if master.blocks:
            return diagnosis.also_published(
                master.cmd_vel, state.others, is_heard=self._hears_motion
            )
        graph = master.graph()
        if by_others := diagnosis.driven(self._foreign, graph, now):
            return by_others
        for stats in self._subscriptions.silent(now, TOPIC_TIMEOUT):
            is_unreadable = bool(stats.recent_fault(now))
            return graph.unreadable(stats) if is_unreadable else graph.silence(stats)
        # A connected node that the master does not list yet may be a base, too.
        has_base = graph.bases(master.cmd_vel) or not state.listeners
        if state.connected and has_base:
            return ""
        return graph.no_subscriber(
            master.cmd_vel, self._options.command_types, has_subscriber=bool(state.listeners)
        ) or diagnosis.unconnected(master.cmd_vel, state.listeners)

    def _unreachable(self, state: MasterState) -> str:
        return diagnosis.unreachable(Ros1(), self._options.master_uri, state.text)

    def _put(self, twist: Twist) -> None:
        kind = self._master.command_type
        if self._child is None or not kind:
            return  # the type of the base's commands is not known
        self._count += 1
        if not kind.endswith("Stamped"):
            command = serialization.encode_twist(twist)
        else:
            frame = self._options.cmd_vel_frame
            command = serialization.encode_twist_stamped(twist, self._count, time.time_ns(), frame)
        self._child.send(command)

    def _put_state(self, text: str) -> None:
        if self._child is not None:
            self._child.send(serialization.encode(String(text)), adapter_process.STATE)

    def _report_state(self, is_up: bool, text: str) -> None:
        """Set the gate, with a zero when it closes, and report and log a change of the state."""
        now = time.monotonic()
        was_up = self._gate.is_open
        self._was_up |= is_up
        if is_up and not was_up:
            self._gate.open()
        elif not is_up and self._gate.close(now):
            self._put(ZERO)
        state = self._master.state
        gets_zero = self._child is not None and state is not None and state.connected > 0
        hold = self._conflict.reason if self._conflict else None
        report = (is_up, text, hold, gets_zero)
        if self._reported[:2] != report[:2]:
            self._reported_at = now
        if self._sink is not None and self._reported != report:
            self._reported = report
            self._sink.state(is_up, text, hold=hold, gets_zero=gets_zero)
        if self._sink is not None and is_up and not was_up:
            opened = asyncio.get_running_loop().time()
            self._subscriptions.deliver_inputs(self._sink, opened, again=True)
        if is_up or was_up or now - self._reported_at > _MIN_LOGGED_LOSS:
            self._log(is_up, text)

    def _log(self, is_up: bool, text: str) -> None:
        if text != self._logged:
            self._logged = text
            log.log(logging.INFO if is_up else logging.WARNING, "driver ros1: %s", text)


def no_rospy(python: str, fault: str) -> str:
    """The text for an interpreter without rospy."""
    return (
        f"no rospy for {python} ({fault}); install python3-rospy, or correct driver_options.python"
    )
