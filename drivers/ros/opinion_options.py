"""The option `opinions`: opinions of voting patterns as topics, in both directions."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from typing import Annotated, Any

from msgspec import Meta, Struct
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from swarmd.drivers.ros.cdr import STORE
from swarmd.drivers.ros.topic_readings import Text

PUBLISHED = "swarmd/opinion"
"""The topic of the own opinion, of type std_msgs/Int32."""
MAX_ROBOTS = 64

_BROADCAST = "communication_interfaces/msg/OpinionMessage"
_BROADCAST_FIELDS = "int64 id\nint64 opinion\n"
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,49}")
_TOPIC = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")
Number = Annotated[int, Meta(ge=0, lt=2**31)]


class OpinionOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The opinions that this robot publishes and hears.

    - `publish`: publish the own opinion on `swarmd/opinion`, a std_msgs/Int32.
    - `robots`: the namespaces of the other robots.
    - `topic`: the topic, a std_msgs/Int32, by which each of these robots publishes its opinion; a
      name in the namespace of the robot.
    - `broadcast`: one topic for all robots, as in ROS2swarm: `OpinionMessage` with `id` and
      `opinion`. The own opinion is published there, too, if `publish` is set.
    - `ids`: the ids of the robots that `broadcast` hears.
    - `unknown`: also hear robots that `robots` and `ids` do not name.
    """

    publish: bool = False
    topic: Text = "opinion"
    robots: Annotated[tuple[Text, ...], Meta(max_length=MAX_ROBOTS)] = ()
    broadcast: Text | None = None
    ids: Annotated[tuple[Number, ...], Meta(max_length=MAX_ROBOTS)] = ()
    unknown: bool = False

    @property
    def broadcast_topic(self) -> str | None:
        """The full name of the topic `broadcast`, which is in no namespace."""
        return None if self.broadcast is None else f"/{self.broadcast.strip('/')}"

    def faults(self) -> Iterator[str]:
        """The texts of the faults of names, except `broadcast`, which is checked as all topics."""
        if _TOPIC.fullmatch(self.topic) is None or self.topic == PUBLISHED:
            yield (
                f"opinions.topic is {self.topic!r}; expected the name of a topic in a robot's"
                f" namespace, such as opinion, and not {PUBLISHED}"
            )
        for robot in self.robots:
            if not is_namespace(robot):
                yield f"opinions.robots has {robot!r}; expected a namespace such as tb4_07"
        if self.ids and self.broadcast is None:
            yield "opinions.ids is given without opinions.broadcast; expected both"


def is_namespace(name: str) -> bool:
    """True for a name that the namespace of a robot may have."""
    return _NAME.fullmatch(name) is not None


@cache
def broadcast_type() -> type[Any]:
    """The message class of ROS2swarm's opinions; the first call takes some tens of milliseconds."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(_BROADCAST_FIELDS, _BROADCAST))
    kind: type[Any] = store.types[_BROADCAST]
    setattr(kind, STORE, store)
    return kind
