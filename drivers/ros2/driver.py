"""The driver of ROS 2 robots over Zenoh, for both middlewares.

The middlewares are zenoh-bridge-ros2dds and rmw_zenoh. A hub is the Zenoh bridge or router at the
robot. A `KeyScheme` has the differences of the middlewares: keys, framing and liveliness tokens.
`RosDriver._watch` detects a lost base: silent topics, a hub that is gone or was started again, a
base that takes commands of another type.
"""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import zenoh
from zenoh.handlers import Callback

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.messages import Motion, Reason, ShownPose, Status
from swarmd.core.threads import hand_over
from swarmd.core.values import ZERO, Platform, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import NullSink, Sink, ZeroSenderSpec
from swarmd.drivers.latest_samples import LatestSamples
from swarmd.drivers.ros import cdr, diagnosis, from_ros
from swarmd.drivers.ros.endpoints import Endpoint, with_nodes
from swarmd.drivers.ros.foreign_commands import ROS2_ACTIONS, ForeignCommands
from swarmd.drivers.ros.messages import String
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.subscriptions import Deliver, Subscriptions
from swarmd.drivers.ros.topic_stats import TopicStats
from swarmd.drivers.ros.zero_answers import ZeroAnswers
from swarmd.drivers.ros2.admin_space import AdminSpaces, route_faults
from swarmd.drivers.ros2.command_credit import CommandCredit
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.drivers.ros2.node_tokens import NodeTokens
from swarmd.drivers.ros2.services import CommandServices
from swarmd.drivers.ros2.session import (
    KEPT,
    MAX_OPEN_TIME,
    OPEN_TIME,
    ask_hub,
    command_publisher,
    linked_hubs,
    open_session,
    query_kept,
    subscribe_with_history,
)
from swarmd.drivers.ros2.state_topics import StateTopics
from swarmd.drivers.ros2.zero_sender import zero_hint, zeros
from swarmd.link.carriers.session import has_subscriber, open_in_thread

log = logging.getLogger(__name__)

SENSOR_TIMEOUT = 1.0
"""Seconds without scan or odometry after which the base counts as lost; longer for slow scans."""

_PERIOD = 0.1  # s between two calls of `_watch`
_GRAPH_TIMEOUT = 1.0  # s for the query of the announcements
_EXPLAIN_PERIOD = 2.0  # s between two reports of why the base is lost
_MAX_ENDPOINTS = 4096
_MAX_TOKEN = 1000
_KEY_FAULT = ":type"  # ends the name of a topic whose sample came on a wrong key
_MIN_TIMEOUT_SCANS = 3.5  # scan periods after which a slow scanner's base counts as lost


