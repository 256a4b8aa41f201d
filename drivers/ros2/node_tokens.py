"""The liveliness tokens by which other nodes see a driver as a ROS node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import zenoh

from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.network.carriers.session import undeclare


class PublishingTopics(Protocol):
    """Topics that the driver publishes beside the commands."""

    @property
    def ends(self) -> Sequence[TopicEnd]:
        """The publishers."""

    def announced(self, tokens: Mapping[str, str]) -> None:
        """Take the tokens of publishers, by topic."""


class NodeTokens:
    """The tokens of one session. `command`: the token of the publisher of commands."""

    def __init__(self, scheme: KeyScheme) -> None:
        """Nothing is declared yet."""
        self._scheme = scheme
        self._declared: list[zenoh.LivelinessToken] = []
        self.command = ""

    @property
    def are_declared(self) -> bool:
        """True once other nodes see this node."""
        return bool(self._declared)

    def declare(
        self,
        session: zenoh.Session,
        subscriptions: Sequence[TopicEnd],
        command: TopicEnd | None,
        published: Sequence[PublishingTopics],
    ) -> None:
        """Declare the tokens of all ends, in place of those declared before.

        `command`: the publisher of commands; None for a check, which publishes nothing.
        """
        undeclare(*self._declared)
        if command is None:
            tokens = self._scheme.tokens(str(session.info.zid()), subscriptions)
            self._declared = [*map(session.liveliness().declare_token, tokens)]
            return
        other_ends = [end for topics in published for end in topics.ends]
        zid = str(session.info.zid())
        # The tokens of the ends come last, in the order of the ends: so the token of the commands
        # is the last token, and the tokens of `other_ends` stand before it.
        tokens = self._scheme.tokens(zid, [*subscriptions, *other_ends, command])
        *earlier_tokens, self.command = tokens
        other_tokens = earlier_tokens[len(earlier_tokens) - len(other_ends) :]
        token_of = dict(zip((end.topic for end in other_ends), other_tokens, strict=True))
        for topics in published:
            topics.announced(token_of)
        self._declared = [*map(session.liveliness().declare_token, tokens)]
