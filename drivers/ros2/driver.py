"""A ROS 2 robot over a Zenoh session of its own; a key scheme gives keys, framing and tokens."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial

import zenoh
from zenoh.handlers import Callback

from swarmd.core.errors import CodecError
from swarmd.core.messages import Reason
from swarmd.core.threads import hand_over
from swarmd.core.values import ZERO, Platform, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, NullSink, Sink, ZeroSenderSpec
from swarmd.drivers.latest_samples import LatestSamples
from swarmd.drivers.ros import cdr, from_ros
from swarmd.drivers.ros.diagnosis import (
    Endpoint,
    Graph,
    Report,
    driven_by_others,
    has_enough,
    incomplete,
    scan_conflict,
    unreachable,
)
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.subscriptions import Subscriptions
from swarmd.drivers.ros2.duplicate_nodes import DuplicateNodes
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.drivers.ros2.session import command_publisher, linked_hubs, open_session
from swarmd.network.session import has_subscriber, open_in_thread

log = logging.getLogger(__name__)

SENSOR_TIMEOUT = 1.0
"""Seconds without scan or odometry after which the base counts as lost; longer for slow scans."""
YIELD_TIME = 2.0
"""Seconds without commands after another node has published a non-zero one."""

MAX_FOREIGN_ZEROS = 3.0
"""Seconds of another node's zeros after which they are reported; a watchdog's last 2 s."""

_PERIOD = 0.1
_GRAPH_TIMEOUT = 1.0
_EXPLAIN_PERIOD = 2.0
_MAX_ENDPOINTS, _MAX_TOKEN = 4096, 1000
_COMMAND = "cmd_vel"
_KEY_FAULT = ":type"


class RosDriver:
    """Talks to one robot through the hub at `options.endpoint`."""

    is_simulated = False

    def __init__(
        self,
        name: str,
        scheme: KeyScheme,
        platform: Platform,
        options: RosOptions,
        zero_sender: ZeroSenderSpec,
    ) -> None:
        """Not connected yet."""
        self._name, self._scheme, self._platform = name, scheme, platform
        self._options, self._zero_sender = options, zero_sender
        self._cmd_vel = options.topic(options.cmd_vel)
        self._command_type = options.command_type
        self._sensor_timeout = max(SENSOR_TIMEOUT, 3.5 / platform.scan.rate)
        self._subscriptions = Subscriptions(options, platform)
        cdr.warm(self._command_type, *(t.message_type for t in self._subscriptions.topics.values()))
        self._reset()

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the session reconnects by itself."""
        await self._run(sink, is_check=False)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back.

        A stopped robot is sent zero also while the base is lost: another node may command it.
        """
        command = self._gate.filter(twist, is_stopped=is_stopped)
        if command is not None:
            self._put(command, self._options.cmd_vel_frame if self._gate.is_open else "")

    def zero_sender(self) -> ZeroSenderSpec:
        """How the watchdog sends zero to this base."""
        return self._zero_sender

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Topics, rates, types, clocks and what is missing, each with the next step."""
        loop = asyncio.get_running_loop()
        began = loop.time()
        task = asyncio.create_task(self._run(NullSink(), is_check=True))
        try:
            while loop.time() - began < seconds and not task.done():
                await asyncio.sleep(min(_PERIOD, seconds))
                if has_enough(self._subscriptions, loop.time() - began):
                    break
            return self._report().findings()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _report(self) -> Report:
        graph = self._foreign_graph()
        is_connected = self._session is not None and bool(linked_hubs(self._session))
        return Report(
            graph=graph,
            endpoint=self._options.endpoint,
            connection_fault="" if is_connected else self._unreachable(),
            subscriptions=self._subscriptions,
            spec=self._platform.scan,
            cmd_vel=self._cmd_vel,
            command_type=self._command_type,
            has_subscriber=self._has_subscriber(),
            foreign_commands=self._foreign_commands,
            foreign_publishers=[end.owner for end in graph.publishers(self._cmd_vel)],
            now=asyncio.get_running_loop().time(),
        )

    def _reset(self) -> None:
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: list[zenoh.LivelinessToken] = []
        self._command_token = ""
        self._endpoints: dict[str, Endpoint] = {}
        self._graph_query: object | None = None
        self._hubs: frozenset[str] = frozenset()
        self._duplicates = DuplicateNodes(self._scheme.nodes, self._cmd_vel)
        self._gate = CommandGate()
        self._was_linked = False
        self._foreign_motion_at = -math.inf
        self._foreign_zeros_from = self._foreign_zero_at = -math.inf
        self._foreign_commands = 0
        self._reported: tuple[bool, str, Reason | None, bool] | None = None
        self._conflict = ""
        self._reported_at = -math.inf
        self._was_incomplete = False

    async def _run(self, sink: Sink, *, is_check: bool) -> None:
        loop = asyncio.get_running_loop()
        self._subscriptions = Subscriptions(self._options, self._platform)
        self._report_state(sink, False, f"no message yet from {self._options.endpoint}")
        session = await self._opened(sink)
        inbox = LatestSamples(loop, partial(self._take, sink, is_check), sink.dropped)
        try:
            self._session, self._was_linked = session, True
            for key in self._scheme.command_keys(self._cmd_vel, self._command_type):
                self._publishers[key] = command_publisher(session, key)
            self._listen(session, inbox, loop)
            opened = loop.time()
            while True:
                await asyncio.sleep(_PERIOD)
                self._duplicates.query(session, loop.time())
                self._watch(sink, session, loop.time(), opened)
        finally:
            inbox.close()
            try:
                if self._gate.end():
                    self._put(ZERO, frame="")
            finally:  # an open session would keep the process for ever
                self._reset()
                session.close()

    async def _opened(self, sink: Sink) -> zenoh.Session:
        """A session, opened once something listens at the endpoint; closed if this is cancelled."""
        while True:
            session = await open_in_thread(partial(open_session, self._options.endpoint))
            if session is not None:
                return session
            self._report_state(sink, False, self._unreachable())

    def _listen(
        self, session: zenoh.Session, inbox: LatestSamples, loop: asyncio.AbstractEventLoop
    ) -> None:
        def on_token(sample: zenoh.Sample) -> None:
            is_there = sample.kind == zenoh.SampleKind.PUT
            hand_over(loop, self._on_token, str(sample.key_expr), is_there)

        session.liveliness().declare_subscriber(
            self._scheme.announcements, Callback(on_token, indirect=False), history=True
        )
        self._query_graph(session, loop)
        topics = [(t.name, t.topic, t.message_type) for t in self._subscriptions.topics.values()]
        for name, topic, message_type in (
            *topics,
            (_COMMAND, self._cmd_vel, self._command_type),
        ):
            session.declare_subscriber(
                self._scheme.subscription_key(topic),
                _receiver(self._scheme, inbox, name, topic, message_type),
                allowed_origin=zenoh.Locality.REMOTE,
            )

    def _query_graph(self, session: zenoh.Session, loop: asyncio.AbstractEventLoop) -> None:
        """Query the announcements: the base stays lost until the answer is complete.

        Its end arrives after the tokens of `_listen`, in the order of the link: their callbacks run
        on the thread that receives. The usual ones have a thread each, and a scan may overtake the
        token that names the command type of the base.
        """
        self._graph_query = query = object()
        errors: list[zenoh.ReplyError] = []

        def on_reply(reply: zenoh.Reply) -> None:
            errors.extend([reply.err] if reply.err is not None else [])

        def on_end() -> None:
            hand_over(loop, self._on_graph, loop, query, not errors)

        session.liveliness().get(
            self._scheme.announcements,
            Callback(on_reply, on_end, indirect=False),
            timeout=_GRAPH_TIMEOUT,
        )

    def _on_graph(self, loop: asyncio.AbstractEventLoop, query: object, is_complete: bool) -> None:
        if query is not self._graph_query or self._session is None:
            return  # of an earlier start of the hub, or of an earlier run
        if is_complete:
            self._graph_query = None
        else:
            self._query_graph(self._session, loop)

    def _on_token(self, token: str, is_there: bool) -> None:
        if len(token) > _MAX_TOKEN or not token.isprintable():
            return
        end = self._scheme.parse_token(token)
        if end is None:
            return
        if is_there and len(self._endpoints) < _MAX_ENDPOINTS:
            self._endpoints[token] = end
        elif not is_there:
            self._endpoints.pop(token, None)
            if not end.is_publisher and end.topic == self._cmd_vel:
                self._gate.require_zero()

    def _foreign_graph(self) -> Graph:
        """The endpoints of others."""
        own = str(self._session.info.zid()) if self._session is not None else ""
        foreign = [end for end in self._endpoints.values() if end.zid != own]
        return Graph(middleware=self._scheme, endpoints=foreign)

    def _take(self, sink: Sink, is_check: bool, name: str, payload: bytes) -> None:
        now = asyncio.get_running_loop().time()
        if name.removesuffix(_KEY_FAULT) == _COMMAND:
            self._on_command(sink, name, payload, now)
        elif name.endswith(_KEY_FAULT):
            stats = self._subscriptions.topics[name.removesuffix(_KEY_FAULT)]
            stats.record_fault(now, payload.decode(errors="replace"))
            sink.dropped(name)
        else:
            try:
                deliver = self._subscriptions.read(name, payload, now)
            except CodecError as error:
                self._subscriptions.topics[name].record_fault(now, f"cannot be read: {error}")
                sink.dropped(name)
                return
            self._open_gate(sink, is_check, now)
            if self._gate.is_open or now - self._foreign_motion_at < YIELD_TIME:
                deliver(sink)  # also while another node drives: a stop tells the measured speed

    def _on_command(self, sink: Sink, name: str, payload: bytes, now: float) -> None:
        """Another node publishes a command; a zero does not count as driving.

        If the robot must stand, zero follows at once. Else this driver falls silent.
        """
        self._foreign_commands += 1
        if name == _COMMAND:
            try:
                if from_ros.twist_of(cdr.decode(self._command_type, payload)).is_zero:
                    if now - self._foreign_zero_at > YIELD_TIME:
                        self._foreign_zeros_from = now
                    self._foreign_zero_at = now
                    return
            except CodecError:
                pass  # of another type than ours: it may well move the robot
        self._foreign_motion_at = now
        if self._gate.is_open:
            self._close_gate(sink, driven_by_others(self._cmd_vel))
        elif self._gate.is_stopped:
            self._put(ZERO, frame="")

    def _open_gate(self, sink: Sink, is_check: bool, now: float) -> None:
        if self._gate.is_open or self._subscriptions.last_arrival < now or self._obstacle(now):
            return
        self._gate.open()
        self._report_state(sink, True, self._conflict or self._place())
        if self._scheme.is_node and not is_check and not self._tokens and self._session is not None:
            ends = [
                TopicEnd(t.topic, t.message_type, is_publisher=False, is_reliable=False, depth=1)
                for t in self._subscriptions.topics.values()
            ]
            command = TopicEnd(
                self._cmd_vel, self._command_type, is_publisher=True, is_reliable=True, depth=1
            )
            tokens = self._scheme.tokens(str(self._session.info.zid()), [*ends, command])
            self._command_token = tokens[-1]
            self._tokens += map(self._session.liveliness().declare_token, tokens)

    def _close_gate(self, sink: Sink, text: str) -> None:
        if self._gate.close(asyncio.get_running_loop().time()):
            self._put(ZERO, frame="")  # without a frame it is zero also as a Twist
        self._report_state(sink, False, text)

    def _watch(self, sink: Sink, session: zenoh.Session, now: float, opened: float) -> None:
        hubs, before = linked_hubs(session), self._hubs
        self._hubs = hubs or before
        silent = now - self._subscriptions.last_arrival
        if hubs and (not self._was_linked or hubs != before):
            self._gate.repeat_zero(now)
            if before:
                self._query_graph(session, asyncio.get_running_loop())
        if stale := self._subscriptions.stale_readings(now):
            stale(sink)
        was_linked, self._was_linked = self._was_linked, bool(hubs)
        conflict, self._conflict = self._conflict, self._scan_conflict()
        if self._gate.is_open and not hubs:
            self._close_gate(sink, self._unreachable())
        elif self._gate.is_open and before and hubs != before:
            self._close_gate(sink, f"{self._place()} was started again")
        elif self._gate.is_open and silent > self._sensor_timeout:
            self._close_gate(
                sink, f"no scan and no odometry from {self._place()} for {silent:.1f} s"
            )
        elif self._gate.is_open and (obstacle := self._obstacle(now)):
            self._close_gate(sink, obstacle)
        elif self._gate.is_open and conflict != self._conflict:
            self._report_state(sink, True, self._conflict or self._place())
        elif self._reported is not None and was_linked != self._was_linked:
            self._report_state(sink, *self._reported[:2])  # zeros of a stopped robot arrive now
        elif self._gate.repeats_zero(now) and now - self._foreign_motion_at >= YIELD_TIME:
            self._put(ZERO, frame="")
        if now - self._reported_at >= _EXPLAIN_PERIOD and now - opened >= _EXPLAIN_PERIOD:
            self._explain(sink, now, is_linked=bool(hubs))

    def _explain(self, sink: Sink, now: float, *, is_linked: bool) -> None:
        """Report again why the base is lost, or what is missing although it is connected."""
        if is_linked:
            is_alive = now - self._subscriptions.last_arrival <= self._sensor_timeout
            obstacle = (
                self._obstacle(now)
                if is_alive or now - self._foreign_motion_at < YIELD_TIME
                else ""
            )
            self._report_state(
                sink, self._gate.is_open, obstacle or self._trouble(now) or self._place()
            )
        else:
            self._report_state(sink, self._gate.is_open, self._unreachable())

    def _obstacle(self, now: float) -> str:
        """Why the base must not be commanded although its messages arrive; empty otherwise."""
        if now - self._foreign_motion_at < YIELD_TIME:
            return driven_by_others(self._cmd_vel)
        if self._graph_query is not None:
            return f"{self._place()} has not listed its nodes yet"
        if self._duplicates.duplicate:
            node, hub = self._duplicates.duplicate, self._scheme.hub
            return f"{node} crashed and is back; {hub} will forget it: start that again"
        graph = self._foreign_graph()
        # Without announcements the subscribers of the base are unknown.
        has_subscriber = not graph.endpoints or self._has_subscriber()
        return graph.no_subscriber(self._cmd_vel, self._command_type, has_subscriber=has_subscriber)

    def _has_subscriber(self) -> bool:
        return any(has_subscriber(publisher) for publisher in self._publishers.values())

    def _trouble(self, now: float) -> str:
        """The first fault of the robot's topics; empty without one."""
        lasts = self._foreign_zero_at - self._foreign_zeros_from
        if lasts > MAX_FOREIGN_ZEROS and now - self._foreign_zero_at < YIELD_TIME:
            return (
                f"another node stops this robot: zeros on {self._cmd_vel} that are not this"
                " driver's, such as those of the watchdog of an earlier daemon; end that node"
            )
        graph, topics = self._foreign_graph(), self._subscriptions.topics.values()
        silent = self._subscriptions.silent(now, max(_EXPLAIN_PERIOD, self._sensor_timeout))
        faults = (
            self._conflict,
            *(graph.unreadable(stats) for stats in topics if stats.recent_fault(now)),
            *(graph.silence(stats) for stats in silent),
            *(graph.unreliable(stats) for stats in topics if stats.is_needed),
        )
        return next(filter(None, faults), "") or self._incompleteness()

    def _scan_conflict(self) -> str:
        return scan_conflict(self._foreign_graph(), self._subscriptions.topics.values())

    def _incompleteness(self) -> str:
        """What all scans lack, as far as the last two that were examined tell."""
        scan, was_incomplete = self._subscriptions.scan, self._was_incomplete
        stats = next(iter(self._subscriptions.topics.values()))
        fault = "" if scan is None else incomplete(stats, scan, self._platform.scan)
        self._was_incomplete = bool(fault)
        return fault if was_incomplete else ""

    def _unreachable(self) -> str:
        return unreachable(self._scheme, self._options.endpoint)

    def _place(self) -> str:
        return f"{self._scheme.hub} at {self._options.endpoint}"

    def _report_state(self, sink: Sink, is_up: bool, text: str) -> None:
        self._reported_at = asyncio.get_running_loop().time()
        hold = Reason.SCAN_CONFLICT if self._conflict else None
        report = (is_up, text, hold, self._was_linked)
        if self._reported == report:
            return
        is_new = self._reported is not None and self._reported[:2] != (is_up, text)
        if is_new and not isinstance(sink, NullSink):
            is_well = is_up and text == self._place()
            log.log(logging.INFO if is_well else logging.WARNING, "driver %s: %s", self._name, text)
        self._reported = report
        sink.state(is_up, text, hold=hold, gets_zero=self._was_linked)

    def _put(self, twist: Twist, frame: str) -> None:
        publisher = self._publishers.get(self._scheme.key(self._cmd_vel, self._command_type))
        if publisher is None:
            return
        message = from_ros.command_message(twist, self._command_type, frame)
        publisher.put(cdr.encode(message), attachment=self._scheme.attachment(self._command_token))


def _receiver(
    scheme: KeyScheme, inbox: LatestSamples, name: str, topic: str, message_type: type
) -> Callable[[zenoh.Sample], None]:
    def on_sample(sample: zenoh.Sample) -> None:
        fault = scheme.key_fault(str(sample.key_expr), topic, message_type)
        if fault:
            inbox.put(f"{name}{_KEY_FAULT}", fault.encode())
        else:
            inbox.put(name, sample.payload.to_bytes())

    return on_sample