class RosDriver:
    """Talks to one robot through the hub (Zenoh bridge or router) at `options.endpoint`.

    A command of the daemon passes `CommandGate`: the first command after each connection is zero,
    and no command passes while the base is lost. Then the command passes `CommandCredit`: a
    non-zero command waits for a sign of life of the hub. The driver itself sends zeros when the
    gate closes, for 2 s after a loss, and against the commands of another node (`ZeroAnswers`). No
    check delays a zero.
    """

    is_simulated = False

    def __init__(
        self,
        name: str,
        scheme: KeyScheme,
        platform: Platform,
        options: RosOptions,
        zero_sender: ZeroSenderSpec,
    ) -> None:
        """Connect nothing yet. `name`: of the driver.

        `zero_sender`: the watchdog's own connection to the base, which sends zeros alone.
        """
        self._name = name
        self._scheme = scheme
        self._platform = platform
        self._options = options
        self._zero_sender = zero_sender
        self._cmd_vel = options.topic(options.cmd_vel)
        self._zero_by_key = zeros(scheme, options)  # the zeros that this driver itself sends
        self._sensor_timeout = max(SENSOR_TIMEOUT, _MIN_TIMEOUT_SCANS / platform.scan.rate)
        self._subscriptions = Subscriptions(options, platform)
        sensed_types = [stats.message_type for stats in self._subscriptions.topics.values()]
        cdr.build_codecs(
            String, *options.command_types, *sensed_types
        )  # else the first message is late
        self._state = StateTopics(scheme, platform, options)
        self._services = CommandServices(scheme, options, lambda: not self._gate.is_open)
        self.command_source = self._services
        self._reset()

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the session reconnects by itself."""
        await self._run(sink, is_check=False)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Send a safe command; drop the command while the base is lost.

        The first command after a loss is sent as zero. Zero for a stopped robot (`is_stopped`) is
        sent even while the base is lost, since another node may command the base. A non-zero
        command waits for a sign of life of the hub (`CommandCredit`).
        """
        twist = ZERO if self._conflict else twist
        loop = asyncio.get_running_loop()
        command = self._gate.filter(twist, is_stopped=is_stopped)
        if command is not None:
            self._pass(self._credit.offer(command, loop.time()))
        if self._session is not None and self._credit.asks(loop.time()):
            ask_hub(self._session, partial(hand_over, loop, self._on_answer))

    @property
    def shows_state(self) -> bool:
        """True with the option `publish_state`."""
        return self._state.is_on

    def show(self, status: Status | None, motion: Motion | None, pose: ShownPose | None) -> None:
        """Keep the newest state of the robot, which the task of `run` publishes."""
        age = self._subscriptions.odometry_age(asyncio.get_running_loop().time())
        self._state.show(status, motion, pose, age)

    def zero_sender(self) -> ZeroSenderSpec:
        """How the watchdog sends zero to this base."""
        return self._zero_sender

    @property
    def zero_hint(self) -> str:
        """For the watchdog: the name of the message class of commands; empty while unknown."""
        return zero_hint(self._command_type)

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Check topics, rates, types and clocks for `seconds`; each fault has the next step."""
        loop = asyncio.get_running_loop()
        began = loop.time()
        task = asyncio.create_task(self._run(NullSink(), is_check=True))
        try:
            while not task.done():
                graph = self._foreign_graph()
                if loop.time() - began >= graph.check_time(self._subscriptions, seconds):
                    break
                if loop.time() - began >= seconds:
                    self._wake_sensors()
                await asyncio.sleep(min(_PERIOD, seconds))
                if diagnosis.has_enough(self._subscriptions, loop.time() - began) and not (
                    self._bridges.is_awaited(self._announcing())
                ):
                    break
            services = self._services.findings(self._bridges.nodes.endpoints)
            own_findings = *self._state.findings(), *services
            return (*self._report().findings(), *own_findings)
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _pass(self, twist: Twist | None) -> None:
        if twist is not None:
            self._put(twist, self._options.cmd_vel_frame if self._gate.is_open else "")

    def _on_answer(self) -> None:
        now = asyncio.get_running_loop().time()
        self._credit.hear(now)
        self._release(now)

    def _release(self, now: float) -> None:
        """Send the held command, if the credit permits it and the gate is still open."""
        held = self._credit.release(now)
        self._pass(None if held is None or self._conflict else self._gate.filter(held))

    def _report(self) -> diagnosis.DriverCheck:
        graph = self._foreign_graph()
        is_connected = self._session is not None and bool(linked_hubs(self._session))
        is_known = self._bridges.is_known(self._announcing())
        return diagnosis.DriverCheck(
            graph=graph,
            endpoint=self._options.endpoint,
            connection_fault="" if is_connected else self._unreachable(),
            subscriptions=self._subscriptions,
            spec=self._platform.scan,
            cmd_vel=self._cmd_vel,
            command_types=self._options.command_types,
            has_subscriber=any(map(has_subscriber, self._publishers.values())),
            foreign=self._foreign,
            unpassed=route_faults(self._bridges.nodes.dds, graph),
            foreign_publishers=[end.owner for end in graph.publishers(self._cmd_vel)],
            unlisted="" if is_known else diagnosis.unlisted(self._scheme),
            now=asyncio.get_running_loop().time(),
        )

    def _reset(self) -> None:
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens = NodeTokens(self._scheme)
        self._endpoints: dict[str, Endpoint] = {}
        self._foreign_ends: list[Endpoint] | None = None
        self._withdrawn_at = -math.inf
        self._graph_query: object | None = None
        self._kept: dict[str, Callable[[zenoh.Sample], None]] = {}
        self._hubs: frozenset[str] = frozenset()
        sensed = [stats.topic for stats in self._subscriptions.topics.values() if stats.is_needed]
        self._bridges = AdminSpaces(self._scheme.admin_space, sensed, self._cmd_vel, self._on_nodes)
        self._gate = CommandGate()
        self._credit = CommandCredit()
        self._zeros = ZeroAnswers(self._gate, partial(self._put, ZERO, frame=""))
        self._was_linked = False
        self._foreign = ForeignCommands(self._options, ROS2_ACTIONS)
        self._ended_servers: set[str] = set()  # of actions, by the topic of their status
        allowed = self._options.command_types
        self._command_type = self._opened_type = allowed[0] if len(allowed) == 1 else None
        self._reported: tuple[bool, str, Reason | None, bool] | None = None
        self._conflict: diagnosis.Conflict | None = None
        self._reported_at = -math.inf
        self._was_incomplete = False

    async def _run(self, sink: Sink, *, is_check: bool) -> None:
        """Connect, and feed the sink until cancelled; `is_check`: publish and announce nothing.

        `inbox` hands the samples from Zenoh's threads to `_take` in the loop.
        """
        loop = asyncio.get_running_loop()
        self._subscriptions = Subscriptions(self._options, self._platform)
        self._report_state(sink, False, f"no message yet from {self._options.endpoint}")
        session = await self._opened(sink)
        inbox = LatestSamples(loop, partial(self._take, sink, is_check), sink.dropped)
        try:
            self._session = session
            self._was_linked = True
            for key in self._zero_by_key:  # each key to which a base may subscribe for commands
                self._publishers[key] = command_publisher(session, key)
            self._subscribe(session, inbox, loop)
            if not is_check:
                self._state.open(session)
                self._services.open(session, loop)
            opened_at = loop.time()
            while True:
                await asyncio.sleep(_PERIOD)
                self._bridges.query(session, self._announcing(), loop)
                self._watch(sink, session, loop.time(), opened_at)
                self._state.publish()
                self._services.advance(sink.dropped)
        finally:  # in any case a last zero to a base that was driven, and no open session
            inbox.close()
            self._state.close()
            self._services.close()
            try:
                if self._gate.end():
                    self._put(ZERO, frame="")
            finally:  # an open session would keep the process for ever
                self._reset()
                session.close()

    async def _opened(self, sink: Sink) -> zenoh.Session:
        """Open the session, again and again until the hub answers; closed if this is cancelled."""
        within = OPEN_TIME
        while True:
            opening = partial(open_session, self._options.endpoint, within=within)
            session = await open_in_thread(opening)
            if session is not None:
                return session
            within = MAX_OPEN_TIME
            self._report_state(sink, False, self._unreachable())

    def _subscribe(
        self, session: zenoh.Session, inbox: LatestSamples, loop: asyncio.AbstractEventLoop
    ) -> None:
        """Declare all subscribers of a new session; their samples go to the inbox.

        Announcements of endpoints are liveliness tokens, which go to `_on_token` in the loop. Their
        callback is direct (`indirect=False`), so that no sample overtakes a token.
        """
        # Publishers keep the last message of a kept topic in a cache, for these receivers.
        self._kept = {
            topic: _receiver(self._scheme, inbox, f"{stats.name}{KEPT}", topic, stats.message_type)
            for topic, stats in self._subscriptions.kept_topics.items()
        }

        def on_token(sample: zenoh.Sample) -> None:
            is_declared = sample.kind == zenoh.SampleKind.PUT
            hand_over(loop, self._on_token, str(sample.key_expr), is_declared)

        session.liveliness().declare_subscriber(
            self._scheme.announcements, Callback(on_token, indirect=False), history=True
        )
        self._query_graph(session, loop)
        # Sensors; then commands and action states of other nodes, without this driver's own.
        key_of = self._scheme.subscription_key
        remote = zenoh.Locality.REMOTE
        for stats in self._subscriptions.topics.values():
            on_sample = _receiver(self._scheme, inbox, stats.name, stats.topic, stats.message_type)
            session.declare_subscriber(key_of(stats.topic), on_sample, allowed_origin=remote)
        for topic in (*self._foreign.topics, *self._services.topics):
            # Empty bytes as a command are unreadable, and an unreadable command may move the base.
            is_command = topic in self._foreign.topics
            on_sample = _command_receiver(inbox, topic, takes_empty=is_command)
            session.declare_subscriber(key_of(topic), on_sample, allowed_origin=remote)
        for topic in self._foreign.actions:
            subscribe_with_history(session, key_of(topic), _command_receiver(inbox, topic))

    def _query_graph(self, session: zenoh.Session, loop: asyncio.AbstractEventLoop) -> None:
        """Query the announcements; the base stays lost until the answer is complete.

        The answer must end after all tokens of `_subscribe`. So both have direct callbacks, which
        Zenoh's receiving thread runs in the order of the link. Indirect callbacks would have a
        thread of their own: a scan could overtake the token with the base's command type.
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
        """The answer to `_query_graph` has ended; query again if it was not complete."""
        if query is not self._graph_query or self._session is None:
            return  # the query belongs to an earlier start of the hub, or to an earlier run
        if is_complete:
            self._graph_query = None
        else:
            self._query_graph(self._session, loop)

    def _on_token(self, token: str, is_declared: bool) -> None:
        """Take the announcement of an endpoint (`is_declared`), or its withdrawal.

        A token with unprintable characters, or of another form, is ignored.
        """
        if len(token) > _MAX_TOKEN or not token.isprintable():
            return
        end = self._scheme.parse_token(token)
        if end is None:
            return
        now = asyncio.get_running_loop().time()
        self._foreign_ends = None  # `_foreign_graph` merges the endpoints again
        # Half of the table is for topics of this robot alone: other topics cannot fill the table.
        max_endpoints = _MAX_ENDPOINTS * (2 if end.topic in self._needed() else 1)
        if is_declared and len(self._endpoints) < max_endpoints:
            self._endpoints.setdefault(token, replace(end, since=now))
        elif not is_declared:
            self._endpoints.pop(token, None)
            self._withdrawn_at = now
        if end.is_publisher and end.topic in self._foreign.actions:
            self._on_action_server(end.topic, now)
        if not end.is_publisher and end.topic == self._cmd_vel:  # a base has come or left
            if not is_declared:
                self._gate.require_zero()  # the next base gets zero first
            self._command_type = self._wanted_type()
            self._bridges.renew()  # the bridge knows the node of the base
        if end.is_publisher and end.topic in self._kept and self._session:
            self._on_kept_publisher(self._session, end.topic, has_left=not is_declared)

    def _on_action_server(self, topic: str, now: float) -> None:
        """Take a change of the servers that publish the states of an action's goals on `topic`.

        When the last server has left, no state will say that a goal has ended. So all goals end
        now, and again after each state that comes late (`_ended_servers`).
        """
        self._ended_servers.discard(topic)
        if not self._foreign_graph().publishers(topic):
            self._ended_servers.add(topic)
            self._foreign.end_goals(topic, now)

    def _on_kept_publisher(self, session: zenoh.Session, topic: str, *, has_left: bool) -> None:
        """Drop the last message of a publisher that has left; query that of the present ones."""
        if has_left:
            self._subscriptions.forget(topic)
            if not self._foreign_graph().publishers(topic):
                return  # a bridge's cache outlives its DDS writer, and would answer
        query_kept(session, self._scheme.subscription_key(topic), self._kept[topic])

    def _on_nodes(self) -> None:
        """Take a new list of a bridge's nodes: the command type may be another."""
        self._foreign_ends = None
        self._command_type = self._wanted_type()

    def _announcing(self) -> frozenset[str]:
        """The ids of foreign Zenoh sessions that announce a topic of this robot."""
        topics = self._needed() - self._foreign.actions.keys()
        ends = self._endpoints.values()
        return frozenset(end.zid for end in ends if end.topic in topics) - {self._own_zid()}

    def _needed(self) -> frozenset[str]:
        """The full names of this robot's topics: commands, sensors, and states of actions."""
        sensed = (stats.topic for stats in self._subscriptions.topics.values())
        return frozenset((self._cmd_vel, *sensed, *self._foreign.actions))

    def _own_zid(self) -> str:
        return str(self._session.info.zid()) if self._session is not None else ""

    def _foreign_graph(self) -> diagnosis.Graph:
        """The endpoints of other nodes; cached in `_foreign_ends` until an announcement changes."""
        if self._foreign_ends is None:
            own = self._own_zid()
            asked_at = self._bridges.asked_at
            announced = [end for end in self._endpoints.values() if end.zid != own]
            ends = with_nodes(announced, self._bridges.nodes.endpoints, asked_at)
            is_newer = asked_at > self._withdrawn_at  # else the nodes listed may have left
            self._foreign_ends = [end for end in ends if end.is_routed or is_newer]
        return diagnosis.Graph(
            middleware=self._scheme,
            endpoints=self._foreign_ends,
            strays=self._bridges.nodes.strays,
            nodeless=self._bridges.nodes.nodeless,
            options=self._options,
            heard={stats.topic for stats in self._subscriptions.topics.values() if stats.count},
            now=asyncio.get_running_loop().time(),
        )

    def _wanted_type(self) -> type | None:
        allowed = self._options.command_types
        return self._foreign_graph().command_type(self._cmd_vel, allowed)

    def _take(self, sink: Sink, is_check: bool, name: str, payload: bytes) -> None:
        now = asyncio.get_running_loop().time()
        self._credit.hear(now)
        self._accept(sink, is_check, name, payload, now)
        self._release(now)  # the held command, unless the message has led to a newer command

    def _accept(self, sink: Sink, is_check: bool, name: str, payload: bytes, now: float) -> None:
        """Take a message by its name.

        It is of a foreign command, an action state, a stop, a wrong key, or a sensor.
        """
        if name in self._foreign.topics:
            self._on_command(sink, name, payload, now)
        elif name in self._foreign.actions:
            self._on_status(sink, name, payload, now)
        elif name in self._services.topics:
            if not self._services.hear(name, payload, cdr.decode, now):
                sink.dropped(f"{name}:refused")
        elif name.endswith(_KEY_FAULT):
            name = name.removesuffix(_KEY_FAULT).removesuffix(KEPT)
            stats = self._subscriptions.topics[name]
            stats.record_fault(now, payload.decode(errors="replace"))
            sink.dropped(f"{name}{_KEY_FAULT}")
        else:
            try:
                deliver = self._read(name, payload, now)
            except CodecError as error:
                name = name.removesuffix(KEPT)
                self._subscriptions.topics[name].record_fault(now, f"cannot be read: {error}")
                sink.dropped(name)
                return
            self._open_gate(sink, is_check, now)
            if self._gate.is_open or self._foreign.source(now):
                deliver(sink)  # also while another node drives: a stop reports the measured speed

    def _read(self, name: str, payload: bytes, now: float) -> Deliver:
        """Decode a message, new or from a publisher's cache (name ending in KEPT)."""
        topic = name.removesuffix(KEPT)
        if topic == name:
            return self._subscriptions.read(name, payload, now)
        if not self._foreign_graph().publishers(self._subscriptions.topics[topic].topic):
            # The publisher of the kept message has left meanwhile.
            return partial(self._subscriptions.deliver_inputs, now=now)
        return self._subscriptions.read(topic, payload, now, is_kept=True)

    def _on_command(self, sink: Sink, topic: str, payload: bytes, now: float) -> None:
        """Take the command of another node; a zero does not count as driving.

        This driver then stops driving (the gate closes). If the robot must stand, zero follows at
        once (`ZeroAnswers`).
        """
        graph = self._foreign_graph()
        types = [end.type for end in graph.publishers(topic)]
        if not self._foreign.take_command(topic, payload, types, now):
            return
        if self._gate.is_open:
            self._close_gate(sink, diagnosis.driven(self._foreign, graph, now))
        self._zeros.answer()

    def _on_status(self, sink: Sink, topic: str, payload: bytes, now: float) -> None:
        """Take the states of an action's goals; an active goal drives the base."""
        try:
            status: object = cdr.decode(ROS2_ACTIONS.message_type, payload)
        except CodecError:
            sink.dropped(topic)
            return
        is_active = self._foreign.take_status(topic, status, now)
        if topic in self._ended_servers:  # the server's withdrawal has overtaken its last status
            self._foreign.end_goals(topic, now)
        if is_active and self._gate.is_open:
            self._close_gate(sink, diagnosis.driven(self._foreign, self._foreign_graph(), now))

    def _open_gate(self, sink: Sink, is_check: bool, now: float) -> None:
        """Open the gate if a sign of life has just come and the base may be commanded."""
        if self._gate.is_open or self._subscriptions.last_arrival < now or self._command_fault(now):
            return
        self._conflict = self._find_conflict()
        self._gate.open()
        self._report_state(sink, True, self._conflict.text if self._conflict else self._place())
        self._subscriptions.deliver_inputs(sink, now, again=True)
        if self._scheme.is_node and not is_check:
            self._announce(self._command_type)
        self._opened_type = self._command_type

    def _wake_sensors(self) -> None:
        """Announce the subscriptions of a check: a sensor may sleep until a node subscribes."""
        graph = self._foreign_graph()
        topics = self._subscriptions.topics.values()
        are_heard = all(stats.count for stats in topics if stats.is_needed)
        is_due = self._scheme.is_node and not self._tokens.are_declared and not are_heard
        if self._session is not None and is_due:
            subscribed = [_subscribed_end(stats, graph) for stats in topics]
            self._tokens.declare(self._session, subscribed)

    def _announce(self, command_type: type | None) -> None:
        """Announce this driver, with all its ends, as a ROS node; again for another type."""
        if self._session is None or command_type is None:
            return
        if self._tokens.are_declared and command_type is self._opened_type:
            return
        graph = self._foreign_graph()
        topics = self._subscriptions.topics.values()
        subscribed = [_subscribed_end(stats, graph) for stats in topics]
        command = TopicEnd(
            self._cmd_vel, command_type, is_publisher=True, is_reliable=True, depth=1
        )
        publishers = [*self._state.ends, command]
        self._state.announced(self._tokens.declare(self._session, subscribed, publishers))

    def _close_gate(self, sink: Sink, text: str) -> None:
        if self._gate.close(asyncio.get_running_loop().time()):
            # Without a frame the bytes of a TwistStamped are zero even when read as a Twist.
            self._put(ZERO, frame="")
        self._report_state(sink, False, text)

    def _watch(self, sink: Sink, session: zenoh.Session, now: float, opened_at: float) -> None:
        """Detect changes of hub, topics and base, each _PERIOD; times in s of the loop's clock.

        A loss closes the gate. Without a loss, a changed conflict or a changed link is reported.
        """
        was_linked = self._was_linked
        is_same_hub = self._watch_hub(session, now)
        if self._gate.is_open:
            self._subscriptions.deliver_inputs(sink, now)
        last_conflict = self._conflict
        self._conflict = self._find_conflict()
        if self._gate.is_open and (loss := self._loss(now, is_same_hub=is_same_hub)):
            self._close_gate(sink, loss)
        elif self._gate.is_open and last_conflict != self._conflict:
            self._report_state(sink, True, self._conflict.text if self._conflict else self._place())
        elif self._reported is not None and was_linked != self._was_linked:
            # Report the same state again: `gets_zero` has changed with the link.
            self._report_state(sink, *self._reported[:2])
        elif self._gate.repeats_zero(now) and not self._foreign.source(now):
            self._put(ZERO, frame="")
        if now - self._reported_at >= _EXPLAIN_PERIOD and now - opened_at >= _EXPLAIN_PERIOD:
            self._explain(sink, now)

    def _watch_hub(self, session: zenoh.Session, now: float) -> bool:
        """False if the session is linked to another hub than before.

        A hub is the Zenoh router or bridge that the session is linked to, by its id. A hub that was
        started again has another id. Sets `_was_linked`, and `_hubs`, the last linked hubs.
        """
        last_hubs = self._hubs
        was_linked = self._was_linked
        hubs = linked_hubs(session)
        self._hubs = hubs or last_hubs
        self._was_linked = bool(hubs)
        if hubs and (not was_linked or hubs != last_hubs):
            self._gate.repeat_zero(now)  # the base may have missed the last zero
            if last_hubs:  # the first link of a session has its query already
                self._query_graph(session, asyncio.get_running_loop())
        if not hubs and was_linked:
            self._subscriptions.forget()  # messages on change may be missed from now on
        return not last_hubs or self._hubs == last_hubs

    def _loss(self, now: float, *, is_same_hub: bool) -> str:
        """Why the base, connected so far, is lost now; empty if it is still connected."""
        if not self._was_linked:
            return self._unreachable()
        if not is_same_hub:
            return f"{self._place()} was started again"
        silence_s = now - self._subscriptions.last_arrival
        if silence_s > self._sensor_timeout:
            return f"no scan and no odometry from {self._place()} for {silence_s:.1f} s"
        if fault := self._command_fault(now):
            return fault
        if self._command_type is not self._opened_type:
            return f"the base wants another type of commands on {self._cmd_vel} now"
        return ""

    def _explain(self, sink: Sink, now: float) -> None:
        """Report again why the base is lost, or what is missing although the base is connected."""
        text = self._unreachable()
        if self._was_linked:
            is_alive = now - self._subscriptions.last_arrival <= self._sensor_timeout
            fault = self._command_fault(now) if is_alive or self._foreign.source(now) else ""
            text = fault or self._topic_fault(now) or self._place()
        self._report_state(sink, self._gate.is_open, text)

    def _command_fault(self, now: float) -> str:
        """Why the base must not be commanded although its messages arrive; empty otherwise."""
        graph = self._foreign_graph()
        if by_others := diagnosis.driven(self._foreign, graph, now):
            return by_others
        if self._graph_query is not None:
            return f"{self._place()} has not listed its nodes yet"
        if not self._gate.is_open and self._bridges.is_awaited(self._announcing()):
            return f"{self._place()} has not listed its nodes yet"
        # Where nothing was ever announced, the subscribers of the base are unknown.
        is_unknown = not graph.endpoints and math.isinf(self._withdrawn_at)
        is_heard = is_unknown or any(map(has_subscriber, self._publishers.values()))
        allowed = self._options.command_types
        return graph.no_subscriber(self._cmd_vel, allowed, has_subscriber=is_heard)

    def _topic_fault(self, now: float) -> str:
        """The first fault of the robot's topics; empty without a fault."""
        if self._foreign.has_lasting_zeros(now):
            return (
                f"another node stops this robot: zeros on {self._cmd_vel} that are not this"
                " driver's, such as those of the watchdog of an earlier daemon; end that node"
            )
        graph = self._foreign_graph()
        topics = self._subscriptions.topics.values()
        silent = self._subscriptions.silent(now, max(_EXPLAIN_PERIOD, self._sensor_timeout))
        unpassed = route_faults(self._bridges.nodes.dds, graph)
        faults = (
            self._conflict.text if self._conflict else "",
            *(graph.unreadable(stats) for stats in topics if stats.recent_fault(now)),
            *(unpassed.get(stats.topic) or graph.silence(stats) for stats in silent),
            unpassed.get(self._cmd_vel, ""),
            *(graph.silence(stats) for stats in self._subscriptions.awaited(now)),
        )
        fault = next(filter(None, faults), "") or self._incompleteness()
        return fault or graph.doubt(topics, self._platform.scan)

    def _find_conflict(self) -> diagnosis.Conflict | None:
        topics = self._subscriptions.topics.values()
        return self._foreign_graph().conflict(topics, self._platform.scan)

    def _incompleteness(self) -> str:
        """What scans lack, if the last two calls both found a fault; empty otherwise."""
        was_incomplete = self._was_incomplete
        stats = next(iter(self._subscriptions.topics.values()))
        fault = diagnosis.incomplete(stats, self._subscriptions.contents[stats.option])
        self._was_incomplete = bool(fault)
        return fault if was_incomplete else ""

    def _place(self) -> str:
        return f"{self._scheme.hub} at {self._options.endpoint}"

    def _unreachable(self) -> str:
        return diagnosis.unreachable(self._scheme, self._options.endpoint)

    def _report_state(self, sink: Sink, is_up: bool, text: str) -> None:
        """Report the state of the base if it has changed; log a change of `is_up` or `text`."""
        self._reported_at = asyncio.get_running_loop().time()
        hold = self._conflict.reason if self._conflict else None
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
        """Publish a command in the type of the base.

        While the type is not known, zero is published in each type, and other commands are dropped.
        """
        kind = self._command_type
        if kind is None:
            sent = self._zero_by_key if twist.is_zero else {}
        else:
            message = from_ros.command_message(twist, kind, frame)
            sent = {self._scheme.key(self._cmd_vel, kind): cdr.encode(message)}
        for key, payload in sent.items():
            if key in self._publishers:
                attachment = self._scheme.attachment(self._tokens.command)
                self._publishers[key].put(payload, attachment=attachment)


