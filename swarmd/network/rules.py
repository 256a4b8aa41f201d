"""What every bus goes by, whatever carries it: sizes, names, and what a view says of a member."""

from __future__ import annotations

from swarmd.codec import MAX_CONTROL, MAX_MESSAGE, MAX_SENSE
from swarmd.keys import ANY
from swarmd.messages import Condition, Member
from swarmd.network.membership import Membership

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


def members_to_tell(membership: Membership, now: float) -> tuple[Member, ...]:
    """All members as a view tells of them: each living instance, which answers for itself."""
    told = [_brief(member) for member in membership.members(now).values()]
    for robot, instances in membership.duplicates.items():
        told += [_alive(robot, instance) for instance in instances]
    once = {(member.robot, member.instance): member for member in reversed(told)}
    return tuple(once[key] for key in sorted(once))


def _brief(member: Member) -> Member:
    if member.condition is not Condition.ALIVE:
        return member
    return _alive(member.robot, member.instance, member.age)


def _alive(robot: str, instance: str, age: float = 0.0) -> Member:
    return Member(robot=robot, instance=instance, condition=Condition.ALIVE, age=age)
