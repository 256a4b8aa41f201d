"""Lines on the certificates and rosters of robots. Ages are by the clock of the reader."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

from swarmd.core.clock import FIRST_WALL
from swarmd.core.messages import Status
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.key_permit import fault_of_time, permit_text
from swarmd.operator.texts.values import counted, seconds

WARN_DAYS = 14
"""A certificate that ends within so many days is warned of."""
UNSET_CLOCK = "the clock of this machine has not been set"
DAY = 86400.0  # s


def day(expires: float) -> str:
    """The date of a time in s since 1970 (UTC)."""
    return time.strftime("%Y-%m-%d", time.gmtime(expires))


def end_of_certificate(expires: float, now: float) -> str:
    """The text for a certificate that has ended or ends within WARN_DAYS; otherwise empty.

    `expires` and `now` in s since 1970. Also empty if the clock of this machine was not set.
    """
    left = expires - now
    if now < FIRST_WALL:
        return f"whether the certificate has ended is not known: {UNSET_CLOCK}"
    if left < 0:
        return "the certificate has ended by the clock of this machine"
    if left >= WARN_DAYS * DAY:
        return ""
    return f"the certificate ends in {life(left)}"


def own_remedy(name: str) -> str:
    """How an operator or viewer gets a new certificate."""
    return f"get a new bundle where the authority is: `swarmctl keys bundle {name}`"


def own_end(name: str, expires: float, now: float) -> str:
    """The text for an own certificate that has ended; otherwise empty."""
    if expires > now:
        return ""
    return (
        f"the certificate of {name} (this user) has ended by the clock of this machine: robots"
        f" refuse its links, and hear its stops; set the clock if it is wrong, else"
        f" {own_remedy(name)}"
    )


def key_text(identity: Identity) -> str:
    """The name of a key and what it may do: `bob (operator)`, `anna (pupils: stop; until ..)`."""
    permit = identity.roster.permits.get(identity.name)
    if permit is None:
        return f"{identity.name} ({identity.role})"
    return f"{identity.name} ({permit.role}: {permit_text(permit)})"


def permit_warning(identity: Identity, now: float) -> str:
    """Why the permit of this user does not count by the clock of this machine; else empty."""
    permit = identity.roster.permits.get(identity.name)
    if permit is None or now < FIRST_WALL:
        return ""
    return fault_of_time(permit, "this machine", now)


def life(left: float) -> str:
    """The time that a certificate has left, in whole days; below a day in hours or minutes."""
    days = int(left // DAY)
    return counted(days, "day") if days else seconds(left)


def key_warnings(statuses: Iterable[Status], now: float) -> Iterator[str]:
    """A line for each certificate that ends soon, and for each roster that is not the newest.

    `now`: in s since 1970.
    """
    ends: dict[str, list[str]] = {}
    generations: dict[int, list[str]] = {}
    for status in statuses:
        if status.keys is None:
            continue
        generations.setdefault(status.keys.generation, []).append(status.robot)
        if text := end_of_certificate(status.keys.expires, now):
            ends.setdefault(text, []).append(status.robot)
    remedy = "set it" if now < FIRST_WALL else "see `swarmctl keys renew`"
    for text, names in ends.items():
        yield f"WARNING: {text}: {', '.join(names)}; {remedy}"
    newest = max(generations, default=0)
    for generation, names in sorted(generations.items()):
        if generation < newest:
            yield f"older roster: {', '.join(names)} ({generation}, the newest is {newest})"
