"""The player of one run in a report: modules of the page of a swarm, and the run as data.

The modules are JavaScript of `swarmd/operator/view/page`. The data of the run are samples at equal
periods. A pose is stored as 16-bit numbers. A value of a robot, such as its state, is stored in a
sample if the value has changed since the previous sample.
"""

from __future__ import annotations

import base64
import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from swarmd.core.values import Array
from swarmd.operator.view.source import Source, hello_of

MODULES = (
    *("body.js", "states.js", "colours.js", "gestures.js", "legend.js"),
    *("model.js", "map.js", "timeline.js"),
)
"""The modules of the page that the player uses, each after those that it imports."""
MAX_RATE = 10.0  # samples of poses per s
MAX_POSES = 90_000  # of all robots and boxes together, 6 bytes each
ROW_PERIOD = 0.5  # s between two samples of values
MAX_ROWS = 20_000  # of all robots together
_MAX_LINKED = 50  # robots up to which links are kept
_KEPT = (
    *("presence", "state", "stands", "why", "pattern", "protection", "report"),
    "touches",
)
_LARGEST = 32767
_ABSENT = -32768
_IMPORT = re.compile(r"^import \{ ([\w, ]+) \} from '\./([\w.]+)';$", re.MULTILINE)
_EXPORT = re.compile(r"^export (?:class|function|const) (\w+)", re.MULTILINE)


@dataclass(frozen=True, slots=True)
class Player:
    """The data of a player as JSON, and the time in s between its samples of poses."""

    data: str
    period: float


