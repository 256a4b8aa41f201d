"""The outcome of a request: the targeted robots and their replies. Pure.

An empty list of acks is never success. `exit_codes.py` decides the exit code.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.messages import Code, Epoch, Reply
from swarmd.core.refusal import Refusal
from swarmd.link.datagram import Ack
from swarmd.operator.session.exit_codes import APPLIED, MISTAKES, code_of_outcome

MAX_ROBOTS = 1024
MAX_INSTANCES = 8

_CODES = frozenset(Code)
_REFUSALS = {str(refusal): refusal for refusal in Refusal}
_SEVERITY = {Code.APPLIED: 0, Code.REFUSED: 1, Code.FAILED: 2}


class Outcome(Struct, frozen=True):
    """The replies to a request, by robot, and the robots that did not answer.

    True only if `exit_code` is 0: all targeted robots applied the request, and no others may exist.
    """

    replies: Mapping[str, Reply]
    missing: tuple[str, ...] = ()  # targets without a reply
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0  # the duration of the request
    duplicates: tuple[str, ...] = ()  # robot ids with replies of several daemons
    reached: int = 0  # robots that were heard, with or without a reply
    unlisted: tuple[str, ...] = ()
    """Robots heard whose member list did not come: the swarm may have further robots."""
    unlabelled: tuple[str, ...] = ()
    """Robots whose labels are not known, so that they may be targets of a label."""
    mute: tuple[str, ...] = ()
    """Robots in `missing` that answer other questions: a secured robot may refuse the operator."""

    @property
    def targeted(self) -> int:
        """The number of robots that the request was for."""
        return len(self.replies) + len(self.missing)

    @property
    def applied(self) -> tuple[str, ...]:
        """The robots that applied the request."""
        return self._with(Code.APPLIED)

    @property
    def refused(self) -> tuple[str, ...]:
        """The robots that refused the request."""
        return self._with(Code.REFUSED)

    @property
    def failed(self) -> tuple[str, ...]:
        """The robots that failed to apply the request."""
        return self._with(Code.FAILED)

    @property
    def line(self) -> str:
        """A line for the user, such as `7 targeted, 6 applied, 1 no answer (tb3-03)`."""
        parts = [f"{self.targeted} targeted", f"{len(self.applied)} applied"]
        not_applied = {"refused": self.refused, "failed": self.failed, "no answer": self.missing}
        for label, robots in not_applied.items():
            if robots:
                parts.append(f"{len(robots)} {label} ({', '.join(robots)})")
        return ", ".join(parts)

    @property
    def mistake(self) -> str:
        """The text of a mistake of the operator that all answering robots refused; else empty.

        For example an unknown parameter: only the robots know their patterns and parameters.
        """
        replies = self.replies.values()
        texts = {reply.text for reply in replies}
        is_mistake = all(reply.refusal in MISTAKES for reply in replies)
        is_refused = len(self.refused) == len(replies)
        return texts.pop() if is_refused and is_mistake and len(texts) == 1 else ""

    @property
    def exit_code(self) -> int:
        """The exit code of swarmctl for this outcome."""
        return code_of_outcome(self)

    def __bool__(self) -> bool:
        return self.exit_code == APPLIED

    def __repr__(self) -> str:
        return f"Outcome({self.line!r})"

    def _with(self, code: Code) -> tuple[str, ...]:
        return tuple(sorted(name for name, reply in self.replies.items() if reply.code is code))


def joined(outcomes: Iterable[Outcome], unlabelled: tuple[str, ...] = ()) -> Outcome:
    """One outcome of requests to different robots."""
    parts = list(outcomes)
    return Outcome(
        replies={name: reply for outcome in parts for name, reply in outcome.replies.items()},
        missing=tuple(sorted({name for outcome in parts for name in outcome.missing})),
        warnings=tuple(line for outcome in parts for line in outcome.warnings),
        seconds=sum(outcome.seconds for outcome in parts),
        duplicates=tuple(sorted({name for outcome in parts for name in outcome.duplicates})),
        reached=sum(outcome.reached for outcome in parts),
        unlisted=tuple(sorted({name for outcome in parts for name in outcome.unlisted})),
        unlabelled=unlabelled,
    )


class Acks:
    """Collects the replies to one request; acks of a stop count as replies.

    Two daemons may have the same robot id; the instances in their replies differ. The worse reply
    counts, and the id is among the outcome's `duplicates`. A robot that acked a stop counts as
    failed until an ack says that its base rests.
    """

    def __init__(self, request_id: str) -> None:
        self._request_id = request_id
        self._replies: dict[str, dict[str, Reply]] = {}  # the replies by robot, then by instance
        # Robot and instance of each ack "at rest" that came directly. An ack is "at rest" unless
        # `is_moving` says that the base moves.
        self._direct_at_rest: set[tuple[str, str]] = set()

    def on_reply(self, robot: str, reply: Reply) -> bool:
        """Take a reply that came on `robot`'s key; False if the reply is not kept."""
        if reply.robot != robot or reply.id != self._request_id:
            return False
        if robot not in self._replies and len(self._replies) >= MAX_ROBOTS:
            return False
        instances = self._replies.setdefault(robot, {})
        instance = reply.epoch.instance if reply.epoch is not None else ""
        if instance not in instances and len(instances) >= MAX_INSTANCES:
            return False
        instances[instance] = reply
        return True

    def on_ack(self, ack: Ack) -> bool:
        """Take the ack of a stop, as the reply of its robot; False if the ack is not kept.

        `ack.via`: the robot that has handed the ack on; empty if the ack came directly. Not kept
        are an ack of another request, and an ack that tells nothing new (`_is_outdated`).
        """
        if ack.id != self._request_id or self._is_outdated(ack):
            return False
        is_taken = self.on_reply(ack.robot, _reply_of(ack))
        if is_taken and not (ack.via or ack.is_moving):
            self._direct_at_rest.add((ack.robot, ack.instance.hex()))
        return is_taken

    def _is_outdated(self, ack: Ack) -> bool:
        """True if an earlier ack of the same instance tells more than `ack`."""
        instance = ack.instance.hex()
        # The ack "moving" was sent before the ack "at rest", and was longer on its way.
        earlier = self._replies.get(ack.robot, {}).get(instance)
        if ack.is_moving and earlier is not None and not earlier.is_moving:
            return True
        # A direct ack "at rest" needs no word of another robot.
        return bool(ack.via) and (ack.robot, instance) in self._direct_at_rest

    def has_reply(self, robot: str) -> bool:
        """True if a reply of the robot has come, from any instance."""
        return bool(self._replies.get(robot))

    def lacks(self, robot: str, instances: Collection[str]) -> bool:
        """True if no reply of the robot has come, or if one of several `instances` sent none."""
        answered = self._replies.get(robot, {}).keys()
        return not answered or (len(instances) > 1 and not set(instances) <= answered)

    def is_moving(self, robot: str) -> bool:
        """True if the robot was stopped and is not known to rest."""
        return any(reply.is_moving for reply in self._replies.get(robot, {}).values())

    def forget_ended(self, robot: str, instances: Collection[str]) -> None:
        """Drop the "still moves" acks of ended daemons, once one of `instances` has answered.

        `instances`: the living instances of the robot.
        """
        replies = self._replies.get(robot, {})
        if not replies.keys().isdisjoint(instances):
            for instance in replies.keys() - set(instances):
                if replies[instance].is_moving:
                    del replies[instance]

    def missing(self, expected: Iterable[str]) -> tuple[str, ...]:
        """The names in `expected` without a reply, sorted."""
        return tuple(sorted(set(expected) - self._replies.keys()))

    def outcome(
        self,
        expected: Iterable[str],
        *,
        silent: Collection[str] = (),
        seconds: float = 0.0,
        reached: int = 0,
        unlisted: tuple[str, ...] = (),
    ) -> Outcome:
        """The outcome of the request so far.

        `expected`: the robots that must reply; without a reply they count as missing. A robot that
        replied without being expected counts as targeted. `silent`: robots that count as missing in
        any case, such as an id of two daemons of which only one has replied. `seconds`: the
        duration of the request. `reached`: the number of robots that were heard. `unlisted`: robots
        whose member list did not come.
        """
        worst_replies: dict[str, Reply] = {}
        for robot in sorted(self._replies.keys() - set(silent)):
            # Of the instances that replied for one robot id, the most severe reply counts. The
            # reply of a base that still moves counts as failed.
            replies = [_settled(reply) for reply in self._replies[robot].values()]
            worst_replies[robot] = max(replies, key=lambda reply: _SEVERITY[reply.code])
        # Replies of two instances with one robot id come from two daemons.
        duplicates = sorted(robot for robot, replies in self._replies.items() if len(replies) > 1)
        return Outcome(
            replies=worst_replies,
            missing=tuple(sorted({*self.missing(expected), *silent})),
            seconds=seconds,
            reached=reached,
            unlisted=unlisted,
            duplicates=tuple(duplicates),
        )


def _reply_of(ack: Ack) -> Reply:
    """The reply to a stop that an ack contains.

    A later version may send codes and refusals that are unknown here. An unknown code becomes
    REFUSED. Every code but APPLIED comes with a refusal: an unknown refusal becomes OTHER_VERSION.
    """
    text = f"{ack.text} (by {ack.via}'s word)".lstrip() if ack.via else ack.text
    code = Code(ack.code) if ack.code in _CODES else Code.REFUSED
    refusal = None
    if code is not Code.APPLIED:
        refusal = _REFUSALS.get(ack.refusal or "", Refusal.OTHER_VERSION)
    return Reply(
        id=ack.id,
        robot=ack.robot,
        code=code,
        refusal=refusal,
        text=text[:1000],  # the bound of `Reply.text`
        epoch=Epoch(ack.instance.hex(), ack.revision),
        is_moving=ack.is_moving,
    )


def _settled(reply: Reply) -> Reply:
    """The reply as it counts at the end: a base that still moves has failed to stop."""
    if not reply.is_moving:
        return reply
    return replace(reply, code=Code.FAILED, refusal=Refusal.NOT_STOPPED, is_moving=False)
