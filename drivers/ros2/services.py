"""The ROS services that run and reset this robot, by the driver's session; option `services`.

`CommandServices` also publishes the answers to stops that came on topics. Each service has the type
std_srvs/Trigger, whose request is empty. A middleware's client calls a service by a Zenoh query.
Anyone on the robot's ROS graph may call.
"""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import zenoh
from zenoh.handlers import Callback

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.core.messages import Code, Reply
from swarmd.core.threads import hand_over
from swarmd.core.token_bucket import TokenBucket
from swarmd.driver_api.command_source import DriverCommand
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.messages import String
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros.stop_topics import CALL_BURST, CALL_RATE, STOP_TYPES, StopTopics
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.drivers.ros2.request_age import MAX_STAMP_AGE, SETTLE_TIME, RequestAge, by_stamp
from swarmd.drivers.ros2.session import ask_hub, linked_hubs

MAX_MESSAGE = 500
"""Characters of the field `message`."""

_FAST_DDS = "010f"
"""With it the id of a DDS participant on Fast DDS begins: the vendor's id (DDSI-RTPS).

The bridge reads the header of a request as rmw_cyclonedds writes it, and drops other requests.
"""
_HEADER = b"\0\1\0\0"  # CDR, little-endian
_MAX_REQUEST = 8  # bytes of an empty request: the header, a byte that stands for no field, padding
_DOUBT = (
    "the age of this call is unknown: the hub did not answer all the time in the last"
    f" {SETTLE_TIME:g} s; call again"
)


