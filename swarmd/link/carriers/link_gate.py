"""Protects the TCP port of a secured robot from floods of connections and of links.

Zenoh accepts every TCP connection, gives its TLS handshake 10 s, and waits 100 ms after each
handshake that failed. So 20 failed handshakes a second keep operators out. Connections that send
nothing use up the files that the process may open. Measured: a flood took all 4096 files within a
second, and none was free for minutes after the flood.

`LinkFlood` detects waiting connections by the number of open files. For some time the kernel's
packet filter (`LinkGate`) then accepts only connections from known hosts: hosts that sent a
datagram with a valid signature. Stops, beacons and answers are datagrams, and need no connection.

Zenoh takes 1000 links of any valid certificate, also of a revoked name, and then no further link.
`LinkShares` bounds the links of a name, and of all names that are no operators. Links beyond the
bounds are ended (`end_links`). A host that opens many of them is refused by the packet filter for
some time, unless it is also a host of an operator.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections import Counter
from collections.abc import Collection, Iterable, Mapping

from swarmd.core.bounds import keep_newest
from swarmd.link.carriers.packet_filter import attach_filter, host_filter
from swarmd.link.carriers.session import FDS, own_sockets
from swarmd.link.keys.roster import Roster

LOOK_PERIOD = 0.25  # s between two counts of the open files
MAX_WAITING = 48  # open files beyond those at the start and those of links that make a flood
# s; doubled if the flood is back within that time
CLOSED_TIME = 60.0
MAX_CLOSED_TIME = 600.0
RENEW_PERIOD = 30.0  # s between two new sessions: a new session also ends the links of operators
KNOWN_TIME = 600.0  # s after which a host is forgotten
MAX_HOSTS = 64  # hosts in the kernel's filter
MAX_NAME_LINKS = 64  # links of one name: a class may share the certificate of a viewer
MAX_OTHER_LINKS = 512
"""Links of robots and viewers together: Zenoh takes 1000, and the rest stays free for operators."""
MAX_ENDED = 16  # links of a host that may be ended at one look before the host is refused
LINE_RATE = 0.1
LINE_BURST = 5.0
"""Lines about ended links per second, and at once."""
_SO_DETACH_FILTER = 27


class LinkFlood:
    """Decides when the port is closed to unknown hosts, and which hosts are known. Pure.

    `files`: the number of open files of the process at the start, without links. Times in s.
    """

    def __init__(self, files: int, now: float) -> None:
        self._files = files
        self._look_at = now
        self._renew_at = -1e9
        self._closed_time = CLOSED_TIME
        self._heard: dict[str, float] = {}
        self._operators: dict[str, float] = {}  # hosts of operators, with the time of a datagram
        self._refused: dict[str, float] = {}  # hosts, with the time until which they are refused
        self.closed_until = -1e9
        self.waiting = 0

    def is_closed(self, now: float) -> bool:
        """True while only known hosts may connect."""
        return now < self.closed_until

    def hear(self, host: str, now: float, *, is_operator: bool = False) -> bool:
        """Note a host that sent a datagram with a valid signature; True if it was unknown.

        `is_operator`: an operator signed the datagram.
        """
        is_new = host not in self._heard
        keep_newest(self._heard, host, now, 2 * MAX_HOSTS)
        if is_operator:
            keep_newest(self._operators, host, now, 2 * MAX_HOSTS)
        return is_new

    def end(self, hosts: Iterable[str], now: float) -> list[str]:
        """Note that a link of each host was ended; returns the hosts that are refused from now on.

        A host of an operator is not refused: its operator would be shut out for the flood.
        """
        flooding = [host for host, count in Counter(hosts).items() if count > MAX_ENDED]
        refused = [h for h in flooding if now - self._operators.get(h, -1e9) > KNOWN_TIME]
        for host in refused:
            keep_newest(self._refused, host, now + CLOSED_TIME, MAX_HOSTS)
        return refused

    def refused(self, now: float) -> tuple[str, ...]:
        """The hosts that may not connect."""
        return tuple(host for host, until in self._refused.items() if now < until)

    def known(self, now: float) -> tuple[str, ...]:
        """The hosts that may connect while the port is closed.

        The last MAX_HOSTS hosts that were heard within KNOWN_TIME.
        """
        recent = [host for host, at in self._heard.items() if now - at <= KNOWN_TIME]
        return tuple(recent[-MAX_HOSTS:])

    def is_due(self, now: float) -> bool:
        """True if `look` is to be called."""
        return now >= self._look_at

    def look(self, files: int, links: int, now: float) -> bool:
        """Compare the number of open files with the limit; True if a flood has just been detected.

        `files`: the number of open files. `links`: how many of them belong to links of the session.
        After a flood was detected, `is_closed` is True for some time. The caller must let only
        known hosts connect, and open a new session, which ends the connections that wait.
        """
        self._look_at = now + LOOK_PERIOD
        self.waiting = files - self._files - links
        if self.waiting <= MAX_WAITING or now < self._renew_at:
            return False
        is_back = now - self.closed_until <= self._closed_time
        self._closed_time = min(2 * self._closed_time, MAX_CLOSED_TIME) if is_back else CLOSED_TIME
        self.closed_until = now + self._closed_time
        self._renew_at = now + RENEW_PERIOD
        return True


class LinkGate:
    """The packet filter on the sockets with which Zenoh listens at some ports. Linux only."""

    def __init__(self, ports: Collection[int]) -> None:
        self._sockets = [
            socket.socket(fileno=listener.detach())  # `dup` would let Zenoh's socket block
            for listener in own_sockets()
            if listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            and listener.getsockname()[1] in ports
        ]
        self._rule: tuple[set[str] | None, set[str]] = (None, set())

    def admit(self, hosts: Collection[str] | None, refused: Collection[str] = ()) -> None:
        """Accept connections only from `hosts` (None: from all), and none from `refused`.

        Existing links stay.
        """
        rule = None if hosts is None else {*hosts} - {*refused}, {*refused}
        if rule == self._rule:
            return
        self._rule = rule
        for listener in self._sockets:
            with contextlib.suppress(OSError):  # no filter to detach, or filters are forbidden
                if hosts is None and not refused:
                    listener.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
                    continue
                attach_filter(listener, host_filter(*rule))

    def close(self) -> None:
        """Close the duplicates of the sockets."""
        for listener in self._sockets:
            listener.close()
        self._sockets = []


def open_files() -> int:
    """The number of open files of this process; the limit if no further file can be opened."""
    try:
        return len(os.listdir(FDS))
    except OSError:
        return os.sysconf("SC_OPEN_MAX")


class LinkShares:
    """Decides which links must end, so that no name takes the places of others. Pure.

    `per_name`: links of one name. `others`: links of robots and viewers together.
    """

    def __init__(
        self, roster: Roster, *, per_name: int = MAX_NAME_LINKS, others: int = MAX_OTHER_LINKS
    ) -> None:
        self._roster = roster
        self._names = frozenset(roster.names)
        self._per_name = per_name
        self._others = others
        self._links: dict[str, str] = {}  # locator of the far end to name, the oldest link first

    def excess(self, links: Mapping[str, str]) -> dict[str, str]:
        """The links that must end, with the reason.

        `links`: the name in the certificate of each link, by the locator of its far end.
        """
        self._links = {far: links[far] for far in self._links if far in links} | {**links}
        ended: dict[str, str] = {}
        kept: Counter[str] = Counter()
        other_count = 0
        for far, name in self._links.items():
            is_operator = name in self._roster.operators
            if name not in self._names:
                ended[far] = f"the name is not on roster {self._roster.generation}"
            elif kept[name] >= self._per_name:
                ended[far] = f"{self._per_name} links of this name are open"
            elif not is_operator and other_count >= self._others:
                ended[far] = f"{self._others} links of robots and viewers are open"
            else:
                kept[name] += 1
                other_count += not is_operator
        return ended
