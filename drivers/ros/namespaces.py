"""Finds announced topics that may be this robot's under another name. Pure.

`diagnosis.py` proposes these topics to the user. A topic of another robot must not be proposed: the
user would drive that robot. If the option `namespace` is set, every other namespace belongs to
another robot. Without the option, a namespace belongs to another robot if it has a scan, odometry
or base of which this robot already has its own: a robot has one topic of each of these kinds.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from swarmd.drivers.ros.endpoints import Endpoint
from swarmd.drivers.ros.options import TopicOptions

_KINDS = {
    (True, "LaserScan"): "scan",
    (True, "Range"): "scan",
    (True, "Odometry"): "odometry",
    (False, "Twist"): "cmd_vel",
    (False, "TwistStamped"): "cmd_vel",
}
_WHOLE = 2  # of the kinds scan, odometry and cmd_vel: a namespace with so many is a robot's


@dataclass(frozen=True, slots=True)
class Candidates:
    """Proposals for a missing topic; both empty: no proposal."""

    topics: tuple[str, ...] = ()  # topics that may be the missing one
    namespaces: tuple[str, ...] = ()  # namespaces in use, of which the user must name the robot's


class Namespaces:
    """The namespaces of endpoints, and what is published in each.

    `heard`: this robot's topics that carried messages.
    """

    def __init__(
        self, options: TopicOptions, ends: Iterable[Endpoint], heard: Collection[str] = ()
    ) -> None:
        """Endpoints of one domain."""
        named = dict.fromkeys(options.ranges, "scan")
        named[options.scan_topic] = "scan"
        named |= {options.odometry: "odometry", options.cmd_vel: "cmd_vel"}
        self._names = [name.strip("/") for name in named]
        self.own = options.topic("_")[:-2]  # the namespace, before the slash of any topic
        self._kinds = defaultdict[str, set[str]](set)
        own = {options.topic(name): kind for name, kind in named.items()}
        self._own_kinds = {kind for topic, kind in own.items() if topic in heard}
        self._is_there = bool(self._own_kinds)
        for end in ends:
            self._is_there |= end.topic.startswith(f"{self.own}/")
            kind = _KINDS.get((end.is_publisher, end.type.rpartition("/")[2]))
            if kind is not None and own.get(end.topic) == kind:
                self._own_kinds.add(kind)
            elif kind is not None:
                self._kinds[self.of(end.topic)].add(kind)

    def of(self, topic: str) -> str:
        """The namespace of a topic, such as `/tb3_01` of `/tb3_01/scan`; empty for the root."""
        for name in self._names:
            if topic.endswith(f"/{name}"):
                return topic[: -len(name) - 1]
        return topic.rpartition("/")[0]

    def is_of_another_robot(self, topic: str) -> bool:
        """True if a topic belongs to another robot, or may belong to one."""
        space = self.of(topic)
        if self.own:
            return not f"{space}/".startswith(f"{self.own}/")
        return bool(space and self._kinds[space] & self._own_kinds)

    def candidates(self, alike: Collection[str]) -> Candidates:
        """The proposals for a missing topic; `alike`: the announced topics with its type.

        1. With the option `namespace`: the topics of `alike` in this namespace. While no topic of
           the namespace is announced, the option may be wrong: all announced namespaces, too.
        2. Without the option: the topics of `alike` that may be this robot's. If they are in
           several namespaces, or several whole robots are announced, the user has to choose the
           robot: the proposals are the namespaces then, without topics.
        """
        topics = tuple(topic for topic in alike if not self.is_of_another_robot(topic))
        if self.own:
            spaces_in_use = () if self._is_there else self._kinds
            return Candidates(topics, tuple(sorted(space or "/" for space in spaces_in_use)))
        # Namespaces that hold a whole robot, which may be this robot: its own names have no kind
        # of these topics.
        robots = {
            space
            for space, kinds in self._kinds.items()
            if space and len(kinds) >= _WHOLE and not kinds & self._own_kinds
        }
        spaces = {self.of(topic) for topic in topics} - {""}
        if spaces and (len(robots) > 1 or len(spaces) > 1):
            return Candidates((), tuple(sorted(robots | spaces)))
        return Candidates(topics)
