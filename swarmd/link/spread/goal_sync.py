"""How the greatest goal spreads: beacons show digests, and a robot asks for a goal. Pure.

A goal is the run that an operator has given to a swarm; goals are numbered by generation.

1. If the beacon of a peer shows another goal, of at least the generation of this robot's goal, this
   robot asks the peer for its goal.
2. Each question has a random number, which the answer repeats. An answer without the number of a
   question of this robot is dropped: an attacker cannot replay an answer with an old goal or age.
3. The time from question to answer is added to the age of the goal.
4. A robot that does not know the age of its goal asks robots that hold the same goal.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple

from swarmd.core.bounds import MAX_SECONDS, keep_newest
from swarmd.core.errors import CodecError
from swarmd.core.goal import MAX_UNSIGNED, Goal, HeldGoal, decode_goal, digest_of, signed_part
from swarmd.core.record import may_replace
from swarmd.core.token_bucket import TokenBucket
from swarmd.link.datagram import Address, GoalReport
from swarmd.link.keys.content_signature import Purpose, has_form, is_signed_by
from swarmd.link.spread.asks import MAX_KNOWN, Asks

ASK_PERIOD = 0.25  # s between questions to one robot
ASKED_AT_ONCE = 2  # robots that are asked for one goal in a period
AGE_PERIOD = 2.0  # s between questions for the age of the own goal
# questions per second, whatever beacons show
ASK_RATE = 20.0
ASK_BURST = 20.0
ANSWER_TIMEOUT = 2.0  # s
MAX_REPEATS = 3
MAX_CHECKED = 64
CHECK_RATE = 4.0
CHECK_BURST = 8.0
"""Signatures verified per second, and at once: each takes about 4 ms of a core."""


class FoundGoal(NamedTuple):
    """A goal of a peer."""

    goal: Goal
    age: float | None  # s since the goal was set; None: the peer does not know the age
    may_join: bool = False
    """The goals of all other peers are known, too: the robot may join the run of this goal."""


class _Question(NamedTuple):
    instance: bytes
    digest: bytes
    source: Address
    at: float
    repeats: int = 0
    repeated_at: float = 0.0


class GoalSync:
    """Which robots to ask for their goals; `seed`: of the random numbers of questions."""

    def __init__(self, seed: int) -> None:
        from random import Random  # here: operators import this file and make no GoalSync

        self._random = Random(seed)
        self._asks = Asks(ASK_PERIOD, ASKED_AT_ONCE)
        self._questions: dict[int, _Question] = {}
        self._budget = TokenBucket(ASK_RATE, ASK_BURST)
        self._age_asked = -1e9

    def wants(
        self, instance: bytes, digest: bytes, source: Address, own: HeldGoal | None, now: float
    ) -> int | None:
        """Begin a question to the sender of a beacon if due; its number, None without a question.

        `digest`: of the goal in the beacon. `own`: the goal of this robot.
        """
        if own is not None and digest == own.digest:
            is_due = _lacks_age(own) and now - self._age_asked >= AGE_PERIOD
            self._age_asked = now if is_due else self._age_asked
        else:
            is_lacking = self.lacks(instance, digest, b"" if own is None else own.digest)
            is_due = is_lacking and self._asks.take(instance, now, digest)
        return self._ask(_Question(instance, digest, source, now), now) if is_due else None

    def repeats(self, own: HeldGoal | None, now: float) -> list[tuple[int, Address]]:
        """The questions to repeat, since their answers are overdue: number and receiver.

        A question ends after ANSWER_TIMEOUT or MAX_REPEATS, or once its goal is held with its age.
        """
        asked: list[tuple[int, Address]] = []
        for echo, question in list(self._questions.items()):
            if now - question.at < ASK_PERIOD:
                continue
            is_over = now - question.at >= ANSWER_TIMEOUT or question.repeats >= MAX_REPEATS
            is_held = own is not None and question.digest == own.digest and not _lacks_age(own)
            if is_over or is_held:
                del self._questions[echo]
            elif question.repeated_at + ASK_PERIOD <= now:
                self._questions[echo] = question._replace(
                    repeats=question.repeats + 1, repeated_at=now
                )
                asked.append((echo, question.source))
        return asked

    def on_report(self, report: GoalReport, now: float) -> FoundGoal | None:
        """The goal in an answer; None if the answer is late, unasked for, or unreadable."""
        question = self._questions.pop(report.echo, None)
        if question is None or question.instance != report.instance:
            return None
        trip = now - question.at
        if trip > ANSWER_TIMEOUT:
            return None
        self._asks.answered(report.instance, question.digest)
        try:
            goal = decode_goal(report.goal)
        except CodecError:
            return None
        if digest_of(goal) != question.digest:  # the robot's next beacon shows its present goal
            self._asks.forget(report.instance)
        if report.age is None:
            return FoundGoal(goal, None)
        return FoundGoal(goal, min(report.age / 1000.0 + trip, MAX_SECONDS))

    def lacks(self, instance: bytes, digest: bytes, own: bytes) -> bool:
        """True if this robot must ask a peer for its goal, which may be greater than the own goal.

        `digest`: of the goal that the peer shows. `own`: of this robot's goal. False if the peer
        has answered for this digest already.
        """
        return may_replace(digest, own) and not self._asks.knows(instance, digest)

    def retry(self, instance: bytes) -> None:
        """Ask a robot again: its answer could not be used."""
        self._asks.forget(instance)

    def _ask(self, question: _Question, now: float) -> int | None:
        if not self._budget.take(1.0, now):
            return None
        echo = self._random.getrandbits(52) + 1
        keep_newest(self._questions, echo, question, MAX_KNOWN)
        return echo


def needs_no_signature(goal: Goal) -> bool:
    """True for a goal that only stops, up to the generation MAX_UNSIGNED."""
    return goal.pattern is None and goal.generation <= MAX_UNSIGNED


def is_signed_goal(goal: Goal, key_of: Callable[[str], bytes | None]) -> bool:
    """True if a goal is signed by its issuer, or needs no signature; takes some 4 ms."""
    return needs_no_signature(goal) or is_signed_by(
        key_of(goal.issuer), Purpose.GOAL, signed_part(goal), goal.signature
    )


class GoalCheck:
    """Verifies that the issuer of a goal has signed the goal.

    `key_of(name)` returns the public key of an operator. Each goal is verified once, at most
    CHECK_RATE goals a second. A goal without a pattern only stops robots: up to the generation
    MAX_UNSIGNED such a goal needs no signature.
    """

    def __init__(self, key_of: Callable[[str], bytes | None]) -> None:
        self._key_of = key_of
        self._checked: dict[bytes, bool] = {}
        self._budget = TokenBucket(CHECK_RATE, CHECK_BURST)

    def __call__(self, goal: Goal, now: float) -> bool | None:
        """True if the goal is accepted; None if the limit of the rate forbids a check now."""
        if needs_no_signature(goal):
            return True
        public_key = self._key_of(goal.issuer)
        if public_key is None or not has_form(goal.signature):
            return False
        content = public_key + goal.signature + signed_part(goal)
        name = hashlib.blake2b(content, digest_size=16, person=b"swarmd goal").digest()
        if name not in self._checked:
            if not self._budget.take(1.0, now):
                return None
            keep_newest(self._checked, name, is_signed_goal(goal, self._key_of), MAX_CHECKED)
        return self._checked[name]


def _lacks_age(own: HeldGoal) -> bool:
    return own.issued is None and own.goal.pattern is not None
