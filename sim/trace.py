"""Traces: the record of a run as arrays; the only input of metrics."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.files import open_regular, whole_file
from swarmd.core.messages import DecisionSummary, Status
from swarmd.core.values import Array, Platform, Scalar
from swarmd.robot.protection.decision import Decision

ARENA = -1
"""The index of walls, fixed boxes and poles in a contact."""

VERSION = 4
MAX_RATIO = 100
"""Bytes of all arrays to those of their file: a run has a ratio of 9 to 35, of robots that never
move 400. A file of others may be made to unpack to a thousand times its size."""
MAX_SPARE = 64 * 2**20
"""Bytes beyond this ratio."""
WORD = "U24"
"""The type of states, reasons and reported texts in arrays."""

_PARTS = {
    "t": "f T", "pose": "f T n 3", "safe": "f T n 3", "requested": "f T n 3",
    "state": "U T n", "reason": "U T n", "active": "b T n", "present": "b T n",
    "decided": "i T n", "evaded": "i T n", "recovering": "b T n",
    "gap": "f T n", "scan_age": "f T n", "bound": "f T n 3", "report": "f T n", "words": "U T n",
    "readings": "f T n",
    "contact_t": "f c", "contact_pair": "i c 2", "contact_speed": "f c 2",
    "box_pose": "f T m 3", "box_shapes": "f m k 2",
}  # fmt: skip
"""Kind and shape of each array, by the first word of its name in a file."""
NAMED: Mapping[str, float | str] = MappingProxyType(
    {"report": np.nan, "words": "", "readings": np.nan}
)
"""The kinds of arrays that a trace has by name, and the blank value of each kind."""
TWIST = ("linear", "angular", "lateral")
BOUND = ("bound_bearing", "bound_gap", "bound_speed")
_PER_ROBOT = ("state", "reason", "active", "recovering", "decided", "evaded", "gap", "scan_age")
_COMMON = ("t", "robot", "platform", "x", "y", "heading", "present", *TWIST)
COLUMNS = (*_COMMON, *(f"requested_{name}" for name in TWIST), *_PER_ROBOT, *BOUND)
"""The columns of a table besides `report:KEY` and `reading:KEY`, in their order."""


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """A run of n robots over T instants; `[:, i]` of every (T, n, ...) array is robot `ids[i]`.

    The fields from `requested` to `recovering` come from the robots, not from the world: they are
    None if the robots did not report them.
    """

    ids: tuple[str, ...]
    t: Array
    """(T,) s."""
    pose: Array
    """(T, n, 3) x, y in m, yaw in rad (not wrapped), world frame, ground truth; NaN after a robot
    was taken out of the arena."""
    safe: Array
    """(T, n, 3) linear, angular, lateral: the command in force at the base."""
    contact_t: Array
    """(c,) s, a row for every step of a contact."""
    contact_pair: NDArray[np.int64]
    """(c, 2) indices of robots, the second ARENA for a wall, ARENA - 1 - m for movable box m."""
    contact_speed: Array
    """(c, 2) m/s at which each surface moves towards the other surface."""
    platforms: tuple[str, ...]
    """The platform of each robot by name."""
    footprints: Mapping[str, Array]
    """The footprint (k, 2) of each platform."""
    meta: Mapping[str, Any] = field(default_factory=dict)
    """Arena, seed and so on, and `modes`: the protection mode of each platform."""
    requested: Array | None = None
    """(T, n, 3) the command of the pattern."""
    state: NDArray[np.str_] | None = None
    """(T, n) words."""
    reason: NDArray[np.str_] | None = None
    """(T, n) words."""
    active: NDArray[np.bool_] | None = None
    """(T, n) protection replaced or reduced the requested command."""
    decided: NDArray[np.int64] | None = None
    """(T, n) scans judged while running since the last sample."""
    evaded: NDArray[np.int64] | None = None
    """(T, n) those of `decided` with protection active."""
    gap: Array | None = None
    """(T, n) m from the footprint to the nearest return, NaN without a return."""
    scan_age: Array | None = None
    """(T, n) s, NaN before the first scan."""
    bound: Array | None = None
    """(T, n, 3) the tightest constraint, NaN without: its bearing in rad from the axle, its gap in
    m, and the highest speed in m/s of the outline towards it."""
    recovering: NDArray[np.bool_] | None = None
    """(T, n) protection replaced the requested command by a way around an obstacle."""
    present: NDArray[np.bool_] | None = None
    """(T, n) the robot has a daemon; None: all robots, always."""
    report: Mapping[str, Array] = field(default_factory=dict)
    """(T, n) by name: numbers that patterns reported, NaN where absent."""
    words: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)
    """(T, n) by name: texts that patterns reported, empty where absent."""
    readings: Mapping[str, Array] = field(default_factory=dict)
    """(T, n) by name: scalar sensors, NaN where absent."""
    movable_boxes: tuple[str, ...] = ()
    """The movable boxes, then the items."""
    box_pose: Array | None = None
    """(T, m, 3) poses of `movable_boxes`, NaN outside the arena."""
    box_shapes: Array | None = None
    """(m, k, 2) outlines of `movable_boxes` in their own frames."""

    @property
    def duration(self) -> float:
        """Seconds from the first instant to the last."""
        return float(self.t[-1] - self.t[0]) if len(self.t) else 0.0

    def footprint(self, robot: int) -> Array:
        """The (k, 2) footprint of robot `robot` in its base frame."""
        return self.footprints[self.platforms[robot]]

    def frame(self) -> Any:
        """A pandas DataFrame with a row for each instant and robot; see docs/figures.md.

        SwarmError if pandas is not installed.
        """
        return pandas().DataFrame(columns_of(self))

    def save(self, path: Path) -> None:
        """Write an .npz file atomically."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self)}
        head = {
            "version": VERSION,
            "ids": self.ids,
            "movable_boxes": self.movable_boxes,
            "platforms": self.platforms,
            "footprints": {name: shape.tolist() for name, shape in self.footprints.items()},
            "meta": dict(self.meta),
        }
        kept = {k: v for k, v in arrays.items() if isinstance(v, np.ndarray)}
        for kind in NAMED:
            kept |= {f"{kind}/{name}": values for name, values in arrays[kind].items()}
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial, partial.open("wb") as file:
            kept["head"] = np.array(json.dumps(head))
            np.savez_compressed(file, allow_pickle=False, **kept)
            file.flush()
            if _unpacked_size(partial) > _most_unpacked(partial):
                file.seek(0)
                np.savez(file, allow_pickle=False, **kept)