def _subscribed_end(stats: TopicStats, graph: diagnosis.Graph) -> TopicEnd:
    """The subscription of a topic as this node announces it."""
    is_reliable = graph.is_reliable(stats.topic)
    return TopicEnd(
        stats.topic, stats.message_type, is_publisher=False, is_reliable=is_reliable, depth=1
    )


def _command_receiver(
    inbox: LatestSamples, topic: str, *, takes_empty: bool = False
) -> Callable[[zenoh.Sample], None]:
    """A callback that puts the samples of a topic of commands, stops or states into the inbox.

    A sample on a wildcard key may have any type, and counts as empty bytes. Without `takes_empty`
    empty bytes are dropped here: in the inbox they would replace a stop that waits.
    """

    def on_sample(sample: zenoh.Sample) -> None:
        payload = b"" if "*" in str(sample.key_expr) else sample.payload.to_bytes()
        if payload or takes_empty:
            inbox.put(topic, payload)
        else:
            inbox.drop(f"{topic}:refused")

    return on_sample


def _receiver(
    scheme: KeyScheme, inbox: LatestSamples, name: str, topic: str, message_type: type
) -> Callable[[zenoh.Sample], None]:
    """A callback that puts a topic's samples into the inbox as `name`, or a fault of the key."""

    def on_sample(sample: zenoh.Sample) -> None:
        fault = scheme.key_fault(str(sample.key_expr), topic, message_type)
        if fault:
            inbox.put(f"{name}{_KEY_FAULT}", fault.encode())
        else:
            inbox.put(name, sample.payload.to_bytes())

    return on_sample
