"""What every bus goes by, whatever carries it: sizes, names, and what a view says of a member."""

from __future__ import annotations

from swarmd.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSE
from swarmd.keys import ANY
from swarmd.messages import Condition, Member

_LIMITS = {"msg": MAX_MESSAGE, "sense": MAX_SENSE, "hw": MAX_SENSE}


def limit_of(plane: str) -> int:
    """The most bytes that are read from a sample of this plane."""
    return _LIMITS.get(plane, MAX_CONTROL)


def matches(name: str, wanted: str) -> bool:
    """True if each chunk of `name` is that of `wanted`, or `*` stands there."""
    chunks, wants = name.split("/"), wanted.split("/")
    return len(chunks) == len(wants) and all(
        want in (ANY, chunk) for chunk, want in zip(chunks, wants, strict=True)
    )


def brief(member: Member) -> Member:
    """A member as a view tells of it: living ones answer for themselves, without a status here."""
    if member.condition is not Condition.ALIVE:
        return member
    return Member(
        robot=member.robot,
        instance=member.instance,
        condition=member.condition,
        age=member.age,
    )