def poses_at(t: Array, poses: Array, time: float) -> Array:
    """Poses (k, 3) at `time` s, interpolated between `poses` (T, k, 3) at instants `t` (T,)."""
    last = min(int(np.searchsorted(t, time)), len(t) - 1)
    first = max(last - 1, 0)
    span = float(t[last] - t[first])
    share = min(max((time - float(t[first])) / span, 0.0), 1.0) if span > 0.0 else 1.0
    interpolated: Array = (1.0 - share) * poses[first] + share * poses[last]
    return interpolated


def patterns_of(trace: Trace) -> tuple[tuple[str, ...], NDArray[np.int16]]:
    """Names of patterns, and (T, n) the index of the pattern that each robot runs or ran last.

    The first name is the pattern that all robots run from the start; empty without such a pattern.
    Each run event of the trace adds a name.
    """
    names = [str(trace.meta.get("pattern", ""))]
    indices = np.zeros(trace.pose.shape[:2], dtype=np.int16)
    index_of = {robot: index for index, robot in enumerate(trace.ids)}
    runs = [event for event in trace.meta.get("events", ()) if event["action"] == "run"]
    for event in sorted(runs, key=lambda event: float(event["at"])):
        robots = event.get("robots") or trace.ids
        targets = [index_of[robot] for robot in robots if robot in index_of]
        first_instant = int(np.searchsorted(trace.t - trace.t[:1], float(event["at"]) - 1e-9))
        indices[first_instant:, targets] = len(names)
        names.append(str(event.get("pattern") or ""))
    return tuple(names), indices


