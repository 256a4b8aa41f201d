"""The outcome of a request: the targeted robots, their replies, and the exit code. Pure.

An empty list of acks is never success. The exit codes of swarmctl:

====  ==========================================================================
0     every targeted robot applied it
1     every one failed
2     usage: nothing was sent, or every robot refused the request as a mistake in it
3     partial: some applied it and some did not, or refusals, failures and no answers mixed
4     no robot was targeted
5     no robot answered in time
6     no daemon could be reached (decided before anything is sent)
7     every one refused
====  ==========================================================================
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

from swarmd.core.messages import Code, Member, Presence, Refusal, Reply

# Refusals that the operator corrects by writing another command line.
MISTAKES = frozenset(
    {
        Refusal.INVALID_REQUEST,
        Refusal.UNKNOWN_PATTERN,
        Refusal.INVALID_PARAMETER,
        Refusal.INVALID_CONDITION,
    }
)
APPLIED, FAILED, USAGE, PARTIAL, NO_TARGET, TIMEOUT, UNREACHABLE, REFUSED = range(8)
# A robot that failed this recently counts as targeted by `--all`, in s.
RECENT_FAILURE = 60.0

_SEVERITY = {Code.APPLIED: 0, Code.REFUSED: 1, Code.FAILED: 2}


@dataclass(frozen=True, slots=True)
class Expected:
    """The robots that a request is for: it is sent to `asked`; `absent` cannot answer.

    `warnings` are lines for the operator about robots that are not counted.
    """

    asked: tuple[str, ...]
    absent: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Outcome:
    """The replies to a request by robot, and the robots that did not answer (`missing`)."""

    replies: Mapping[str, Reply]
    missing: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    duplicates: tuple[str, ...] = ()

    @property
    def targeted(self) -> int:
        """The number of robots that the request was for."""
        return len(self.replies) + len(self.missing)

    @property
    def applied(self) -> tuple[str, ...]:
        """The robots that applied it."""
        return self._with(Code.APPLIED)

    @property
    def refused(self) -> tuple[str, ...]:
        """The robots that refused it."""
        return self._with(Code.REFUSED)

    @property
    def failed(self) -> tuple[str, ...]:
        """The robots that failed to apply it."""
        return self._with(Code.FAILED)

    @property
    def line(self) -> str:
        """Such as `7 targeted, 6 applied, 1 no answer (tb3-03)`."""
        parts = [f"{self.targeted} targeted", f"{len(self.applied)} applied"]
        others = {"refused": self.refused, "failed": self.failed, "no answer": self.missing}
        parts += [
            f"{len(some)} {what} ({', '.join(some)})" for what, some in others.items() if some
        ]
        return ", ".join(parts)

    @property
    def mistake(self) -> str:
        """The text with which every robot refused the same mistake of the operator; else empty.

        Only the robots know which patterns they have, and which parameters those take.
        """
        replies = self.replies.values()
        texts = {reply.text for reply in replies}
        is_mistake = all(reply.refusal in MISTAKES for reply in replies)
        if self.targeted and len(self.refused) == self.targeted and is_mistake and len(texts) == 1:
            return texts.pop()
        return ""

    @property
    def exit_code(self) -> int:
        """The exit code of swarmctl for this outcome."""
        if not self.targeted:
            return NO_TARGET
        if self.mistake:
            return USAGE
        counts = {
            APPLIED: len(self.applied),
            REFUSED: len(self.refused),
            FAILED: len(self.failed),
            TIMEOUT: len(self.missing),
        }
        return next((code for code, n in counts.items() if n == self.targeted), PARTIAL)

    def _with(self, code: Code) -> tuple[str, ...]:
        return tuple(sorted(name for name, reply in self.replies.items() if reply.code is code))


class Acks:
    """Collects the replies to one request.

    Two replies of one robot come from two daemons that hold one id. The worse one counts, and the
    name is among the outcome's `duplicates`.
    """

    def __init__(self, request_id: str) -> None:
        self._request_id = request_id
        self._replies: dict[str, dict[str, Reply]] = {}

    def on_reply(self, robot: str, reply: Reply) -> bool:
        """Take a reply that came on `robot`'s key; False if it answers another request."""
        if reply.robot != robot or reply.id != self._request_id:
            return False
        instance = reply.epoch.instance if reply.epoch is not None else ""
        self._replies.setdefault(robot, {})[instance] = reply
        return True

    def lacks(self, robot: str, instances: Collection[str]) -> bool:
        """True unless the robot answered; if it has several instances, unless each did."""
        answered = self._replies.get(robot, {}).keys()
        return not answered or (len(instances) > 1 and not set(instances) <= answered)

    def missing(self, expected: Iterable[str]) -> tuple[str, ...]:
        """The names in `expected` without a reply, sorted."""
        return tuple(sorted(set(expected) - self._replies.keys()))

    def outcome(
        self,
        expected: Iterable[str],
        *,
        silent: Collection[str] = (),
        warnings: tuple[str, ...] = (),
        seconds: float = 0.0,
    ) -> Outcome:
        """The outcome; a robot that answered without being expected counts as targeted.

        Those in `silent` count as missing even if one of their instances has answered.
        """
        answered = sorted(self._replies.keys() - set(silent))
        worst = {
            name: max(self._replies[name].values(), key=lambda reply: _SEVERITY[reply.code])
            for name in answered
        }
        return Outcome(
            replies=worst,
            missing=tuple(sorted({*self.missing(expected), *silent})),
            warnings=warnings,
            seconds=seconds,
            duplicates=tuple(sorted(name for name, all_ in self._replies.items() if len(all_) > 1)),
        )


def expected_to_run(
    members: Mapping[str, Member], roster: Collection[str], selected: Collection[str]
) -> Expected:
    """The robots that `run`, `reset` and `param` are for, of those that the operator `selected`.

    Robots that are alive are asked. A robot that failed within the last minute, or that the
    roster names, is absent, so that the outcome is partial. Other failed robots cause a warning.
    Robots that left do not count unless the roster names them.
    """
    asked, absent, warnings = [], [], []
    for name in sorted(set(selected)):
        member = members.get(name)
        presence = member.presence if member is not None else None
        has_failed = presence is Presence.FAILED
        if presence is Presence.ALIVE:
            asked.append(name)
        elif name in roster or (member and has_failed and member.age <= RECENT_FAILURE):
            absent.append(name)
        elif member and has_failed:
            warnings.append(
                f"{name} failed {member.age:.0f} s ago and is not counted;"
                f" `swarmctl members forget {name}` removes it"
            )
    return Expected(tuple(asked), tuple(absent), tuple(warnings))


def expected_to_stop(
    members: Mapping[str, Member], roster: Collection[str], selected: Collection[str]
) -> frozenset[str]:
    """The robots that must ack a stop or estop, of those `selected`: all but those that left.

    Failed robots count, and so does the whole roster: a robot that cannot be reached may move.
    """
    return frozenset(
        name
        for name in selected
        if name in roster or (name in members and members[name].presence is not Presence.LEFT)
    )
