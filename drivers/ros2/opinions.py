"""Opinions of voting patterns as ROS 2 topics, by the driver's session; option `opinions`.

Zenoh's ring channels keep the last messages without running Python, and `advance` reads them. So a
flood costs the driver a bounded time. In a flood the oldest messages are lost.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from swarmd.core.errors import CodecError
from swarmd.core.finding import Finding
from swarmd.driver_api.opinion_link import HeardOpinion, HearOpinion, number_of
from swarmd.drivers.ros import cdr
from swarmd.drivers.ros import messages as ros
from swarmd.drivers.ros.opinion_options import PUBLISHED, broadcast_type, is_namespace
from swarmd.drivers.ros.options import RosOptions
from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd

MAX_OF_ONE, MAX_WAITING = 2, 64
"""Messages between two reads, 0.1 s apart: on a topic of one robot, and of several robots."""
MAX_PAYLOAD = 64
"""Bytes of a message with an opinion."""


class OpinionTopics:
    """Publishes and hears opinions; does nothing without the option `opinions`."""

    def __init__(self, scheme: KeyScheme, options: RosOptions, robot: str) -> None:
        """Not open yet. `robot`: its id; the number at its end is the `id` on the broadcast."""
        self._scheme, self._options = scheme, options.opinions
        self._published: dict[str, type] = {}  # by topic
        self._heard: dict[str, type] = {}
        self._number = number_of(robot)
        self._own = options.topic("_")[:-2]  # the own namespace
        if self._options is not None:
            self._name_topics(options)
        self._hear: HearOpinion | None = None
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._subscribers: list[tuple[Any, type, int]] = []
        self._tokens: Mapping[str, str] = {}

    def _name_topics(self, options: RosOptions) -> None:
        """Set the topics that are published and heard."""
        opinions = self._options
        assert opinions is not None
        broadcast = opinions.broadcast_topic
        if broadcast is not None:
            self._heard[broadcast] = broadcast_type()
        if opinions.publish:
            self._published[options.topic(PUBLISHED)] = ros.Int32
            if broadcast is not None and self._number is not None:
                self._published[broadcast] = broadcast_type()
        if opinions.unknown:
            self._heard[f"/*/{opinions.topic}"] = ros.Int32
        else:
            self._heard |= {f"/{robot}/{opinions.topic}": ros.Int32 for robot in opinions.robots}
        cdr.build_codecs(*self._published.values(), *self._heard.values())

    @property
    def is_on(self) -> bool:
        """True with the option `opinions`."""
        return self._options is not None

    @property
    def ends(self) -> list[TopicEnd]:
        """The publishers, as a node announces them."""
        return [
            TopicEnd(topic, kind, is_publisher=True, is_reliable=True, depth=1)
            for topic, kind in self._published.items()
        ]

    def findings(self) -> tuple[Finding, ...]:
        """The finding of `swarmd --check` on option `opinions`."""
        if self._options is None:
            return ()
        parts = [
            f"{verb} {', '.join(topics)}"
            for verb, topics in (("publishes", self._published), ("hears", self._heard))
            if topics
        ]
        return (Finding("opinions", True, "; ".join(parts) or "neither publishes nor hears"),)

    def hear(self, hear: HearOpinion) -> None:
        """Hand each opinion to `hear` from now on."""
        self._hear = hear

    def open(self, session: zenoh.Session) -> None:
        """Declare publishers and subscribers on a new session."""
        remote = zenoh.Locality.REMOTE
        for topic, kind in self._published.items():
            self._publishers[topic] = session.declare_publisher(
                self._scheme.key(topic, kind),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.BACKGROUND,
                allowed_destination=remote,
            )
        for topic, kind in self._heard.items():
            is_of_one = kind is ros.Int32 and "*" not in topic
            most = MAX_OF_ONE if is_of_one else MAX_WAITING
            key = self._scheme.subscription_key(topic)
            subscriber = session.declare_subscriber(key, RingChannel(most), allowed_origin=remote)
            self._subscribers.append((subscriber, kind, most))

    def announced(self, tokens: Mapping[str, str]) -> None:
        """Set the liveliness tokens of the publishers, by topic."""
        self._tokens = tokens

    def publish(self, opinion: int) -> None:
        """Publish the own opinion on each topic."""
        for topic, publisher in self._publishers.items():
            kind = self._published[topic]
            message = kind(data=opinion) if kind is ros.Int32 else kind(self._number, opinion)
            attachment = self._scheme.attachment(self._tokens.get(topic, ""))
            with suppress(zenoh.ZError):  # the session is closing
                publisher.put(cdr.encode(message), attachment=attachment)

    def advance(self, dropped: Callable[[str], None]) -> None:
        """Hand over the opinions that arrived; the driver's task calls this."""
        hear = self._hear
        for subscriber, kind, most in self._subscribers:
            for _ in range(most):
                try:
                    sample = subscriber.try_recv()
                except zenoh.ZError:  # the session has closed
                    return
                if sample is None:
                    break
                heard = self._read(sample, kind)
                if heard is None:
                    dropped("opinions")
                elif hear is not None and heard.name != self._own_name(heard):
                    hear(heard)

    def close(self) -> None:
        """Forget the session."""
        self._publishers.clear()
        self._subscribers.clear()
        self._tokens = {}

    def _own_name(self, heard: HeardOpinion) -> str:
        """The own name among the senders of this topic."""
        return self._own.strip("/") if heard.number is None else str(self._number)

    def _read(self, sample: zenoh.Sample, kind: type) -> HeardOpinion | None:
        """The opinion in a sample; None for a foreign key, an undeclared robot or other bytes."""
        options, payload = self._options, sample.payload
        topic = self._scheme.topic_of(str(sample.key_expr), kind)
        is_put = sample.kind == zenoh.SampleKind.PUT
        if options is None or topic is None or not is_put or len(payload) > MAX_PAYLOAD:
            return None
        try:
            message: Any = cdr.decode(kind, payload.to_bytes())
        except CodecError:
            return None
        if kind is ros.Int32:
            name = topic[1:].removesuffix(f"/{options.topic}")
            is_declared = name in options.robots
            heard = HeardOpinion(name, int(message.data), None, is_declared)
        else:
            number = int(message.id)
            is_declared = number in options.ids
            heard = HeardOpinion(str(number), int(message.opinion), number, is_declared)
        # A robot of swarmd without a namespace publishes on /swarmd/opinion.
        is_name = heard.name != "swarmd" and (kind is not ros.Int32 or is_namespace(heard.name))
        return heard if is_name and (is_declared or options.unknown) else None
