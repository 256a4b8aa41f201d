"""The names of a robot's Zenoh keys: published values, answered verbs, shared records (`keys.py`).

A daemon publishes and answers no other names: `ZenohBus` makes its publishers from `PUBLISHED` and
refuses a query handler without a row. `docs/zenoh.md` is made from these tables.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msgspec import Struct

from swarmd.core.keys import CONTROL, SHARED, STATE
from swarmd.core.messages import (
    Motion,
    ScanWire,
    ShownDecision,
    ShownMessage,
    ShownPose,
    Status,
    Tracks,
)
from swarmd.core.verbs import VERBS, LogBatch


@dataclass(frozen=True, slots=True)
class Published:
    """A value that robots publish on `state/<name>`, only while a session subscribes.

    `rate`: when and how often. `text`: the content in a few words.
    """

    name: str
    content: type[Struct]
    rate: str
    text: str


_ROWS = (
    Published("status", Status, "on each change, and at 1 Hz", "state, reason, pattern, health"),
    Published("motion", Motion, "10 Hz", "pose by odometry, requested and safe command"),
    Published("pose", ShownPose, "10 Hz", "pose in a shared frame, if the robot has one"),
    Published("decision", ShownDecision, "10 Hz", "last decision of protection"),
    Published("scan", ScanWire, "each scan, at most 10 Hz", "conditioned scan of the lidar"),
    Published(
        "tracks", Tracks, "with each scan", "objects, if the robot avoids or names its peers"
    ),
    Published(
        "message",
        ShownMessage,
        "when sent, at most 20 a second on a channel and 100 in all",
        "messages of the pattern",
    ),
    Published("log", LogBatch, "with new lines, at most 5 Hz", "lines of the log"),
)
PUBLISHED: Mapping[str, Published] = {row.name: row for row in _ROWS}
ANSWERED: Mapping[str, type[Struct]] = {"status": Status}
"""What a query of `state/<name>` gets, without a payload."""
HANDED_OVER: Mapping[str, str] = {
    "roster": "the signed roster of the swarm",
    "patterns": "the table of pushed patterns",
    "pattern": "the code of one pushed pattern",
    "incidents": "the incidents of the last minutes",
}
"""What a query of `shared/<name>/<asker>` gets, piece by piece: `link/spread/pull.py`."""
_QUERIED = {STATE: ANSWERED, CONTROL: VERBS, SHARED: HANDED_OVER}


def is_queried(plane: str, name: str) -> bool:
    """True if the tables list a query of this name."""
    return name in _QUERIED.get(plane, {})