class CommandServices(StopTopics):
    """Serves the services of one robot, if it has the option `services`, and answers stops."""

    def __init__(self, scheme: KeyScheme, options: RosOptions, is_lost: Callable[[], bool]) -> None:
        """Not open yet. `is_lost`: whether the base is lost."""
        self._scheme = scheme
        self._options = options.services
        super().__init__(
            options, self._publish, "" if not options.services else options.services.operator
        )
        self._is_lost = is_lost
        self._commands = {} if not options.services else options.services.commands(options.topic)
        self._lock = threading.Lock()  # guards `_limits` and `_refused` (threads of Zenoh)
        self._limits = {name: TokenBucket(CALL_RATE, CALL_BURST) for name in self._commands}
        self._refused = 0
        self._session: zenoh.Session | None = None
        self._declared: list[object] = []
        self._age = RequestAge()

    def findings(self, nodes: Iterable[Endpoint]) -> tuple[Finding, ...]:
        """The finding of `swarmd --check` on option `services`; `nodes`: those of bridges."""
        if self._options is None:
            return ()
        fast = sorted({one.node for one in nodes if one.process.startswith(_FAST_DDS)})
        text = (
            f"the bridge drops calls by Fast DDS: {', '.join(fast)}"
            if fast
            else f"serves {', '.join(self._commands)} ({self._options.operator})"
        )
        return (Finding("services", not fast, text, "use rmw_cyclonedds_cpp" if fast else ""),)

    @property
    def runs(self) -> Mapping[str, DriverCommand]:
        """The commands of runs and stops that options declare, by the key of their option."""
        return {
            **super().runs,
            **{
                f"services.runs.{name.rpartition('/')[2]}": command
                for name, command in self._commands.items()
                if command.run is not None
            },
        }

    def open(self, session: zenoh.Session, loop: asyncio.AbstractEventLoop) -> None:
        """Declare the services on a new session, and announce them and the ends of stops."""
        self._session = session
        self._age = RequestAge()
        for service in self._commands:
            on_query = Callback(partial(self._on_query, loop, service), indirect=False)
            key = self._scheme.subscription_key(service)
            self._declared.append(session.declare_queryable(key, on_query, complete=True))
        if self._scheme.is_node:
            # From now on, not only while a base is there: a stop counts in any case.
            kinds = dict(zip(self.topics, STOP_TYPES.values(), strict=True))
            ends = [
                TopicEnd(topic, kind, topic not in kinds, is_reliable=True, depth=10)
                for topic, kind in {**kinds, self.state_topic: String}.items()
            ]
            self._declared += map(
                session.liveliness().declare_token,
                self._scheme.tokens(str(session.info.zid()), ends, tuple(self._commands)),
            )

    def advance(self, dropped: Callable[[str], None]) -> None:
        """Probe the hub, and count refused calls; the driver's task calls this."""
        loop = asyncio.get_running_loop()
        if self._session is None or not self._commands:
            return
        if not linked_hubs(self._session):
            self._age = RequestAge()  # a probe without a hub ends at once, and is no answer
        elif self._age.probes(now := loop.time()):
            age = self._age  # of this link: a late answer must not count for the next link
            ask_hub(
                self._session,
                partial(hand_over, loop, lambda: age.answered(now, loop.time())),
            )
        with self._lock:
            refused = self._refused
            self._refused = 0
        if refused:
            dropped("services:refused")

    def close(self) -> None:
        """Forget the session."""
        self._session = None
        self._age = RequestAge()
        self._declared.clear()

    def _publish(self, text: str) -> None:
        """Publish the answer to a stop."""
        if self._session is not None:
            self._session.put(
                self._scheme.key(self.state_topic, String),
                cdr.encode(String(text)),
                attachment=self._scheme.attachment(),
            )

    def _on_query(self, loop: asyncio.AbstractEventLoop, name: str, query: zenoh.Query) -> None:
        """Check a query on a thread of Zenoh; hand a call of the service `name` to the loop.

        Calls beyond the rate limit of the service are refused. Queries that are no calls, such as
        for many keys, do not count in this limit: a stop must pass beside a flood of such queries.
        """
        attachment = None if query.attachment is None else query.attachment.to_bytes()
        payload = b"" if query.payload is None else query.payload.to_bytes()
        try:
            _check_empty(payload)
            stamp = self._scheme.call_stamp(str(query.key_expr), attachment)
            is_call = True
        except CodecError:
            is_call = False
            stamp = None
        with self._lock:
            is_taken = is_call and self._limits[name].take(1.0, time.monotonic())
            self._refused += not is_taken
        if is_taken:
            hand_over(loop, self._on_call, name, query, attachment, stamp)
        else:
            query.drop()

    def _on_call(
        self, name: str, query: zenoh.Query, attachment: bytes | None, stamp: float | None
    ) -> None:
        take = self._take
        if take is None or self._session is None:
            query.drop()
            return
        age, doubt = self._age_of(stamp)
        command = replace(self._commands[name], age=age, doubt=doubt)
        take(command, partial(self._answer, query, attachment, command.verb == "run"))

    def _age_of(self, stamp: float | None) -> tuple[float | None, str]:
        """The greatest age of a call that has just arrived, or None and the reason."""
        age = self._age.bound(asyncio.get_running_loop().time())
        if age is None:
            return None, _DOUBT
        wall = time.time()
        sent = wall if stamp is None else stamp
        stamp_age = by_stamp(sent, wall)
        if stamp_age is None:
            return None, (
                f"by its stamp this call was sent {wall - sent:.1f} s ago; at most"
                f" {MAX_STAMP_AGE:g} s count: call again, or set the clocks of both computers"
            )
        return max(age, stamp_age), ""

    def _answer(
        self, query: zenoh.Query, attachment: bytes | None, is_run: bool, reply: Reply
    ) -> None:
        """Answer a call; a run of a robot whose base is lost is no success, as its text says."""
        is_applied = reply.code is Code.APPLIED
        text = reply.text if is_applied else f"{reply.refusal}: {reply.text}"
        is_success = is_applied and not (is_run and self._is_lost())
        with suppress(zenoh.ZError):  # the caller or the session has gone
            query.reply(
                str(query.key_expr),
                trigger_response(is_success, text),
                attachment=self._scheme.reply_attachment(attachment),
            )
        query.drop()


def trigger_response(is_success: bool, message: str) -> bytes:
    """The bytes of a std_srvs/Trigger_Response."""
    text = message[:MAX_MESSAGE].encode(errors="replace") + b"\0"
    return _HEADER + struct.pack("<?3xI", is_success, len(text)) + text


def _check_empty(payload: bytes) -> None:
    """CodecError unless the bytes are a request without fields."""
    if not 4 <= len(payload) <= _MAX_REQUEST or payload[0] or any(payload[4:]):
        raise CodecError("no empty request")
