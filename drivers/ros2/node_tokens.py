"""The liveliness tokens by which other nodes see a driver as a ROS node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import zenoh

from swarmd.drivers.ros2.key_scheme import KeyScheme, TopicEnd
from swarmd.link.carriers.session import undeclare


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
        publishers: Sequence[TopicEnd] = (),
    ) -> Mapping[str, str]:
        """Declare the tokens of all ends, in place of those declared before.

        `publishers`: the publisher of commands is the last one; none for a check, which publishes
        nothing. Returns the tokens of the publishers, by topic.
        """
        undeclare(*self._declared)
        tokens = self._scheme.tokens(str(session.info.zid()), [*subscriptions, *publishers])
        self._declared = [*map(session.liveliness().declare_token, tokens)]
        # The tokens of the ends come last, in the order of the ends.
        own = tokens[len(tokens) - len(publishers) :]
        self.command = own[-1] if own else ""
        return dict(zip((end.topic for end in publishers), own, strict=True))