def player_of(source: Source, start: float = 0.0) -> Player:
    """Sample the run that a source plays, for the player of a report, which begins at `start` s.

    Moves the playback time of the source. The number of samples is limited, so that a report stays
    small.
    """
    playback = source.playback
    assert playback is not None  # only sources of a live swarm have none
    playback.play(is_playing=False, speed=1.0)
    duration = playback.duration
    robots = len(source.robots)
    playback.seek(0.0)

    # Poses (count, bodies, 3) of robots, then of movable boxes; NaN while not in the arena.
    shapes = _box_shapes(source, duration)
    bodies = robots + len(shapes)
    count = max(2, min(round(MAX_RATE * duration) + 1, MAX_POSES // max(bodies, 1)))
    period = duration / (count - 1) if duration > 0.0 else 1.0
    poses = np.full((count, bodies, 3), np.nan)
    for k in range(count):
        playback.seek(k * period)
        _, robot_poses = source.frame()  # rows: index of the robot, x, y, yaw
        poses[k, robot_poses[:, 0].astype(int)] = robot_poses[:, 1:]
        _enter_boxes(poses[k, robots:], shapes, source)
    packed, centre, unit = _packed(poses)

    row_period, rows, links = _rows(source, duration)
    playback.seek(0.0)
    # The first message that the page gets from a server: robots, arena and runs. The page lets only
    # the role operator move the time of a run.
    hello = {**hello_of(source, "operator"), "runs": [playback.run]}
    data = {
        "hello": hello,
        "start": start,
        "period": period,
        "count": count,
        "centre": centre,
        "unit": unit,
        "poses": packed,
        "boxes": [shape.tolist() for shape in shapes],
        "row_period": row_period,
        "rows": rows,
        "links": links,
    }
    return Player(json.dumps(data, separators=(",", ":"), allow_nan=False), period)


def _enter_boxes(poses: Array, shapes: Sequence[Array], source: Source) -> None:
    """Write the present poses of the movable boxes into `poses` (boxes, 3), by their outlines.

    A source gives boxes without names, so a box takes the first free row with its outline. A box
    without such a row is left out.
    """
    free_rows = list(range(len(shapes)))
    for shape, pose in source.boxes():
        row = next((row for row in free_rows if np.array_equal(shapes[row], shape)), None)
        if row is not None:
            free_rows.remove(row)
            poses[row] = pose


def script() -> str:
    """The JavaScript of the player as one script, so that a report needs no other file.

    A script without files cannot import modules. So each module of the page becomes a function that
    runs once and writes its exports into an object `modules`. Each import becomes an assignment
    from `modules`. The text of player.js comes last.
    """
    page = files("swarmd.operator.view") / "page"
    sources = [(name, (page / name).read_text(encoding="utf-8")) for name in MODULES]
    own = (files("swarmd.sim.report") / "page" / "player.js").read_text(encoding="utf-8")
    parts = ["const modules = {};"]
    for name, text in sources:
        exported = ", ".join(_EXPORT.findall(text))
        body = re.sub(r"^export ", "", _linked(text), flags=re.MULTILINE)
        parts.append(f"modules['{name}'] = (() => {{\n{body}\nreturn {{ {exported} }};\n}})();")
    return "\n".join((*parts, _linked(own)))


def _linked(text: str) -> str:
    """The text with its imports taken from `modules`; ValueError for another kind of import."""
    linked = _IMPORT.sub(r"const { \1 } = modules['\2'];", text)
    if re.search(r"^import\b", linked, re.MULTILINE) or "</script" in linked:
        raise ValueError("a module of the page cannot be put into a report")
    return linked


def _box_shapes(source: Source, duration: float) -> list[Array]:
    """The outlines (k, 2) of the movable boxes that are in the arena at any of 21 instants.

    An outline occurs as often as the greatest number of boxes with this outline at one instant.
    """
    assert source.playback is not None
    shape_by_bytes: dict[bytes, Array] = {}
    most_boxes = Counter[bytes]()
    for k in range(21):
        source.playback.seek(k * duration / 20.0)
        shapes = [shape for shape, _ in source.boxes()]
        shape_by_bytes |= {shape.tobytes(): shape for shape in shapes}
        most_boxes |= Counter(shape.tobytes() for shape in shapes)
    return [shape_by_bytes[key] for key in most_boxes.elements()]


def _packed(poses: Array) -> tuple[str, list[float], float]:
    """Poses (count, bodies, 3) as base64 of 16-bit integers, with their centre and unit in m.

    A position is centre + unit * integer. A yaw is pi / _LARGEST * integer. _ABSENT: NaN.
    """
    places = poses[..., :2].reshape(-1, 2)
    places = places[np.isfinite(places).all(axis=1)]
    low, high = (places.min(axis=0), places.max(axis=0)) if len(places) else (np.zeros(2),) * 2
    centre = (low + high) / 2.0
    unit = max(float((high - low).max()) / 2.0 / _LARGEST, 1e-4)
    numbers = np.empty(poses.shape)
    numbers[..., :2] = (poses[..., :2] - centre) / unit
    numbers[..., 2] = np.angle(np.exp(1j * poses[..., 2])) * _LARGEST / math.pi
    numbers = np.where(np.isfinite(poses).all(axis=2, keepdims=True), np.rint(numbers), _ABSENT)
    packed = base64.b64encode(numbers.astype("<i2").tobytes()).decode()
    return packed, [float(value) for value in centre], unit


def _rows(source: Source, duration: float) -> tuple[float, list[Any], list[Any]]:
    """Sample the values of robots, such as state and report, and the links between robots.

    Returns the period in s, the values and the links. The values of a sample are those that have
    changed since the previous sample, by robot. The links of a sample are pairs of robots; empty
    for more than _MAX_LINKED robots.
    """
    assert source.playback is not None
    robots = max(len(source.robots), 1)
    # A sample each ROW_PERIOD from 0 to the end; 1e-6 is for rounding. Fewer of many robots.
    count = max(1, min(math.floor(duration / ROW_PERIOD + 1e-6) + 1, MAX_ROWS // robots))
    period = duration / (count - 1) if count > 1 else max(duration, ROW_PERIOD)
    rows = []
    links = []
    last_values: dict[str, dict[str, Any]] = {}  # of the sample before, by robot
    for k in range(count):
        source.playback.seek(k * period)
        changed_by_robot: dict[str, dict[str, Any]] = {}
        for name, row in source.rows().items():
            values = {key: row[key] for key in _KEPT if key in row}
            old = last_values.get(name, {})
            changed = {key: value for key, value in values.items() if old.get(key) != value}
            if changed:
                changed_by_robot[name] = changed
            last_values[name] = values
        rows.append(changed_by_robot)
        links.append(list(source.links()) if robots <= _MAX_LINKED else [])
    return period, rows, links