def faults_at(trace: Trace, time: float) -> Mapping[str, str]:
    """The faults that are on at `time` s from the start, by robot, such as `scan frozen`."""
    on: dict[str, dict[str, None]] = {}
    for event in trace.meta.get("events", ()):
        action, _, fault = str(event["action"]).partition(" ")
        for robot in event["robots"] if action in ("fault", "mend") and event["at"] <= time else ():
            on.setdefault(robot, {}).pop(fault, None)
            if action == "fault":
                on[robot][fault] = None
    return {robot: ", ".join(faults) for robot, faults in on.items() if faults}


def said_in(trace: Trace) -> Sequence[tuple[float, str, str]]:
    """What robots logged in a run with faults: s from the start, robot and text, by time."""
    start = float(trace.t[0]) if len(trace.t) else 0.0
    return [(float(at) - start, robot, text) for at, robot, text in trace.meta.get("said", ())]


def _most_unpacked(path: Path) -> int:
    return MAX_RATIO * path.stat().st_size + MAX_SPARE


def _unpacked_size(path: Path) -> int:
    """The bytes of all members of an archive; zipfile reads no more of any than its head states."""
    with open_regular(path) as file, ZipFile(file) as archive:
        return sum(member.file_size for member in archive.infolist())


def load_trace(path: Path) -> Trace:
    """Load a trace from an .npz file, which may come from a stranger.

    ConfigError if the file cannot be read, is not a trace, or unpacks to more than MAX_RATIO times
    its size plus MAX_SPARE.
    """
    try:
        return _unpacked(path)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ConfigError:
        raise
    except Exception as error:  # numpy lets through whatever zlib, zipfile and tokenize raise
        raise ConfigError(f"{path}: not a trace, or damaged; expected a run's .npz file") from error


