"""The statuses with which robots answered an operator, by robot and instance. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, KeysView, Mapping

from msgspec import Struct

from swarmd.core.messages import Member, Presence, Status, StatusHeader
from swarmd.link.members.membership import MAX_INSTANCES


class StatusAnswer(Struct, frozen=True):
    """The answer of a robot to a query of its status."""

    status: Status | StatusHeader  # a header from a robot of another version
    members: tuple[Member, ...]  # the members as the robot sees them
    at: float  # when the status came, in s


class StatusTable:
    """The newest answer of each instance."""

    def __init__(self) -> None:
        self._answers: dict[str, dict[str, StatusAnswer]] = {}

    def add(self, robot: str, answer: StatusAnswer) -> bool:
        """Keep an answer; True if it is the first answer of its instance."""
        known = self._answers.setdefault(robot, {})
        instance = answer.status.instance
        is_new = instance not in known
        if not is_new or len(known) < MAX_INSTANCES:
            known[instance] = answer
            return is_new
        return False

    def drop(self, robot: str, instance: str) -> None:
        """Drop the answer of an instance that left."""
        self._answers.get(robot, {}).pop(instance, None)

    @property
    def robots(self) -> KeysView[str]:
        """The robots of which an instance has answered, whether or not that instance left."""
        return self._answers.keys()

    def instances(self, robot: str) -> Mapping[str, StatusAnswer]:
        """The answers of the instances of a robot that did not leave."""
        return self._answers.get(robot, {})

    def newest(self, robot: str, living: Collection[str]) -> StatusAnswer | None:
        """The newest answer of a robot; only of instances in `living`, unless that is empty."""
        answers = self.instances(robot).values()
        counted = [answer for answer in answers if not living or answer.status.instance in living]
        return max(counted, key=lambda answer: answer.at, default=None)

    def statuses(self) -> Iterator[tuple[str, Status, tuple[Member, ...]]]:
        """The robot, the status and the members of each answer of this version."""
        for robot, answers in self._answers.items():
            for answer in answers.values():
                if isinstance(answer.status, Status):
                    yield robot, answer.status, answer.members

    def agree(self, robots: Collection[str]) -> bool:
        """True if at least two robots answered, and each lists all of `robots` as alive."""
        views = [(robot, members) for robot, _, members in self.statuses()]
        if len(robots) < 2 or len(views) < 2:
            return False
        return all(
            set(robots)
            <= {robot} | {member.robot for member in members if member.presence is Presence.ALIVE}
            for robot, members in views
        )
