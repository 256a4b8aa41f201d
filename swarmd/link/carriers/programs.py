"""Zenoh programs that take part in a swarm: their liveliness tokens and messages.

A program is a Zenoh session that is no robot, without body and place. A program may declare the
token `swarm/<swarm>/<program>`, and put messages on
`swarm/<swarm>/<program>/message/<pattern>/<channel>`. Zenoh's ring channel keeps the last MAX_TAKEN
messages of all programs without running Python, and `take` reads them at each tick. So a flood
costs the daemon a bounded time. In a flood the oldest messages are lost.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import zenoh
from zenoh.handlers import Callback, RingChannel

from swarmd.core.bounds import keep_newest
from swarmd.core.codec import MAX_MESSAGE, decode_value
from swarmd.core.errors import CodecError
from swarmd.core.keys import ANY, MESSAGE, build, is_id, named_by, parse, token
from swarmd.core.message_limits import SenderLimits
from swarmd.core.values import Value
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.session import has_subscriber, undeclare

MAX_TAKEN = 64
"""Messages of all programs that a robot takes in one tick: 1,280 a second."""
MAX_PROGRAMS = 64
"""Programs that a robot lists, and senders whose limits it keeps."""


class ProgramMessage(NamedTuple):
    """A message of the program `sender` on the channel `<pattern>/<channel>`."""

    sender: str
    channel: str
    value: Value


class Programs:
    """The Zenoh programs that one robot hears on its session; build it on the loop's thread.

    `is_robot(name)`: True if the name belongs to a robot. Robots send messages as datagrams, so
    that a Zenoh message in a robot's name is refused. `drops` counts refused messages, for example
    as `message:robot` and `message:limit`. `takes_messages` False: messages are neither taken from
    programs nor published.
    """

    def __init__(
        self,
        session: zenoh.Session,
        swarm: str,
        robot: str,
        is_robot: Callable[[str], bool],
        drops: DropCounter,
        *,
        takes_messages: bool,
    ) -> None:
        """Declare the liveliness token of `robot`, and subscribe to the tokens of programs.

        A program is a Zenoh session that takes part in the swarm and is no robot. With
        `takes_messages`, also subscribe to the messages of programs, and declare the publisher by
        which `publish` learns whether any program subscribes.
        """
        self._session = session
        self._swarm = swarm
        self._robot = robot
        self._is_robot = is_robot
        self._drops = drops
        self._limits: dict[str, SenderLimits] = {}  # the limits of each sender
        self._lock = threading.Lock()  # guards `_tokens`: Zenoh's threads call `_on_token`
        self._tokens: dict[str, None] = {}  # the names of programs that are alive
        liveliness = session.liveliness()
        # indirect=False: on Zenoh's own thread. history: also tokens that were declared before.
        on_token = Callback(self._on_token, indirect=False)
        self._declared: list[Any] = [  # Zenoh declarations that `close` ends
            liveliness.declare_token(token(swarm, robot)),
            liveliness.declare_subscriber(token(swarm, ANY), on_token, history=True),
        ]
        self._messages: Any = None  # the subscriber, with a ring of the last MAX_TAKEN messages
        self._has_subscriber = False  # a program subscribes to messages of this robot
        self._is_unsure = takes_messages  # `_has_subscriber` may be wrong: Zenoh must be asked
        if takes_messages:
            self._exchange_messages()

    def _exchange_messages(self) -> None:
        """Subscribe to the messages of programs, and declare the publisher for this robot's own.

        Locality.REMOTE: the subscriber and the publisher do not match each other. Otherwise each
        message would be put even without a program, and would come back.
        """
        self._messages = self._session.declare_subscriber(
            build(self._swarm, ANY, MESSAGE, ANY, ANY),
            RingChannel(MAX_TAKEN),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._publisher = self._session.declare_publisher(
            build(self._swarm, self._robot, MESSAGE, ANY, ANY),
            allowed_destination=zenoh.Locality.REMOTE,
        )
        on_change = Callback(self._on_subscribers, indirect=False)
        self._publisher.declare_matching_listener(on_change)
        self._declared += [self._messages, self._publisher]

    @property
    def names(self) -> tuple[str, ...]:
        """The programs that hold a token, sorted; at most MAX_PROGRAMS."""
        with self._lock:
            names = tuple(self._tokens)
        return tuple(sorted(name for name in names if not self._is_robot(name)))[:MAX_PROGRAMS]

    def publish(self, channel: str, payload: bytes) -> None:
        """Publish a pattern's message on `<pattern>/<channel>`, if a program subscribes."""
        if self._is_unsure:
            self._is_unsure = False  # before the question: a later change sets it again
            self._has_subscriber = has_subscriber(self._publisher)
        pattern, _, name = channel.partition("/")
        if not (self._has_subscriber and is_id(pattern) and is_id(name)):
            return
        key = build(self._swarm, self._robot, MESSAGE, pattern, name)
        try:
            self._session.put(
                key,
                payload,
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,
                allowed_destination=zenoh.Locality.REMOTE,
            )
        except zenoh.ZError:
            self._drops.add("message:unsent")

    def take(self, now: float) -> Iterator[ProgramMessage]:
        """The messages of programs that came since the last call, within their limits."""
        for _ in range(0 if self._messages is None else MAX_TAKEN):
            try:
                sample = self._messages.try_recv()
            except zenoh.ZError:  # the session has closed
                return
            if sample is None:
                return
            message = self._read(sample, now)
            if message is not None:
                yield message

    def _read(self, sample: zenoh.Sample, now: float) -> ProgramMessage | None:
        key = parse(str(sample.key_expr))
        if key is None or key.swarm != self._swarm or sample.kind != zenoh.SampleKind.PUT:
            self._drops.add("message:key")
            return None
        if self._is_robot(key.robot):
            self._drops.add("message:robot")
            return None
        size = len(sample.payload)
        if size > MAX_MESSAGE:
            self._drops.add("message:oversized")
            return None
        limits = self._limits.pop(key.robot, None) or SenderLimits()
        keep_newest(self._limits, key.robot, limits, MAX_PROGRAMS)
        channel = f"{key.name}/{key.last}"
        if not limits.passes(channel, size, now):
            self._drops.add("message:limit")
            return None
        try:
            return ProgramMessage(key.robot, channel, decode_value(sample.payload.to_bytes()))
        except CodecError:
            self._drops.add("message:malformed")
            return None

    def close(self) -> None:
        """Undeclare the token, the subscribers and the publisher."""
        undeclare(*self._declared)

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Note a token that appeared or disappeared; a thread of Zenoh calls it."""
        name = named_by(str(sample.key_expr))
        if name is None:
            return
        with self._lock:
            if sample.kind != zenoh.SampleKind.PUT:
                self._tokens.pop(name, None)
            elif len(self._tokens) < 2 * MAX_PROGRAMS:
                self._tokens[name] = None

    def _on_subscribers(self, _: zenoh.MatchingStatus) -> None:
        """Note a first or last subscriber; a thread of Zenoh calls it."""
        self._is_unsure = True
