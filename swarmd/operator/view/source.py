"""The interface between a page and its data: robots, poses, and a row of values for each robot."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from swarmd.core.messages import LimitingObstacle, Reason, Status
from swarmd.core.values import Array, Platform
from swarmd.operator.texts.values import printable, seconds
from swarmd.operator.texts.why import DRIVEN, lost_base, protection_word_of, standing_of
from swarmd.operator.view.playback import Playback

FRAME = 1
SCAN = 2
"""Kinds of binary messages to the page."""
STOPS = ("stop", "estop", "end_estop")
"""Commands that are carried out however late they come."""
DETAIL_KEYS = frozenset({"requested", "safe", "rows", "limits", "tracks"})
"""Keys of rows that only the details of a selected robot show."""
PLACE = np.dtype([("index", "<u4"), ("x", "<f4"), ("y", "<f4"), ("yaw", "<f4")])


@dataclass(frozen=True, slots=True)
class ShownRobot:
    """A robot on the page: its `index` in frames, and its footprint (k, 2) in m."""

    name: str
    index: int
    platform: str
    footprint: Array

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "name": self.name,
            "index": self.index,
            "platform": self.platform,
            "footprint": self.footprint.tolist(),
        }


@dataclass(frozen=True, slots=True)
class ShownArena:
    """The walls, fixed objects and scalar fields of an arena."""

    size: tuple[float, float]  # m
    shapes: Sequence[Array] = ()  # corners (k, 2) in m of fixed boxes
    poles: Sequence[tuple[float, float, float]] = ()  # x, y, radius in m
    fields: Mapping[str, Array] = field(default_factory=dict)
    """Scalar fields by name: values (rows, columns) at the centres of equal cells that cover the
    arena; the first row has the lowest y."""
    floor: str = ""  # a picture of the floor as a data URL

    def plain(self) -> dict[str, Any]:
        """As JSON."""
        return {
            "size": self.size,
            "shapes": [shape.tolist() for shape in self.shapes],
            "poles": [list(pole) for pole in self.poles],
            "fields": {name: values.round(4).tolist() for name, values in self.fields.items()},
            "floor": self.floor,
        }


@dataclass(slots=True)
class CommandProgress:
    """The answers to a command so far."""

    line: str  # the count
    replies: list[tuple[str, str, str]] = field(default_factory=list)  # robot, code, text
    missing: list[str] = field(default_factory=list)  # robots that have not answered
    is_good: bool = False
    is_final: bool = False


class Source(Protocol):
    """The interface for the data of a page: a living swarm, a simulated world, or recordings.

    All methods run on the server's event loop.
    """

    kind: str
    """`live`, `world`, `run` or `recording`."""
    swarm: str
    patterns: Sequence[str]

    @property
    def descriptions(self) -> Mapping[str, Mapping[str, Any]]:
        """By pattern, if known: `summary`, `params`, `report_units` of `patterns show -o json`."""

    @property
    def arena(self) -> ShownArena | None:
        """The walls; None where they are not known."""

    @property
    def playback(self) -> Playback | None:
        """The playback of recorded runs; None for a living swarm."""

    @property
    def programs(self) -> Sequence[str]:
        """The Zenoh programs that robots see, sorted."""

    @property
    def link(self) -> float | None:
        """The distance in m within which two robots are in one cluster; None: no shared frame."""

    @property
    def revision(self) -> int:
        """A number that changes when the robots, the arena or the run have changed."""

    @property
    def robots(self) -> Sequence[ShownRobot]:
        """All robots by index. Robots may be added; an index keeps its robot within a run."""

    def frame(self) -> tuple[float, Array]:
        """The time in s, and rows (k, 4) of index, x, y in m and yaw in rad of known robots."""

    def rows(self) -> Mapping[str, Mapping[str, Any]]:
        """The values of each robot in the list."""

    def scan(self, name: str) -> Array | None:
        """Points (k, 2) of a robot's latest scan in its base frame in m; None: not known."""

    def boxes(self) -> Sequence[tuple[Array, Sequence[float]]]:
        """Corners (k, 2) in m of movable boxes in their own frames, and their poses."""

    def links(self) -> Sequence[tuple[int, int]]:
        """Pairs of indices of robots that hear each other."""

    def marks(self) -> Sequence[tuple[float, str, Sequence[str]]]:
        """Events in the order of time: time in s, text, and robots.

        The time is that of the run, or of the machine's monotonic clock for a living swarm.
        """

    def detail(self, name: str) -> Mapping[str, Any] | None:
        """The details of the robot `name`, as JSON; None if nothing is known.

        `sections`: a list of (title, pairs of name and text). `values`: pairs of name and text
        outside any section. `events`: pairs of age and text. `why`: one sentence. Each key may be
        missing.
        """

    def select(self, names: Sequence[str]) -> None:
        """Set the robots whose scans and details pages want."""


@runtime_checkable
class Measured(Protocol):
    """A source whose figures programs can scrape: a living swarm."""

    def metrics(self) -> str:
        """The figures, in the text exposition format."""


def link_of(platforms: Iterable[Platform]) -> float | None:
    """The distance in m within which robots count as linked, as in the metrics of experiments.

    Twice the largest `threshold` of the platforms (the distance up to which the potential field
    reacts to obstacles); None if no platform has a threshold.
    """
    thresholds = (platform.protection.get("threshold", 0.0) for platform in platforms)
    return 2.0 * max(thresholds, default=0.0) or None


