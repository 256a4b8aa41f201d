"""The faults of robots that only peers can tell, as one robot knows them. Pure.

`link/members/hearing.py` finds which robots are mute or deaf. Kin (`robot/kin/`) finds whose lidar
does not fit, and who moves while it tells that it stands. From what robots tell each other of the
latter two, each robot names a fault by these rules:

1. A robot has a *misfit* if two robots or more doubt it, each of which fits with a robot at least,
   and with as many as it doubts, and if the robot that names it does not fit with it itself.
2. A robot *strays* if two robots or more tell it.
3. What this robot alone finds, and no rule names, is *doubted*: one of the two is at fault.

So one robot that lies gets no other named. They are words of status and log: no motion depends on
them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from msgspec.structs import replace

from swarmd.core.kin_message import KinOpinions
from swarmd.core.messages import DOUBTED, MISFIT, STRAYS, SUSPICIONS, PeerFault

_OWN = "self"
"""This robot among those that tell a fault."""
_LEAST = 2  # robots that must tell a fault before it is named
_KEPT = 5.0  # s after the last judgement for which the faults of kin stand


class PeerFaults:
    """The present faults. Times are in s on the robot's clock."""

    def __init__(self) -> None:
        self._heard = _Faults()
        self._seen = _Faults()
        self._since: dict[tuple[str, str], float] = {}

    def take(self, faults: tuple[PeerFault, ...], now: float) -> tuple[PeerFault, ...]:
        """Take all present faults of hearing; returns those that are new, and for the log.

        What this robot alone misses is a suspicion and no fault of the other: it is not logged.
        """
        return self._heard.take(faults, now)

    def judge(self, opinions: KinOpinions, now: float) -> tuple[PeerFault, ...]:
        """Name the faults that follow from kin; returns as `take` does."""
        found = list(_verdicts(opinions))
        if self._seen.age(now) > _KEPT:
            # Nobody asked for places meanwhile, so nothing is known of this time.
            self._seen.take((), now)
            self._since = {}
        since = self._since
        self._since = {
            (one.robot, one.kind): since.get((one.robot, one.kind), now) for one in found
        }
        faults = tuple(
            replace(one, since=max(now - self._since[one.robot, one.kind], 0.0)) for one in found
        )
        return self._seen.take(faults, now)

    def at(self, now: float) -> tuple[PeerFault, ...]:
        """The present faults, with their times at `now`."""
        heard = self._heard.at(now)
        return heard if self._seen.age(now) > _KEPT else heard + self._seen.at(now)


class _Faults:
    """The faults of one source."""

    def __init__(self) -> None:
        self._faults: tuple[PeerFault, ...] = ()
        self._at = 0.0

    def take(self, faults: tuple[PeerFault, ...], now: float) -> tuple[PeerFault, ...]:
        """Take all present faults; returns those that are new and no suspicions."""
        known = {(fault.robot, fault.kind) for fault in self._faults}
        self._faults = faults
        self._at = now
        return tuple(
            fault
            for fault in faults
            if fault.kind not in SUSPICIONS and (fault.robot, fault.kind) not in known
        )

    def age(self, now: float) -> float:
        """Seconds since they were taken."""
        return max(now - self._at, 0.0)

    def at(self, now: float) -> tuple[PeerFault, ...]:
        """The faults, with their times at `now`."""
        aged = self.age(now)
        return tuple(replace(fault, since=fault.since + aged) for fault in self._faults)


def _verdicts(opinions: KinOpinions) -> Iterator[PeerFault]:
    """The faults by what this robot and its peers tell, each once; their times are 0."""
    told = opinions.told
    doubts = {
        robot: one.doubted
        for robot, one in told.items()
        if _is_sound(len(one.doubted), one.fitting)
    }
    counts = _is_sound(len(opinions.doubted), len(opinions.fitting))
    for fault in _told(MISFIT, opinions.doubted, counts, doubts):
        if fault.kind != MISFIT or fault.robot not in opinions.fitting:
            yield fault
    yield from _told(
        STRAYS, opinions.straying, True, {robot: one.straying for robot, one in told.items()}
    )


def _told(
    kind: str, own: Mapping[str, str], counts: bool, told: Mapping[str, Sequence[str]]
) -> Iterator[PeerFault]:
    """The faults of one kind. `own`: figures of the own findings, which name only if `counts`.

    `told`: the robots that each peer tells.
    """
    accused = {robot for names in told.values() for robot in names} | own.keys()
    for robot in sorted(accused):
        figure = own.get(robot)
        others = [peer for peer in sorted(told) if peer != robot and robot in told[peer]]
        is_own = figure is not None and counts
        tellers = [*others, _OWN] if is_own else others
        of = len(told.keys() - {robot})
        if len(tellers) >= _LEAST:
            yield _fault(robot, kind, tellers, of + counts, figure)
        elif figure is not None:
            yield _fault(robot, DOUBTED, others, of, figure)


def _is_sound(doubted: int, fitting: int) -> bool:
    """True if a robot that doubts so many robots and fits with so many may be right."""
    return 0 < fitting >= doubted


def _fault(robot: str, kind: str, tellers: Sequence[str], of: int, figure: str | None) -> PeerFault:
    """A fault that these robots tell."""
    return PeerFault(
        robot=robot,
        kind=kind,
        by=len(tellers),
        of=of,
        tellers=tuple(tellers),
        figure=figure or "",
    )
