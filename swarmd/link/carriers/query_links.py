"""Finds the robots to which a link is up, so that a query would reach them; sends no query."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Iterable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from swarmd.core.keys import ANY

if TYPE_CHECKING:
    import zenoh


class QueryLinks:
    """The robots that answer queries on `key`, whose robot is a wildcard.

    `calls`: held while `close` calls Zenoh.
    """

    def __init__(self, key: str, calls: AbstractContextManager[object]) -> None:
        self._key = key
        self._calls = calls
        self._queriers: list[tuple[zenoh.Session, dict[str, zenoh.Querier]]] = []

    def of(self, robots: Collection[str], sessions: Iterable[zenoh.Session]) -> set[str]:
        """The robots in `robots` whose queryable of the key is known in one of the sessions."""
        if not robots:
            return set()
        known = [session for session, _ in self._queriers]
        for session in sessions:
            if not any(session is old for old in known):
                self._queriers.append((session, {}))
        return {robot for robot in robots if self._is_linked(robot)}

    def close(self) -> None:
        """Undeclare the queriers."""
        from swarmd.link.carriers.session import undeclare  # loads Zenoh; datagrams need none

        with self._calls:
            undeclare(*(querier for _, queriers in self._queriers for querier in queriers.values()))

    def _is_linked(self, robot: str) -> bool:
        import zenoh  # datagrams need none

        from swarmd.link.carriers.session import has_queryable

        for session, queriers in self._queriers:
            with contextlib.suppress(zenoh.ZError):  # the session is closed
                if robot not in queriers:
                    queriers[robot] = session.declare_querier(self._key.replace(ANY, robot, 1))
                if has_queryable(queriers[robot]):
                    return True
        return False