def hello_of(source: Source, role: str) -> dict[str, Any]:
    """The message `hello`, the first to a page or to the player of a report."""
    playback = source.playback
    return {
        "swarm": source.swarm,
        "source": source.kind,
        "role": role,
        "robots": [robot.plain() for robot in source.robots],
        "arena": None if source.arena is None else source.arena.plain(),
        "patterns": [{**source.descriptions.get(p, {}), "name": p} for p in source.patterns],
        "report_units": {
            name: described["report_units"]
            for name, described in source.descriptions.items()
            if described.get("report_units")
        },
        "runs": [] if playback is None else list(playback.runs),
        "playback": None if playback is None else playback.plain(),
    }


def pack_frame(sequence: int, time: float, places: Array) -> bytes:
    """A frame in the binary form that the page reads."""
    head = struct.pack("<IIdI", FRAME, sequence & 0xFFFFFFFF, time, len(places))
    body = np.empty(len(places), dtype=PLACE)
    for name, column in zip(PLACE.names or (), places.T, strict=True):
        body[name] = column
    return head + body.tobytes()


def pack_scan(index: int, points: Array) -> bytes:
    """A scan in the binary form that the page reads."""
    return struct.pack("<III", SCAN, index, len(points)) + points.astype("<f4").tobytes()


def points_of(ranges: Array, bearings: Array, offset: tuple[float, float]) -> Array:
    """The returns (k, 2) of a scan in the base frame in m; `offset`: of the sensor in the base."""
    is_return = np.isfinite(ranges) & (ranges > 0.0)  # drivers mark rays without return by 0
    ranges = ranges[is_return]
    bearings = bearings[is_return]
    return np.stack(
        (offset[0] + ranges * np.cos(bearings), offset[1] + ranges * np.sin(bearings)), axis=1
    )


def row_of(status: Status) -> dict[str, Any]:
    """The values of a status that pages show of a robot, as JSON.

    - `why`: the reason in words why the robot does not move. `stands`: `at rest` if the
      pattern wants so, `held` if the robot may not move; empty if it moves or does not run.
      `driven` if an operator, `driven_by`, drives it by hand.
    - `lost`: why the base takes no commands, empty if the base takes commands.
    - `requested`, `safe`: commands: linear (m/s), angular (rad/s), lateral (m/s).
    - `rows`: the nearest obstacles, each with bearing (rad), gap (m) and the highest speed (m/s)
      towards the obstacle that protection permits.
    - `near`: the least gap in m. `battery`: the charge. Both only if known.
    - `fence`, only with a fence: the corners of the polygons in m, the outer polygon first.
    """
    decision = status.decision
    protection = protection_word_of(decision)
    row: dict[str, Any] = {
        "presence": "alive",
        "state": status.state.value,
        "why": _reason(status),
        "stands": DRIVEN if status.driven_by else standing_of(status.state, status.reason or ""),
        "driven_by": status.driven_by,
        "lost": lost_base(status),
        "pattern": status.pattern or "",
        "protection": protection if status.state == "running" else "",
        "report": dict(status.report),
        "readings": dict(status.readings),
        "requested": [
            decision.requested_linear,
            decision.requested_angular,
            decision.requested_lateral,
        ],
        "safe": [decision.safe_linear, decision.safe_angular, decision.safe_lateral],
        "rows": limits_of(decision.rows),
    }
    if decision.min_gap is not None:
        row["near"] = decision.min_gap
    if (battery := status.readings.get("battery")) is not None:
        row["battery"] = battery
    if status.fence is not None:
        row["fence"] = status.fence.polygons
    return row


def limits_of(rows: Iterable[LimitingObstacle]) -> list[list[float]]:
    """Bearing (rad), gap (m) and cap (m/s) of each limiting obstacle."""
    return [[obstacle.bearing, obstacle.gap, obstacle.cap] for obstacle in rows]


_WORDS = {
    Reason.NEVER_ASKED: "not run yet",
    Reason.OPERATOR: "stopped",
    Reason.ESTOP: "emergency stop",
    Reason.PROTECTION: "protection holds it",
}
"""Reasons that have other words on the page than their names."""


def _reason(status: Status) -> str:
    """Why a robot does not move, in words; empty while it moves."""
    name = "" if status.reason is None else status.reason.value.replace("_", " ")
    reason = _WORDS.get(status.reason, name) if status.reason else ""
    lost = lost_base(status) if status.reason is not Reason.DRIVER_LOST else ""
    avoiding = status.decision.avoiding if status.reason is Reason.PROTECTION else ""
    held = "" if status.held_for is None else f"for {seconds(status.held_for)} with free floor"
    parts = (reason, avoiding, held, status.detail, f"base lost ({lost})" if lost else "")
    return printable(": ".join(filter(None, parts)).replace(": by ", " by "))


def json_of(value: Any) -> str:
    """JSON with null for NaN and infinity, which browsers refuse."""
    try:
        return json.dumps(value, separators=(",", ":"), allow_nan=False)
    except ValueError:
        return json.dumps(_finite(value), separators=(",", ":"))


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
