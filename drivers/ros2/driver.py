"""A ROS 2 robot over a Zenoh session of its own: what both dialects share but keys and framing."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable
from functools import partial

import zenoh

from swarmd.core.errors import CodecError
from swarmd.core.threads import hand_over
from swarmd.core.values import ZERO, Platform, Twist
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import Finding, NullSink, SenderSpec, Sink
from swarmd.drivers.latest_samples import LatestSamples
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import from_ros as conversion
from swarmd.drivers.ros.diagnosis import (
    Report,
    has_enough,
    unheard,
    why_blind,
    why_misleading,
    why_refused,
    why_silent,
    why_unheard,
)
from swarmd.drivers.ros.messages import Twist as TwistMessage
from swarmd.drivers.ros.messages import TwistStamped
from swarmd.drivers.ros.options import RosOptions, topic
from swarmd.drivers.ros2.duplicate_nodes import DuplicateNodes
from swarmd.drivers.ros2.key_scheme import Endpoint, KeyScheme
from swarmd.drivers.ros2.session import commanding, has_subscriber, hubs_of, open_session
from swarmd.drivers.ros2.subscriptions import Subscriptions
from swarmd.network.session import open_in_thread

log = logging.getLogger(__name__)

SILENCE = 1.0
"""Seconds without scan or odometry after which the base counts as lost; longer for slow scans."""
OTHERS_LAST = 2.0
"""Seconds for which somebody else's command keeps this driver from commanding."""

ZEROS_OF_OTHERS = 3.0
"""Seconds after which zeros that others say are told of: longer than our own stopper's."""

_PERIOD = 0.1
_PATIENCE = 2.0
_MOST_ANNOUNCED, _LONGEST = 4096, 1000
_COMMAND = "cmd_vel"
_MISTAKEN = ":type"


