"""Takes a newer roster, or keys that the operator or viewer lacks, from robots.

Robots do not answer a datagram that is signed with keys of an earlier generation of the roster. So
an operator with such keys needs the newer roster first.
"""

from __future__ import annotations

import threading
from typing import Protocol

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.link.datagram import Address
from swarmd.link.keys.identity import Identity
from swarmd.link.settings import NetworkSettings

MAX_MISSING_KEYS = 2048
CLOSING = "swarmd-closing"
"""The name of threads that close sessions or take rosters: a command waits for them at its end."""


class Follower(Protocol):
    """The operator or viewer that takes rosters."""

    settings: NetworkSettings
    identity: Identity | None

    def take_identity(self, identity: Identity) -> None:
        """Ask with this identity from now on."""


class RosterFollower:
    """Takes newer rosters, and keys that `operator` lacks, from robots.

    `is_on` False: nothing is taken. `notices`: lines for the user. `shown`: a robot that may have a
    newer roster, its address, and the generation of that roster. No signature proves these three
    values. The roster itself is verified after it was pulled from the address.
    """

    def __init__(self, operator: Follower, *, is_on: bool) -> None:
        self._operator = operator
        self._is_on = is_on
        self._updating: threading.Thread | None = None
        self.shown: tuple[str, Address, int] | None = None
        self._missing: set[tuple[str, Address]] = set()
        self.notices: list[str] = []

    def on_shown(self, robot: str, address: Address, generation: int) -> None:
        """Note a robot that shows a newer generation.

        A robot of the own roster replaces any other: a link can prove only names of the roster.
        """
        if self.shown is None or self._is_known(robot):
            self.shown = robot, address, generation

    def on_missing_key(self, robot: str, address: Address) -> None:
        """Note a robot whose key is missing."""
        if len(self._missing) < MAX_MISSING_KEYS:
            self._missing.add((robot, address))

    def update(self) -> None:
        """Take the newer roster and the missing keys that were noted; waits for robots.

        Raises NetworkError if the new roster lacks the own name.
        """
        if self._updating is not None:
            self._updating.join()
            self._updating = None
        self._take()

    def begin(self) -> None:
        """As `update`, on a thread: a stop under way goes on. Errors become notices."""

        def run() -> None:
            try:
                self._take()
            except (NetworkError, ConfigError, OSError) as error:
                self.notices.append(str(error))

        is_updating = self._updating is not None and self._updating.is_alive()
        is_due = self.shown is not None and self._is_known(self.shown[0])
        if not is_updating and (is_due or self._missing):
            self._updating = threading.Thread(target=run, name=CLOSING, daemon=True)
            self._updating.start()

    def _is_known(self, robot: str) -> bool:
        identity = self._operator.identity
        return identity is not None and robot in identity.roster.robots

    def _take(self) -> None:
        newer = self.shown
        if newer is not None and not self._is_known(newer[0]):
            newer = None  # no link could prove the name of that robot
        if newer is not None:
            self.shown = None
        missing = set()
        while self._missing:  # the carrier's thread may add to it
            missing.add(self._missing.pop())
        identity = self._operator.identity
        settings = self._operator.settings
        if not (newer or missing) or identity is None or not self._is_on:
            return
        from swarmd.operator.session.roster_update import pulled_keys, pulled_roster

        if newer is not None:
            taken, text = pulled_roster(settings, identity, *newer)
            self.notices.append(text)
            if taken is not None:
                self._operator.take_identity(taken)
                return
        completed = pulled_keys(settings, identity, missing) if missing else None
        if completed is not None:
            self._operator.take_identity(completed)