def _unpacked(path: Path) -> Trace:
    """The trace of a file; ConfigError for its size or version, any exception for other faults."""
    if (size := _unpacked_size(path)) > (most := _most_unpacked(path)):
        raise ConfigError(
            f"{path}: unpacks to {size} bytes; expected {most} or less, {MAX_RATIO} times its"
            " size plus 64 MiB"
        )
    with open_regular(path) as raw, np.load(raw, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    # The head, as JSON, has the fields of a trace that are no arrays.
    head = json.loads(str(arrays.pop("head")))
    if head.pop("version") != VERSION:
        raise ConfigError(f"{path}: a trace of another version; this reads {VERSION}")
    for key in ("ids", "platforms", "movable_boxes"):
        head[key] = tuple(head[key])
    if len(head["platforms"]) != len(head["ids"]):
        raise ValueError(f"{len(head['platforms'])} platforms of {len(head['ids'])} robots")
    if missing := set(head["platforms"]) - head["footprints"].keys():
        raise ValueError(f"no footprint of {missing}")
    head["footprints"] = {name: np.array(shape) for name, shape in head["footprints"].items()}
    _check_parts(arrays, {"n": len(head["ids"]), "m": len(head["movable_boxes"])})
    # Arrays named KIND/NAME, such as `report/opinion`, are a dict of their kind.
    for kind in NAMED:
        keys = [name for name in arrays if name.startswith(f"{kind}/")]
        head[kind] = {name.partition("/")[2]: arrays.pop(name) for name in keys}
    return Trace(**head, **arrays)


def _check_parts(arrays: Mapping[str, NDArray[Any]], sizes: Mapping[str, int]) -> None:
    """Raise ValueError for a kind or shape that differs from `_PARTS`; `sizes` by letter."""
    sizes = {"T": len(arrays["t"]), "c": len(arrays["contact_t"]), **sizes}
    for name, array in arrays.items():
        kind, *shape = _PARTS[name.partition("/")[0]].split()
        wanted = [sizes.get(word) if word.isalpha() else int(word) for word in shape]
        fits = len(wanted) == array.ndim and array.dtype.kind == kind
        pairs = zip(array.shape, wanted, strict=False)
        if not fits or any(want not in (None, size) for size, want in pairs):
            raise ValueError(f"{name} is {array.dtype} {array.shape}")


class TraceBuilder:
    """Builds a trace of ground truth and commands while a world runs."""

    def __init__(
        self,
        ids: Sequence[str],
        platforms: Sequence[Platform],
        meta: Mapping[str, Any],
        *,
        movable_boxes: Sequence[str] = (),
        box_shapes: Array | None = None,
    ) -> None:
        """`movable_boxes` are the movable boxes, `box_shapes` (m, k, 2) their outlines."""
        self._ids = tuple(ids)
        self._movable_boxes = tuple(movable_boxes)
        self._shapes = box_shapes if movable_boxes else None
        self._index = {robot: i for i, robot in enumerate(ids)}
        self._index |= {f"box/{name}": ARENA - 1 - i for i, name in enumerate(movable_boxes)}
        self._platforms = tuple(p.name for p in platforms)
        self._footprints = {p.name: p.footprint for p in platforms}
        self._meta = dict(meta)
        self.clear()

    def clear(self) -> None:
        """Discard all samples."""
        self._t: list[float] = []
        self._pose: list[Array] = []
        self._safe: list[Array] = []
        self._box_pose: list[Array] = []
        self._contacts: list[tuple[float, int, int, float, float]] = []

    def add(self, time: float, pose: Array, safe: Array, box_pose: Array | None = None) -> None:
        """Add a sample: poses and commands (n, 3), poses of boxes (m, 3), which are copied."""
        self._t.append(time)
        self._pose.append(pose.copy())
        self._safe.append(safe.copy())
        if self._movable_boxes and box_pose is not None:
            self._box_pose.append(box_pose.copy())

    def add_contact(self, time: float, a: str, b: str, speed_a: float, speed_b: float) -> None:
        """Add one step of a contact between robot `a` and `b`, a robot or part of the arena."""
        pair = self._index[a], self._index.get(b, ARENA)
        self._contacts.append((time, *pair, speed_a, speed_b))

    def trace(self, **meta: Any) -> Trace:
        """The trace since the last `clear`; `meta` is added to that of the constructor."""
        n = len(self._ids)
        m = len(self._movable_boxes)
        contacts = np.array(self._contacts, dtype=np.float64).reshape(-1, 5)
        return Trace(
            ids=self._ids,
            t=np.array(self._t, dtype=np.float64),
            pose=np.array(self._pose, dtype=np.float64).reshape(-1, n, 3),
            safe=np.array(self._safe, dtype=np.float64).reshape(-1, n, 3),
            contact_t=contacts[:, 0],
            contact_pair=contacts[:, 1:3].astype(np.int64),
            contact_speed=contacts[:, 3:],
            platforms=self._platforms,
            footprints=self._footprints,
            meta={**self._meta, **meta},
            movable_boxes=self._movable_boxes,
            box_pose=np.array(self._box_pose).reshape(-1, m, 3) if m else None,
            box_shapes=self._shapes,
        )


DECISION_ARRAYS = ("state", "reason", "active", "recovering", "gap", "scan_age", "bound")
NO_DECISION: tuple[Any, ...] = ("", "", False, False, np.nan, np.nan, (np.nan, np.nan, np.nan))
"""The values of a robot without a report, in the order of DECISION_ARRAYS."""


def blank_decisions(shape: tuple[int, ...]) -> dict[str, NDArray[Any]]:
    """The arrays that `enter_decision` fills, with the values of robots without a report."""
    return {
        name: np.full(shape + np.shape(blank), blank, dtype=WORD if blank == "" else None)
        for name, blank in zip(DECISION_ARRAYS, NO_DECISION, strict=True)
    }


def enter_decision(
    arrays: Mapping[str, NDArray[Any]],
    place: Any,
    state: str,
    reason: str,
    decision: Decision | DecisionSummary,
) -> None:
    """Write a robot's state, reason and decision at the index `place` of the arrays."""
    values = decision_values(state, reason, decision)
    for name, value in zip(DECISION_ARRAYS, values, strict=True):
        arrays[name][place] = value


def decision_values(
    state: str, reason: str, decision: Decision | DecisionSummary
) -> tuple[Any, ...]:
    """State, reason and values of a robot's decision, in the order of DECISION_ARRAYS."""
    gap = decision.min_gap
    age = decision.scan_age
    rows = decision.rows
    return (
        state,
        reason,
        decision.is_active,
        decision.is_recovering,
        np.nan if gap is None else gap,
        np.nan if age is None else age,
        (rows[0].bearing, rows[0].gap, rows[0].cap) if rows else NO_DECISION[-1],
    )


def enter_named(
    named: Mapping[str, dict[str, NDArray[Any]]], place: Any, shape: tuple[int, int], status: Status
) -> None:
    """Write the reports and readings of a status at the index `place` of the arrays in `named`.

    New arrays have `shape` (T, n). A name that the status leaves out becomes blank at `place`.
    """
    for kind, blank in NAMED.items():
        for values in named[kind].values():
            values[place] = blank

    def enter(kind: str, name: str, value: Scalar) -> None:
        if isinstance(value, str):
            named["words"].setdefault(name, np.full(shape, "", dtype=WORD))[place] = value
        else:
            named[kind].setdefault(name, np.full(shape, np.nan))[place] = float(value)

    for name, value in status.report.items():
        enter("report", name, value)
    for name, value in status.readings.items():
        enter("readings", name, value)


def columns_of(trace: Trace) -> dict[str, Any]:
    """The columns of a table with a row for each instant and robot, by name.

    Each column has T * n values: all robots at the first instant, then at the second, and so on. An
    array that the trace does not have gives no column. `heading` is in rad within [-pi, pi].
    """
    from swarmd.sim.metrics.window import presence

    instants, n = trace.pose.shape[:2]
    heading = np.arctan2(np.sin(trace.pose[..., 2]), np.cos(trace.pose[..., 2]))
    columns: dict[str, Any] = {
        "t": np.repeat(trace.t, n),
        "robot": np.tile(np.array(trace.ids, dtype=object), instants),
        "platform": np.tile(np.array(trace.platforms, dtype=object), instants),
        "x": trace.pose[..., 0],
        "y": trace.pose[..., 1],
        "heading": heading,
        "present": presence(trace),
    }
    columns |= _parted(trace.safe, TWIST)
    columns |= _parted(trace.requested, [f"requested_{name}" for name in TWIST])
    columns |= {name: getattr(trace, name) for name in _PER_ROBOT}
    columns |= _parted(trace.bound, BOUND)
    columns |= {f"report:{name}": values for name, values in trace.report.items()}
    columns |= {f"report:{name}": values for name, values in trace.words.items()}
    columns |= {f"reading:{name}": values for name, values in trace.readings.items()}
    return {name: values.reshape(-1) for name, values in columns.items() if values is not None}


def pandas() -> Any:
    """The module pandas; without it SwarmError with the command that installs pandas."""
    try:
        return import_module("pandas")
    except ImportError as error:
        raise SwarmError("tables need pandas: pip install 'swarmd[table]'") from error


def _parted(values: Array | None, names: Any) -> dict[str, Array]:
    """The parts of values (T, n, k) by name."""
    return {} if values is None else {name: values[..., k] for k, name in enumerate(names)}