class RosDriver:
    """Talks to one robot through the hub at `options.endpoint`."""

    is_simulated = False

    def __init__(
        self,
        name: str,
        scheme: KeyScheme,
        platform: Platform,
        options: RosOptions,
        stopping: SenderSpec,
    ) -> None:
        """Not connected yet."""
        self._name, self._scheme, self._platform = name, scheme, platform
        self._options, self._stopping = options, stopping
        self._cmd_vel = topic(options, options.cmd_vel)
        self._is_stamped = options.cmd_vel_type == "twist_stamped"
        self._command: type = TwistStamped if self._is_stamped else TwistMessage
        self._silence = max(SILENCE, 3.5 / platform.scan.rate)
        self._hearing = Subscriptions(options, platform)
        cdr.warm(self._command, *(sense.kind for sense in self._hearing.senses.values()))
        self._reset()

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; the session reconnects by itself."""
        await self._run(sink, looks_only=False)

    def send(self, twist: Twist, scan_seq: int, requested_scan_seq: int) -> None:
        """Send a safe command; dropped while the base is lost, zero the first time it is back."""
        command = self._gate.filter(twist)
        if command is not None:
            self._put(command, self._options.cmd_vel_frame)

    def zero_sender(self) -> SenderSpec:
        """How a stopper says zero to this base."""
        return self._stopping

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Topics, rates, types, clocks and what is missing, each with the next step."""
        loop = asyncio.get_running_loop()
        began = loop.time()
        task = asyncio.create_task(self._run(NullSink(), looks_only=True))
        try:
            while loop.time() - began < seconds and not task.done():
                await asyncio.sleep(min(_PERIOD, seconds))
                if has_enough(self._hearing, loop.time() - began):
                    break
            return self._report().findings()
        finally:
            task.cancel()
            await asyncio.gather(task, return_exceptions=True)

    def _report(self) -> Report:
        session = self._session
        return Report(
            scheme=self._scheme,
            endpoint=self._options.endpoint,
            is_connected=session is not None and bool(hubs_of(session)),
            hearing=self._hearing,
            spec=self._platform.scan,
            graph=self._others(),
            cmd_vel=self._cmd_vel,
            command=self._command,
            has_taker=self._has_taker(),
            others=self._other_commands,
        )

    def _reset(self) -> None:
        self._session: zenoh.Session | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._tokens: list[zenoh.LivelinessToken] = []
        self._graph: dict[str, Endpoint] = {}
        self._hubs: frozenset[str] = frozenset()
        self._census = DuplicateNodes(self._scheme.nodes, self._cmd_vel)
        self._gate = CommandGate()
        self._was_linked = False
        self._other_at = self._other_zero_at = self._other_zeros_from = -math.inf
        self._other_commands = 0
        self._told: tuple[bool, str] | None = None
        self._told_at = -math.inf
        self._was_blind = False

    async def _run(self, sink: Sink, *, looks_only: bool) -> None:
        loop = asyncio.get_running_loop()
        self._hearing = Subscriptions(self._options, self._platform)
        self._tell(sink, False, f"nothing heard yet from {self._options.endpoint}")
        session = await self._opened(sink)
        inbox = LatestSamples(loop, partial(self._take, sink, looks_only), sink.dropped)
        try:
            self._session = session
            for key in self._scheme.command_keys(self._cmd_vel, self._command):
                self._publishers[key] = commanding(session, key)
            self._listen(session, inbox, loop)
            opened = loop.time()
            while True:
                await asyncio.sleep(_PERIOD)
                self._census.look(session, loop.time())
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
        """A session; tries until something listens at the endpoint. Leaves none if cancelled."""
        while True:
            session = await open_in_thread(partial(open_session, self._options.endpoint))
            if session is not None:
                return session
            self._tell(sink, False, unheard(self._scheme, self._options.endpoint))

    def _listen(
        self, session: zenoh.Session, inbox: LatestSamples, loop: asyncio.AbstractEventLoop
    ) -> None:
        def on_token(sample: zenoh.Sample) -> None:
            is_there = sample.kind == zenoh.SampleKind.PUT
            hand_over(loop, self._on_token, str(sample.key_expr), is_there)

        # Before the topics: what a base wants is known when it is first heard.
        session.liveliness().declare_subscriber(self._scheme.graph, on_token, history=True)
        heard = [(s.name, s.topic, s.kind) for s in self._hearing.senses.values()]
        for name, full, kind in (*heard, (_COMMAND, self._cmd_vel, self._command)):
            session.declare_subscriber(
                self._scheme.listening(full),
                _receiver(self._scheme, inbox, name, full, kind),
                allowed_origin=zenoh.Locality.REMOTE,
            )

    def _on_token(self, token: str, is_there: bool) -> None:
        if len(token) > _LONGEST or not token.isprintable():
            return
        end = self._scheme.announced(token)
        if end is None:
            return
        if is_there and len(self._graph) < _MOST_ANNOUNCED:
            self._graph[token] = end
        elif not is_there:
            self._graph.pop(token, None)
            if not end.is_publisher and end.topic == self._cmd_vel:
                self._gate.require_zero()

    def _others(self) -> tuple[Endpoint, ...]:
        """What is announced, but for our own tokens."""
        own = str(self._session.info.zid()) if self._session is not None else ""
        return tuple(end for end in self._graph.values() if end.zid != own)

    def _take(self, sink: Sink, looks_only: bool, name: str, payload: bytes) -> None:
        now = asyncio.get_running_loop().time()
        if name.removesuffix(_MISTAKEN) == _COMMAND:
            self._on_command(sink, name, payload, now)
        elif name.endswith(_MISTAKEN):
            sense = self._hearing.senses[name.removesuffix(_MISTAKEN)]
            sense.complain(now, payload.decode(errors="replace"))
            sink.dropped(name)
        else:
            try:
                deliver = self._hearing.take(name, payload, now)
            except CodecError as error:
                self._hearing.senses[name].complain(now, f"cannot be read: {error}")
                sink.dropped(name)
                return
            self._rise(sink, looks_only, now)
            if self._gate.is_open:
                deliver(sink)

    def _on_command(self, sink: Sink, name: str, payload: bytes, now: float) -> None:
        """Somebody else commands this base; nobody is in charge who commands zero."""
        self._other_commands += 1
        if name == _COMMAND:
            try:
                if _asked(cdr.decode(self._command, payload)).is_zero:
                    if now - self._other_zero_at > OTHERS_LAST:
                        self._other_zeros_from = now
                    self._other_zero_at = now
                    return
            except CodecError:
                pass  # not what we would say: it may well move the robot
        self._other_at = now
        if self._gate.is_open:
            self._fall(sink, self._driven_by_others())

    def _driven_by_others(self) -> str:
        return (
            f"someone else drives this robot: commands on {self._cmd_vel} that are not ours; stop"
            " what publishes them, and this driver takes over 2 s later"
        )

    def _rise(self, sink: Sink, looks_only: bool, now: float) -> None:
        if self._gate.is_open or self._hearing.heard_at < now or self._obstacle(now):
            return
        self._gate.open()
        self._tell(sink, True, self._place())
        if not looks_only and not self._tokens and self._session is not None:
            topics = [(s.topic, s.kind) for s in self._hearing.senses.values()]
            zid = str(self._session.info.zid())
            for token in self._scheme.introduce(zid, [*topics, (self._cmd_vel, self._command)]):
                self._tokens.append(self._session.liveliness().declare_token(token))

    def _fall(self, sink: Sink, text: str) -> None:
        if self._gate.close(asyncio.get_running_loop().time()):
            self._put(ZERO, frame="")  # without a name in it, it is zero as a Twist too
        self._tell(sink, False, text)

    def _watch(self, sink: Sink, session: zenoh.Session, now: float, opened: float) -> None:
        hubs, before = hubs_of(session), self._hubs
        self._hubs = hubs or before
        silent = now - self._hearing.heard_at
        if hubs and (not self._was_linked or hubs != before):
            self._gate.repeat_zero(now)
        self._was_linked = bool(hubs)
        if self._gate.is_open and not hubs:
            self._fall(sink, unheard(self._scheme, self._options.endpoint))
        elif self._gate.is_open and before and hubs != before:
            self._fall(sink, f"{self._place()} was started anew")
        elif self._gate.is_open and silent > self._silence:
            self._fall(sink, f"no scan and no odometry from {self._place()} for {silent:.1f} s")
        elif self._gate.is_open and (obstacle := self._obstacle(now)):
            self._fall(sink, obstacle)
        elif self._gate.repeats_zero(now) and now - self._other_at >= OTHERS_LAST:
            self._put(ZERO, frame="")
        if now - self._told_at >= _PATIENCE and now - opened >= _PATIENCE:
            self._explain(sink, now, is_linked=bool(hubs))

    def _explain(self, sink: Sink, now: float, *, is_linked: bool) -> None:
        """Say anew why it is lost, or what is missing although it is there."""
        if is_linked:
            is_heard = now - self._hearing.heard_at <= self._silence
            obstacle = self._obstacle(now) if is_heard or now - self._other_at < OTHERS_LAST else ""
            self._tell(sink, self._gate.is_open, obstacle or self._trouble(now) or self._place())
        else:
            self._tell(sink, self._gate.is_open, unheard(self._scheme, self._options.endpoint))

    def _obstacle(self, now: float) -> str:
        """Why this base is not to be commanded although it is heard; empty if nothing is."""
        if now - self._other_at < OTHERS_LAST:
            return self._driven_by_others()
        if self._census.twin:
            hub = self._scheme.hub
            return f"{self._census.twin} crashed and is back; {hub} will forget it: start that anew"
        others = self._others()
        has_taker = not others or self._has_taker()  # where nothing is announced nobody can tell
        return why_unheard(self._cmd_vel, self._command, others, self._scheme, has_taker=has_taker)

    def _has_taker(self) -> bool:
        return any(has_subscriber(publisher) for publisher in self._publishers.values())

    def _trouble(self, now: float) -> str:
        """The first thing that is wrong with what the robot says; empty if nothing is."""
        lasts = self._other_zero_at - self._other_zeros_from
        if lasts > ZEROS_OF_OTHERS and now - self._other_zero_at < OTHERS_LAST:
            return (
                f"someone else tells this robot to stand: zeros on {self._cmd_vel} that are not"
                " ours, such as of the stopper of an earlier daemon; end what says them"
            )
        graph, senses = self._others(), self._hearing.senses.values()
        missing = self._hearing.missing(now, max(_PATIENCE, self._silence))
        faults = (
            *(why_refused(sense, graph, self._scheme) for sense in senses if sense.complaint(now)),
            *(why_silent(sense, graph, self._scheme) for sense in missing),
            *(why_misleading(sense, graph, self._scheme) for sense in senses if sense.is_needed),
        )
        return next(filter(None, faults), "") or self._blindness()

    def _blindness(self) -> str:
        """What all sweeps lack, as far as the last two that were looked at tell."""
        scan, was_blind = self._hearing.scan, self._was_blind
        sense = next(iter(self._hearing.senses.values()))
        fault = "" if scan is None else why_blind(sense, scan, self._platform.scan)
        self._was_blind = bool(fault)
        return fault if was_blind else ""

    def _place(self) -> str:
        return f"{self._scheme.hub} at {self._options.endpoint}"

    def _tell(self, sink: Sink, is_up: bool, text: str) -> None:
        self._told_at = asyncio.get_running_loop().time()
        if self._told == (is_up, text):
            return
        if self._told is not None and not isinstance(sink, NullSink):
            is_well = is_up and text == self._place()
            log.log(logging.INFO if is_well else logging.WARNING, "driver %s: %s", self._name, text)
        self._told = (is_up, text)
        sink.state(is_up, text)

    def _put(self, twist: Twist, frame: str) -> None:
        publisher = self._publishers.get(self._scheme.command_key(self._cmd_vel, self._command))
        if publisher is None:
            return
        message = (
            conversion.stamped_message(twist, frame)
            if self._is_stamped
            else conversion.twist_message(twist)
        )
        publisher.put(cdr.encode(message), attachment=self._scheme.attachment())


def _asked(message: object) -> Twist:
    if isinstance(message, TwistStamped):
        message = message.twist
    assert isinstance(message, TwistMessage)
    return conversion.twist_of(message)


def _receiver(
    scheme: KeyScheme, inbox: LatestSamples, name: str, full: str, kind: type
) -> Callable[[zenoh.Sample], None]:
    def on_sample(sample: zenoh.Sample) -> None:
        fault = scheme.fault(str(sample.key_expr), full, kind)
        if fault:
            inbox.put(f"{name}{_MISTAKEN}", fault.encode())
        else:
            inbox.put(name, sample.payload.to_bytes())

    return on_sample
