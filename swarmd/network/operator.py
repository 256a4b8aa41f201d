"""The operator's side: finds the members of a swarm, sends requests and collects the acks.

Synchronous, without asyncio and numpy, since a command must start fast::

    with Operator(settings) as operator:
        view = operator.members()
        outcome = operator.request(RunRequest, view.epochs(names), pattern="attraction")
        outcome = operator.halt("estop", reason="...")

Zenoh's threads only put what they receive into tables under one lock; the caller's thread waits.
Queries use DROP, since a reply inherits the query's congestion control and must not block a
daemon's loop; a query that may get lost is repeated.
"""

from __future__ import annotations

import contextlib
import getpass
import os
import socket
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Literal, Self, TypeVar

import zenoh
from zenoh.handlers import Callback

from swarmd.core.codec import MAX_CONTROL, Decoder, encode
from swarmd.core.errors import CodecError
from swarmd.core.keys import ANY, build, parse
from swarmd.core.messages import (
    AnyRequest,
    Epoch,
    EstopRequest,
    MembersQuery,
    PeerView,
    Reply,
    StopRequest,
)
from swarmd.network.discovery import Discovery, MembersView
from swarmd.network.outcome import Acks, Outcome
from swarmd.network.session import MAX_WIRE, open_operator_session, undeclare
from swarmd.network.settings import NetworkSettings
from swarmd.network.stop_request import DISCOVERY_TIMEOUT, PendingStop, Select

STOP_TIMEOUT = 3.0
# Polls are frequent while links come up, then spare the network, in s.
FAST_POLL_PERIOD = 0.015
SLOW_POLL_PERIOD = 0.1
FAST_POLL_TIME = 0.2
# A request without a reply is repeated after this time, in s: a congested or closing link loses it.
REPEAT_PERIOD = 0.5
# What a request may hold, in characters.
MAX_OPERATOR = 128
MAX_REASON = 256

R = TypeVar("R", bound=AnyRequest)

StopVerb = Literal["stop", "estop"]

_view = Decoder(PeerView, MAX_WIRE)
_reply = Decoder(Reply, MAX_CONTROL)


