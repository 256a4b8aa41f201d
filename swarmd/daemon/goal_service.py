"""Stores the goals of one daemon on disk, and verifies the signatures of goals."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from msgspec.structs import replace

from swarmd.core.clock import boottime, clock_id
from swarmd.core.goal import Goal, GoalRecord, digest_of
from swarmd.core.messages import Code, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.verbs import Request
from swarmd.daemon.store import RecordWriter, StateFile
from swarmd.link.keys.identity import Identity
from swarmd.link.spread.goal_sync import GoalCheck, is_signed_goal

log = logging.getLogger(__name__)

STORE_TIME = 1.0  # s for which the answer to a stop waits for the disk


class GoalService:
    """Stores the robot's goals on disk, and verifies received goals.

    A goal is valid if its issuer is an operator of the roster and has signed the goal. `identity`
    returns the present identity; None: a swarm without keys, in which every goal is valid.
    `on_event` takes a line for the log.
    """

    def __init__(
        self, folder: Path, identity: Callable[[], Identity | None], on_event: Callable[[str], None]
    ) -> None:
        self._file = StateFile(folder / "goal", GoalRecord, "goal and labels are lost")
        self._identity = identity
        self._writer = RecordWriter(self._file, on_event)
        # Two budgets of verifications: false goals of robots must not use up that of operators.
        self._check = GoalCheck(self._key_of)
        self._check_asked = GoalCheck(self._key_of)

    def read(self) -> GoalRecord:
        """The goals that an earlier instance stored, without goals that do not count."""
        record = self._file.read()
        now = boottime()
        stood = record.stood
        if stood is not None and (record.clock != clock_id() or stood > now):
            # The machine was restarted or set back since: all its earlier times lie before now.
            record = replace(record, stood=now)
        foreign = self._foreign(record)
        if not foreign:
            return record
        log.warning("%d goals that no operator of the roster signed are left out", len(foreign))
        kept = (
            None if goal in foreign else goal for goal in (record.held, record.own, record.before)
        )
        held, own, before = kept
        return replace(record, held=held or own, own=own, before=before)

    def foreign(self, record: GoalRecord) -> tuple[str, ...]:
        """The digests (hex) of the goals that do not count; takes some 4 ms for each signature."""
        return tuple({digest_of(goal).hex() for goal in self._foreign(record)})

    def _foreign(self, record: GoalRecord) -> list[Goal]:
        if self._identity() is None:
            return []
        goals: list[Goal] = []
        for goal in (record.held, record.own, record.before):
            if goal is not None and goal not in goals:
                goals.append(goal)
        return [goal for goal in goals if not is_signed_goal(goal, self._key_of)]

    def store(self, record: GoalRecord) -> None:
        """Write the record soon; a later record replaces it."""
        clock = "" if record.stood is None else clock_id()
        self._writer.store(replace(record, clock=clock))

    @property
    def is_writing(self) -> bool:
        """True while the last record is not on disk."""
        return self._writer.is_busy

    async def is_stored(self) -> bool:
        """True once the last record is on disk; False after STORE_TIME or a failed write."""
        return await self._writer.is_written(STORE_TIME)

    async def close(self) -> None:
        """Wait until the last record is written, or one more try has failed."""
        await self._writer.close()

    def check(self, goal: Goal, now: float) -> bool | None:
        """True if a goal counts; None if it cannot be verified now."""
        return True if self._identity() is None else self._check(goal, now)

    def refusal_of(self, request: Request, robot: str) -> Reply | None:
        """The refusal of a request whose goal is not signed by its issuer; None to accept it."""
        goal: Goal | None = getattr(request, "goal", None)
        if goal is None or self._identity() is None:
            return None
        counts = self._check_asked(goal, boottime())
        if counts:
            return None
        refusal = Refusal.INVALID_GOAL
        text = f"{goal.text}: not signed by {goal.issuer}"
        if counts is None:
            refusal = Refusal.BUSY
            text = "too many goals to verify at once; ask again"
        return Reply(id=request.id, robot=robot, code=Code.REFUSED, refusal=refusal, text=text)

    def _key_of(self, issuer: str) -> bytes | None:
        identity = self._identity()
        return None if identity is None else identity.roster.operators.get(issuer)
