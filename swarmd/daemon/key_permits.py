"""What the permits of a roster leave of the requests and stops that reach one daemon."""

from __future__ import annotations

import time
from collections.abc import Callable

from msgspec.structs import replace

from swarmd.core.clock import Clock, boottime
from swarmd.core.events import GoalInput, Input, LatchesInput
from swarmd.core.names import owner_of
from swarmd.core.verbs import AnyRequest
from swarmd.link.datagram import Stop
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.key_permit import (
    Denial,
    PresentRun,
    denied,
    fault_of_time,
    is_bound_stop,
    judge,
    stoppable,
)
from swarmd.link.keys.roster import KeyPermit, Role
from swarmd.link.peer import StopVerdict
from swarmd.link.signature import Author


class KeyPermits:
    """Judges what comes in the name of a permit; the requests of other names come back unchanged.

    `identity` returns the present identity of the robot; None: a swarm without keys. `present_run`
    returns the run of the robot; None without one. `wall` returns s since 1970, `clock` s.
    """

    def __init__(
        self,
        robot: str,
        identity: Callable[[], Identity | None],
        present_run: Callable[[], PresentRun | None],
        *,
        wall: Callable[[], float] = time.time,
        clock: Clock = boottime,
    ) -> None:
        self._robot = robot
        self._identity = identity
        self._present_run = present_run
        self._wall = wall
        self._clock = clock
        # The names with a permit on the present roster.
        self._permitted: frozenset[str] = frozenset()
        # By name that had a permit in this life of the daemon and has none now: s when it ended.
        self._ended: dict[str, float] = {}
        self.take_roster()

    def take_roster(self) -> None:
        """Take note of a new roster, which `identity` returns from now on.

        What a name asked under its permit may still come: by a link that is not closed yet, and by
        the relay of a robot that has an older roster. Without its permit the name may ask nothing.
        """
        identity = self._identity()
        if identity is None:
            return
        roster = identity.roster
        now = self._clock()
        for name in self._permitted - roster.permits.keys():
            self._ended[name] = now
        self._permitted = frozenset(roster.permits)
        for name in self._permitted | roster.operators.keys():
            self._ended.pop(name, None)

    def judge(self, request: AnyRequest) -> AnyRequest | Denial:
        """The request as its permit permits it, or why this robot refuses it."""
        permit = self._of(request.operator)
        if permit is None:
            gone = self._fault_of_former(request.operator)
            return Denial(gone) if gone else request
        wall = self._wall()
        return judge(permit, request, self._robot, wall=wall, running=self._present_run())

    def judge_stop(self, stop: Stop, author: Author | None) -> StopVerdict:
        """What the permit of its name leaves of a stop that came as a datagram.

        `author`: its verified signer. The robots of the permit alone get the stop from this robot,
        whatever other robots know of permits.
        """
        permit = self._of(stop.operator)
        if permit is None:
            # A permit of the roster before ends with that roster; a stop of an operator counts on.
            is_of_permit = author is not None and author.role is Role.PERMIT
            gone = self._fault_of_former(stop.operator)
            if is_of_permit and not gone:
                gone = f"{stop.operator} sent it under a permit that has ended"
            return StopVerdict(None, gone) if gone else StopVerdict(stop)
        name = stop.operator
        is_for_this = stop.targets is None or self._robot in stop.targets
        if text := fault_of_time(permit, self._robot, self._wall()):
            return StopVerdict(None, f"{name}: {text}" if is_for_this else "")
        if not is_bound_stop(permit, stop.verb):
            return StopVerdict(stop)
        robots = self._robots() if stop.targets is None else stop.targets
        targets = stoppable(permit, stop.verb, robots)
        is_denied = is_for_this and self._robot not in targets
        refusal = denied(permit, name, f"{stop.verb} {self._robot}").text if is_denied else ""
        narrowed = replace(stop, targets=targets, scope="robots") if targets else None
        return StopVerdict(narrowed, refusal)

    def role_of(self, name: str) -> str:
        """The name of the permit of a key, such as `pupils`; empty without a permit."""
        permit = self._of(name)
        return "" if permit is None else permit.role

    def judge_input(self, input: Input) -> Input | None:
        """What counts of an input that came from another robot; None if nothing of it counts.

        A stop of all robots leaves a goal to stand on each robot, an emergency stop a latch, and
        robots tell each other of both. A robot with an older roster, or whose clock is behind, may
        have carried out a stop that its permit no longer permitted: what it tells of that stop does
        not count.
        """
        if isinstance(input, GoalInput):
            return input if self._counted(input.goal.issuer, input.age) else None
        if isinstance(input, LatchesInput):
            counted = {
                id: latch
                for id, latch in input.latches.items()
                if self._counted(latch.issuer, latch.age)
            }
            return LatchesInput(counted) if counted or not input.latches else None
        return input

    def _counted(self, issuer: str, age: float | None) -> bool:
        """False for a stop that its issuer gave `age` s ago, after the end of its permit."""
        if age is None:
            return True  # of a time before a restart: a stop counts in doubt
        permit = self._of(issuer)
        if permit is not None:
            return self._wall() - age < permit.until
        ended_at = self._ended.get(owner_of(issuer))
        return ended_at is None or self._clock() - age < ended_at

    def _fault_of_former(self, name: str) -> str:
        """Why a name without a permit may ask nothing: it had one; empty if it may."""
        return f"{name} has no permit any more" if owner_of(name) in self._ended else ""

    def _robots(self) -> tuple[str, ...]:
        identity = self._identity()
        return () if identity is None else identity.roster.robots

    def _of(self, name: str) -> KeyPermit | None:
        identity = self._identity()
        return None if identity is None else identity.roster.permits.get(owner_of(name))
