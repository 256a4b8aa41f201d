"""The conditions that an operator waits for, and the robots that do not meet them. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from swarmd.core.errors import ConfigError, unknown
from swarmd.core.keys import is_id
from swarmd.core.messages import Presence, State
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember
from swarmd.operator.texts.values import counted
from swarmd.operator.texts.why import absence
from swarmd.operator.verbs.goal.words import differences

ALIVE = 0
"""The `count` of `count=alive`."""
KINDS = ("state", "pattern", "presence", "goal", "count")
_VALUES = {
    "state": tuple(state.value for state in State),
    "presence": tuple(presence.value for presence in Presence),
}


@dataclass(frozen=True, slots=True)
class Awaited:
    """The conditions of a wait; None or False: no condition."""

    state: str | None = None
    pattern: str | None = None
    presence: str | None = None
    goal: bool = False
    count: int | None = None
    """Robots that must meet the conditions. None: all; ALIVE: all that are alive, at least one."""


def read_awaited(words: Iterable[str], option: str = "--for") -> Awaited:
    """Read the conditions of a wait, such as `state=running`, `goal` and `count=5`.

    `words`: the conditions; each is `goal`, without a value, or KIND=VALUE with a kind of KINDS.
    `option`: the option of the command line, for messages. ConfigError for a wrong or repeated
    condition.
    """
    values: dict[str, str] = {}
    for word in words:
        kind, equals_sign, value = word.partition("=")
        if kind not in KINDS:
            raise ConfigError(f"{option} {word}: {unknown('condition', kind, KINDS)}")
        if kind in values:
            raise ConfigError(f"{option} {word}: {kind} is there already; keep one")
        needs_value = kind != "goal"
        if bool(equals_sign) != needs_value:
            expected = "goal, without a value" if kind == "goal" else f"{kind}=VALUE"
            raise ConfigError(f"{option} {word}: expected {expected}")
        if kind in _VALUES and value not in _VALUES[kind]:
            raise ConfigError(f"{option} {word}: {unknown(kind, value, _VALUES[kind])}")
        if kind == "pattern" and not is_id(value):
            raise ConfigError(f"{option} {word}: {value!r} is no pattern name")
        if kind == "count" and value != "alive" and not (value.isdecimal() and int(value) > 0):
            text = "expected a number of robots, such as count=5, or count=alive"
            raise ConfigError(f"{option} {word}: {text}")
        values[kind] = value
    count = values.get("count")
    return Awaited(
        state=values.get("state"),
        pattern=values.get("pattern"),
        presence=values.get("presence"),
        goal="goal" in values,
        count=None if count is None else ALIVE if count == "alive" else int(count),
    )


def meeting(view: MembersView, names: Iterable[str], awaited: Awaited) -> tuple[str, ...]:
    """The robots in `names` that meet the conditions; with `count` only robots that are alive."""
    is_met = {name: not _unmet_by(view, name, view.members.get(name), awaited) for name in names}
    return tuple(name for name, met in is_met.items() if met)


def unmet(view: MembersView, names: Iterable[str], awaited: Awaited) -> dict[str, str]:
    """The robots in `names` that do not meet the conditions, each with its present state in words.

    If `awaited` has a `count`, the result is empty once `count` robots meet the conditions. Before
    that, an entry with an empty name comes first: it says how many robots meet the conditions, such
    as "2 of 5 robots".
    """
    names = tuple(names)
    texts = {name: _unmet_by(view, name, view.members.get(name), awaited) for name in names}
    lacking = {name: text for name, text in texts.items() if text}
    if awaited.count is None:
        return lacking if names else {"": "there is no robot"}
    count = len(names) - len(lacking)
    wanted = awaited.count or max(len({*view.alive} & {*names}), 1)
    if count >= wanted:
        return {}
    return {"": f"{count} of {counted(wanted, 'robot')}", **lacking}


def _unmet_by(view: MembersView, name: str, member: SeenMember | None, awaited: Awaited) -> str:
    """The present state of a robot that does not meet the conditions; empty if the robot does."""
    if member is None:
        return absence(None)
    status = member.status if member.contact is Contact.ANSWERED else None
    wanted = awaited.presence
    if wanted is not None and member.presence != wanted:
        return f"is {member.presence}"
    needs_status = awaited.state or awaited.pattern or awaited.goal
    if status is None:
        is_counted = awaited.count is None or member.presence is Presence.ALIVE
        return "" if not needs_status and wanted and is_counted else absence(member)
    if awaited.state is not None and status.state != awaited.state:
        reason = f" ({status.reason})" if status.reason else ""
        return f"is {status.state}{reason}"
    if awaited.pattern is not None and status.pattern != awaited.pattern:
        return f"runs {status.pattern or 'no pattern'}"
    if awaited.goal:
        return differences(view, [name])[0].reason
    return ""