def operator_name() -> str:
    """The name of this operator, such as `anna@laptop`."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):
        user = f"uid{os.getuid()}"
    return _sendable(f"{user}@{socket.gethostname()}", MAX_OPERATOR)


def _sendable(text: str, length: int) -> str:
    """The first `length` characters of a text; a character that UTF-8 cannot carry becomes `?`.

    A stop must not fail because of its reason, so the reason is mended and not refused.
    """
    return text.encode("utf-8", "replace").decode()[:length]


class Operator:
    """An operator's session in a swarm; a context manager.

    `settings` are those of the swarm; the session takes any free port. `roster` names robots
    that are expected even if no daemon has seen them. Raises NetworkError without a session.
    """

    def __init__(
        self, settings: NetworkSettings, *, name: str | None = None, roster: Iterable[str] = ()
    ) -> None:
        self.settings = settings
        self.name = _sendable(name, MAX_OPERATOR) if name else operator_name()
        self._roster = frozenset(roster)
        self._news = threading.Condition()
        self._tokens: set[tuple[str, str]] = set()
        self._links = 0
        self._discovery: Discovery | None = None
        self._version = 0
        self._session = open_operator_session(self.settings, ())
        self._listeners = self._watch()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network."""
        undeclare(*self._listeners)
        self._session.close()

    def members(self, *, timeout: float = DISCOVERY_TIMEOUT) -> MembersView:
        """The members, as soon as all that are alive have answered; takes at most `timeout` s."""
        discovery = self._new_discovery()
        pace = PollSchedule(time.monotonic(), timeout)
        while True:
            with self._news:
                now, version = time.monotonic(), self._version
                if discovery.is_complete(now) or pace.is_over(now):
                    return discovery.result()
            if pace.is_due(now):
                self._ask_members(discovery)
            self._wait(version, pace.pause(now))

    def request(
        self,
        kind: type[AnyRequest],
        targets: Mapping[str, Epoch | None],
        *,
        timeout: float = 5.0,
        absent: Iterable[str] = (),
        warnings: Iterable[str] = (),
        **fields: Any,
    ) -> Outcome:
        """Send a request to the robots in `targets`, with the epoch that was seen of each.

        `fields` are those of `kind`. Repeated under one id to each robot without a reply. Returns
        as soon as all have answered. `absent` count as silent without being asked.
        """
        request = self._new(kind, targets=dict(targets), **fields)
        payload, acks = encode(request), Acks(request.id)
        started = now = time.monotonic()
        robots: tuple[str, ...] = (ANY,) if targets else ()
        while robots and (left := started + timeout - now) > 0:
            for robot in robots:
                self._get(robot, "control", request.verb, payload, left, _collect(acks))
            with self._news:
                self._news.wait_for(lambda: not acks.missing(targets), min(left, REPEAT_PERIOD))
                robots, now = acks.missing(targets), time.monotonic()
        with self._news:
            return acks.outcome(
                {*targets, *absent}, warnings=tuple(warnings), seconds=now - started
            )

    def halt(
        self,
        verb: StopVerb,
        *,
        select: Select | None = None,
        reason: str = "",
        timeout: float = STOP_TIMEOUT,
    ) -> Outcome:
        """Stop or estop: sent at once on every link, and repeated to each robot without an ack.

        `select` picks robots from the names known so far and is called again as more appear;
        None: all. An estop of all is swarm-wide: robots that join take it over. `reason` is kept
        with an estop. Returns when every robot that must ack has, else after `timeout` s.
        """
        targets: dict[str, Epoch | None] | None = None if select is None else {}
        request: StopRequest | EstopRequest
        if verb == "stop":
            request = self._new(StopRequest, targets=targets)
        else:
            scope = "swarm" if select is None else "robots"
            request = self._new(EstopRequest, targets=targets, scope=scope, reason=reason)
        discovery = self._new_discovery()
        pace = PollSchedule(time.monotonic(), timeout)
        pending_stop = PendingStop(request, select, discovery, pace.started)
        links = -1
        while True:
            with self._news:
                now, version = time.monotonic(), self._version
                if pending_stop.is_done(now) or pace.is_over(now):
                    return pending_stop.outcome(now)
                news, links = self._links != links, self._links
            if news or pace.is_due(now):
                self._send_halt(pending_stop, verb, to_all=news and pending_stop.is_for_all)
                self._ask_members(discovery)
            self._wait(version, pace.pause(now))

    def swarms(self, *, timeout: float = 0.3) -> tuple[str, ...]:
        """The names of all swarms within reach, for an operator who finds no member of this one."""
        return ()

    def _new(self, kind: type[R], **fields: Any) -> R:
        if "reason" in fields:
            fields["reason"] = _sendable(fields["reason"], MAX_REASON)
        return kind(id=os.urandom(6).hex(), operator=self.name, **fields)

    def _new_discovery(self) -> Discovery:
        now = time.monotonic()
        discovery = Discovery(now, self._roster)
        with self._news:
            for robot, instance in self._tokens:
                discovery.on_token(robot, instance, True, now)
            self._discovery = discovery
        return discovery

    def _ask_members(self, discovery: Discovery) -> None:
        with self._news:
            known = sorted(discovery.settled)

        def on_view(robot: str, payload: bytes) -> None:
            view = _view(payload)
            if view.robot == robot:
                discovery.on_view(view, time.monotonic())

        query = encode(MembersQuery(answered=tuple(known)))
        self._get(ANY, "control", "members", query, DISCOVERY_TIMEOUT, on_view)

    def _send_halt(self, pending_stop: PendingStop, verb: StopVerb, *, to_all: bool) -> None:
        """Send it to each known robot without an ack, and on new links to all robots."""
        plane = "safety" if verb == "estop" else "control"
        with self._news:
            payload, names = pending_stop.payload(), pending_stop.pending()
        on_ack = _collect(pending_stop.acks)
        if to_all:
            self._get(ANY, plane, verb, payload, STOP_TIMEOUT, on_ack)
        for name in names:
            if verb == "estop":
                self._session.put(
                    build(self.settings.swarm, name, plane, verb),
                    payload,
                    congestion_control=zenoh.CongestionControl.DROP,
                    priority=zenoh.Priority.REAL_TIME,
                    express=True,
                )
            self._get(name, plane, verb, payload, STOP_TIMEOUT, on_ack)

    def _get(
        self,
        robot: str,
        plane: str,
        name: str,
        payload: bytes,
        timeout: float,
        handler: Callable[[str, bytes], object],
    ) -> None:
        """Query a key; `handler` takes each reply's robot and payload, under the lock."""

        def on_reply(reply: zenoh.Reply) -> None:
            sample = reply.ok
            if sample is None or len(sample.payload) > MAX_WIRE:
                return
            key = parse(str(sample.key_expr))
            if key is None or (key.swarm, key.plane, key.name) != (
                self.settings.swarm,
                plane,
                name,
            ):
                return
            payload = sample.payload.to_bytes()
            with self._news, contextlib.suppress(CodecError):
                handler(key.robot, payload)
                self._notify()

        self._session.get(
            build(self.settings.swarm, robot, plane, name),
            Callback(on_reply, indirect=False),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
            express=True,
            timeout=timeout,
            payload=payload,
        )

    def _watch(self) -> tuple[Any, ...]:
        def on_link(event: zenoh.LinkEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                with self._news:
                    self._links += 1
                    if self._discovery is not None:
                        self._discovery.on_link(time.monotonic())
                    self._notify()

        def on_token(sample: zenoh.Sample) -> None:
            key = parse(str(sample.key_expr))
            if key is not None:
                with self._news:
                    is_there = sample.kind == zenoh.SampleKind.PUT
                    change = self._tokens.add if is_there else self._tokens.discard
                    change((key.robot, key.name))
                    if self._discovery is not None:
                        now = time.monotonic()
                        self._discovery.on_token(key.robot, key.name, is_there, now)
                    self._notify()

        links = self._session.info.declare_link_events_listener(on_link, history=True)
        tokens = self._session.liveliness().declare_subscriber(
            build(self.settings.swarm, ANY, "alive", ANY), on_token, history=True
        )
        return tokens, links

    def _notify(self) -> None:
        self._version += 1
        self._news.notify_all()

    def _wait(self, version: int, timeout: float) -> None:
        with self._news:
            self._news.wait_for(lambda: self._version != version, timeout)


def _collect(acks: Acks) -> Callable[[str, bytes], object]:
    return lambda robot, payload: acks.on_reply(robot, _reply(payload))


class PollSchedule:
    """When to send again: often while links come up, then less often, until `timeout`."""

    def __init__(self, now: float, timeout: float) -> None:
        self.started = now
        self._end = now + timeout
        self._next = now

    def is_over(self, now: float) -> bool:
        """True once the timeout has passed."""
        return now >= self._end

    def is_due(self, now: float) -> bool:
        """True once a period."""
        if now < self._next:
            return False
        self._next = now + (
            FAST_POLL_PERIOD if now - self.started < FAST_POLL_TIME else SLOW_POLL_PERIOD
        )
        return True

    def pause(self, now: float) -> float:
        """Seconds to wait for news before the next look."""
        return max(0.001, min(self._next, self._end) - now)
