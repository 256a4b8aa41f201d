"""The newer roster and the keys that an operator or viewer lacks, and how they are taken.

Robots do not answer what is signed with keys of an earlier generation.
"""

from __future__ import annotations

import threading
from typing import Protocol

from swarmd.core.errors import ConfigError, NetworkError
from swarmd.network.datagram import Address
from swarmd.network.settings import NetworkSettings
from swarmd.security.identity import Identity

MAX_MISSING_KEYS = 2048
CLOSING = "swarmd-closing"
"""The name of the threads that close sessions or take rosters: Python must not end before them."""


class Follower(Protocol):
    """The operator or viewer that takes rosters."""

    settings: NetworkSettings
    identity: Identity | None

    def take_identity(self, identity: Identity) -> None:
        """Ask with this identity from now on."""


class RosterFollower:
    """Takes newer rosters for `operator`; nothing if not `is_on`. `notices`: lines for the user.

    `shown`: a robot, its address and the generation that it shows, which is not proven.
    """

    def __init__(self, operator: Follower, *, is_on: bool) -> None:
        self._operator = operator
        self._is_on = is_on
        self._updating: threading.Thread | None = None
        self.shown: tuple[str, Address, int] | None = None
        self._missing: set[tuple[str, Address]] = set()
        self.notices: list[str] = []

    def on_shown(self, robot: str, address: Address, generation: int) -> None:
        """A robot has shown a newer generation.

        The own roster must have that robot: no link proves the names of others.
        """
        if self.shown is None or self._is_known(robot):
            self.shown = robot, address, generation

    def on_missing_key(self, robot: str, address: Address) -> None:
        """A robot was heard whose key is missing."""
        if len(self._missing) < MAX_MISSING_KEYS:
            self._missing.add((robot, address))

    def update(self) -> None:
        """Take the roster that was shown and missing keys, if any; waits.

        NetworkError if the roster lacks the own name.
        """
        if self._updating is not None:
            self._updating.join()
            self._updating = None
        self._take()

    def begin(self) -> None:
        """Take them on a thread, so that a stop under way goes on being sent."""

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
        shown = self.shown
        if shown is not None and not self._is_known(shown[0]):
            shown = None
        elif shown is not None:
            self.shown = None
        missing = set()
        while self._missing:  # the carrier's thread may add to it
            missing.add(self._missing.pop())
        identity, settings = self._operator.identity, self._operator.settings
        if not (shown or missing) or identity is None or not self._is_on:
            return
        from swarmd.network.operator.roster_update import pulled_keys, pulled_roster

        if shown is not None:
            taken, text = pulled_roster(settings, identity, *shown)
            self.notices.append(text)
            if taken is not None:
                self._operator.take_identity(taken)
                return
        completed = pulled_keys(settings, identity, missing) if missing else None
        if completed is not None:
            self._operator.take_identity(completed)
