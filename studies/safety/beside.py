"""One robot that is set down beside something, and what it does then: docs/evidence/beside.md.

A cell is a platform, a thing beside the robot, a gap, a heading and a mode. The robot walks at
random in an arena of 6 x 6 m with floor all around, and nothing touches it. The numbers are those
of the world: poses and contacts of MuJoCo, not the arithmetic of protection.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import msgspec
import numpy as np
from msgspec import Struct

from benchmarks.table import markdown
from studies import keeper
from studies.keeper import Traced, traced
from studies.safety.driven import faults
from studies.safety.judge import collisions
from studies.safety.scenes import protected
from swarmd.core.values import Array
from swarmd.robot.protection.compatibility import body_of, sees
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.set_down import set_down
from swarmd.settings.platforms import load_platform
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.trace import Trace
from swarmd.sim.world.geometry import gaps, transform

GAPS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5)
FEW_GAPS = (0.05, 0.1, 0.2, 0.3, 0.4)
FEWER_GAPS = (0.05, 0.2)
"""m between the outline and the thing: all of them; those of a run of minutes beside a wall, and
beside other things."""
HEADINGS = (0.0, 45.0, 90.0, 180.0)
"""Degrees: 0 and 180 along the thing, which is on the left or on the right; 90 with the nose to
it."""
MODES = ("platform", "off", "still", "walls_stand")
"""`platform`: protection as in the platform's file. Controls: protection `off`, and `still`, a
robot that asks for no motion. `walls_stand`: the platform with walls that are declared to stand."""
FIRST_SEED = 14_000
SHORT = 40.0
LONG = 120.0
"""s of a run: each cell has the first, and a robot that is not `AWAY` by then drives on."""
AWAY = 0.5
"""m from the start at which a robot has left."""
WANTED = 0.1
"""m that a robot that may creep is wanted to come away within SHORT s."""
NOTHING = 0.005
"""m: a robot that has come less far in LONG s has not moved; noise and rounding give 1e-15."""

_HALF = 3.0  # m, half of the side of the arena
_STEP = 2.0  # s between two looks at whether a run may end
_POLE = 0.15  # m, radius
_BOX = 0.4  # m, side
_LONG_WALL = 3.0  # m, of a corridor
_WALL_DEPTH = 1.0  # m, of the walls around the arena, as bodies of the judge
_POLE_CORNERS = 96  # of the polygon of a pole, which is 0.1 mm smaller than the pole
_ROBOT = "robot"
_OTHER = "parked"


class Cell(Struct, frozen=True, order=True):
    """A run to do: the robot's outline is `gap` m from what it is `beside`, one of THINGS."""

    platform: str
    beside: str
    gap: float
    heading: float
    mode: str = "platform"
    seed: int = FIRST_SEED

    @property
    def name(self) -> str:
        """Such as `burger wall 0.05 m 45 deg platform`."""
        return f"{self.platform} {self.beside} {self.gap:g} m {self.heading:g} deg {self.mode}"


class Found(Struct, frozen=True, kw_only=True):
    """What the robot did.

    - `near`: m, the farthest that it came from its start within SHORT s. `far`: within `seconds`.
    - `path`: m that its axle drove within `seconds`.
    - `left`: s after which it was AWAY; None: never.
    - `seconds`: how long the run was: LONG, or less for a robot that had left.
    - `least_gap`: m, the true distance of its outline to the nearest body, at the least.
    - `touches`: counted contacts, `faults` of them at fault, the fastest at `hardest` m/s.
    - `held`: the share of the instants in which protection or a hold kept a robot that asks for
      motion at zero. `reason`: the most frequent reason of these instants.
    """

    near: float
    far: float
    path: float
    left: float | None
    seconds: float
    least_gap: float
    touches: int
    faults: int
    hardest: float
    held: float
    reason: str


Record: TypeAlias = keeper.Record[Cell, Found]
"""A finished run."""


class Place(Struct, frozen=True):
    """Where the robot stands, and what is around it.

    `pose`: x, y in m and heading in degrees. `arena`: its obstacles as a scenario has them.
    `bodies`: (k, 2) outlines of these obstacles. `other`: the pose of a parked robot.
    """

    pose: tuple[float, float, float]
    arena: Mapping[str, Any]
    bodies: tuple[Array, ...] = ()
    other: tuple[float, float, float] | None = None


def _rectangle(left: float, right: float, low: float, high: float) -> Array:
    return np.array([(left, low), (right, low), (right, high), (left, high)])


def _pose(outline: Array, heading: float, top: float) -> tuple[float, float, float]:
    """The pose in which the foremost place of the outline towards +y is at (0, `top`)."""
    turned = transform(outline, np.array((0.0, 0.0, math.radians(heading))))
    highest = turned[:, 1].max()
    x = turned[turned[:, 1] > highest - 1e-6, 0].mean()
    return -float(x), top - float(highest), heading


def _wall(cell: Cell, outline: Array) -> Place:
    return Place(_pose(outline, cell.heading, _HALF - cell.gap), {})


def _corner(cell: Cell, outline: Array) -> Place:
    _, y, heading = _pose(outline, cell.heading, _HALF - cell.gap)
    turned = transform(outline, np.array((0.0, 0.0, math.radians(heading))))
    return Place((_HALF - cell.gap - float(turned[:, 0].max()), y, heading), {})


def _pole(cell: Cell, outline: Array) -> Place:
    angles = np.linspace(0.0, 2.0 * np.pi, _POLE_CORNERS, endpoint=False)
    body = np.array((0.0, _POLE)) + _POLE * np.column_stack((np.cos(angles), np.sin(angles)))
    pole = {"at": [0.0, _POLE], "radius": _POLE}
    return Place(_pose(outline, cell.heading, -cell.gap), {"poles": [pole]}, (body,))


def _box(cell: Cell, outline: Array) -> Place:
    half = 0.5 * _BOX
    box = {"at": [0.0, half], "size": [_BOX, _BOX]}
    body = _rectangle(-half, half, 0.0, _BOX)
    return Place(_pose(outline, cell.heading, -cell.gap), {"boxes": [box]}, (body,))


def _parked(cell: Cell, outline: Array) -> Place:
    at = -0.5 * float(outline[:, 0].max() + outline[:, 0].min()), -float(outline[:, 1].min())
    return Place(_pose(outline, cell.heading, -cell.gap), {}, other=(*at, 0.0))


def _corridor(cell: Cell, outline: Array) -> Place:
    """A corridor as wide as the platform is declared to pass, or as the robot across needs."""
    turned = transform(outline, np.array((0.0, 0.0, math.radians(cell.heading))))
    across = float(np.ptp(turned[:, 1]))
    passage = narrowest_passage(make_mode(load_platform(cell.platform)))
    width = max(across + 2.0 * cell.gap, 0.0 if passage is None else passage.corridor)
    half = 0.5 * _LONG_WALL
    segments = [{"from": [-half, y], "to": [half, y]} for y in (0.0, -width)]
    bodies = (_rectangle(-half, half, 0.0, 1e-3), _rectangle(-half, half, -width - 1e-3, -width))
    return Place(_pose(outline, cell.heading, -cell.gap), {"segments": segments}, bodies)


THINGS: Mapping[str, Callable[[Cell, Array], Place]] = {
    "wall": _wall,
    "corner": _corner,
    "pole": _pole,
    "box": _box,
    "robot": _parked,
    "corridor": _corridor,
}
"""What the robot is beside: a wall of the arena, two of them, a pole of 0.3 m, a box of 0.4 m, a
parked robot of its platform, and a corridor that `describe` calls passable."""


def place_of(cell: Cell) -> Place:
    """Where the robot of a cell stands."""
    return THINGS[cell.beside](cell, load_platform(cell.platform).footprint)


def scenario_for(cell: Cell, place: Place) -> Scenario:
    """The scenario of a cell; a robot that its own kind does not see tells where it is."""
    protection: dict[str, Any] = {}
    if cell.mode == "off":
        protection = {"mode": "off"}
    elif cell.mode == "walls_stand":
        declared = protected(cell.platform, "walls_stand", {})["protection"]["barrier"]
        protection = {"barrier": declared}
    own = {"extends": cell.platform, "protection": protection}
    platforms = {cell.platform: own} if protection else {}
    parked = {"pattern": "drive", "parameters": {"speed": 0.0}}
    walks = {"pattern": "random_walk"}
    robots = {_ROBOT: (place.pose, parked if cell.mode == "still" else walks)}
    body = body_of(load_platform(cell.platform))
    is_told = place.other is not None and not sees(body, body)
    if place.other is not None:
        robots[_OTHER] = place.other, parked
    return scenario_of(
        {
            "name": "beside",
            "duration": LONG,
            "trace_rate": 20.0,
            "lidar_visibility": "real",
            "realism": "realistic",
            "radio": {"range_and_bearing": is_told},
            "arena": {"size": [2.0 * _HALF, 2.0 * _HALF], **place.arena},
            "platforms": platforms,
            "groups": {
                group: {
                    "platform": cell.platform,
                    "count": 1,
                    "prefix": group,
                    "start": {"layout": "list", "poses": [list(pose)]},
                    **runs,
                }
                for group, (pose, runs) in robots.items()
            },
        }
    )


def simulate(
    cell: Cell, *, away: float = AWAY, at_least: float = SHORT, at_most: float = LONG
) -> Traced[Found]:
    """Simulate and measure one cell, in this process.

    The run ends after `at_most` s, or after `at_least` s once the robot is `away` m from its start.
    """
    place = place_of(cell)
    run = Lockstep(scenario_for(cell, place), cell.seed)
    row = next(i for i, name in enumerate(run.world.ids) if name.startswith(_ROBOT))
    start = run.world.poses()[row, :2].copy()
    while run.world.time < at_most - 0.5 * run.world.dt:
        run.advance(min(_STEP, at_most - run.world.time))
        off = run.world.poses()[row, :2] - start
        if run.world.time >= at_least and math.hypot(*off) >= away:
            break
    trace = run.trace()
    return traced(measure(trace, row, place.bodies, away), trace)


def measure(trace: Trace, row: int, bodies: Sequence[Array], away: float = AWAY) -> Found:
    """The numbers of robot `row`; `bodies`: (k, 2) outlines that stand in the arena."""
    pose = trace.pose[:, row]
    off = np.hypot(*(pose[:, :2] - pose[0, :2]).T)
    is_away = off >= away
    outline = transform(trace.footprint(row), pose)
    side = _HALF
    depth = _HALF + _WALL_DEPTH
    walls = [
        _rectangle(side, depth, -depth, depth),
        _rectangle(-depth, -side, -depth, depth),
        _rectangle(-depth, depth, side, depth),
        _rectangle(-depth, depth, -depth, -side),
    ]
    around = [np.broadcast_to(body, (len(pose), *body.shape)) for body in (*walls, *bodies)]
    around += [
        transform(trace.footprint(other), trace.pose[:, other])
        for other in range(len(trace.ids))
        if other != row
    ]
    touching = [one for one in collisions(trace) if trace.ids[row] in (one.a, one.b)]
    asks = np.abs(_known(trace.requested)[:, row]).max(axis=1) > 0.0
    stands = np.abs(trace.safe[:, row]).max(axis=1) < 1e-9
    is_held = asks & stands
    reasons = Counter(str(reason) for reason in _known(trace.reason)[is_held, row] if reason)
    return Found(
        near=float(off[trace.t <= trace.t[0] + SHORT + 1e-6].max()),
        far=float(off.max()),
        path=float(np.hypot(*np.diff(pose[:, :2], axis=0).T).sum()),
        left=float(trace.t[is_away.argmax()] - trace.t[0]) if is_away.any() else None,
        seconds=trace.duration,
        least_gap=min(float(gaps(outline, body).min()) for body in around),
        touches=len(touching),
        faults=sum(one.robot == trace.ids[row] for one in faults(trace)),
        hardest=max((one.own_speed for one in touching), default=0.0),
        held=float(is_held.mean()),
        reason=reasons.most_common(1)[0][0] if reasons else "",
    )


def _known(values: Any) -> Any:
    assert values is not None, "a trace of lockstep has what robots decided"
    return values


def cells(
    platforms: Iterable[str],
    things: Iterable[str],
    gaps_: Sequence[float] | None,
    headings: Sequence[float],
    modes: Iterable[str],
) -> list[Cell]:
    """The cells of a table: a control has the wall alone, with the robot along it.

    `gaps_`: None for FEW_GAPS beside a wall, FEWER_GAPS beside other things, and `named_gap` beside
    a wall and in a corridor.
    """
    found = []
    for mode in modes:
        is_control = mode in ("off", "still")
        for beside in things:
            if is_control and beside != "wall":
                continue
            for platform in platforms:
                for gap in gaps_ or _few_gaps(platform, beside, mode):
                    some = headings[:1] if is_control else headings
                    found += [Cell(platform, beside, gap, heading, mode) for heading in some]
    return found


def named_gap(platform: str) -> float | None:
    """m from walls at which the platform says that it may be set down, in whole centimetres."""
    loaded = load_platform(platform)
    found = set_down(loaded, narrowest_passage(make_mode(loaded)))
    return None if found is None else math.ceil(100.0 * found.gap - 1e-6) / 100.0


def _few_gaps(platform: str, beside: str, mode: str) -> Sequence[float]:
    """Those of a table of minutes; in the middle of a corridor the named gap is on both sides."""
    some = FEW_GAPS if beside == "wall" else FEWER_GAPS
    has_named = beside in ("wall", "corridor") and mode == "platform"
    named = named_gap(platform) if has_named else None
    return some if named is None or named in some else (*some, named)


def carry_out(
    wanted: Sequence[Cell], seeds: tuple[int, int, int], jobs: int, file: Path
) -> list[Record]:
    """The runs of cells that are not in `file` yet, then further seeds.

    `seeds`: how many of each cell, of each cell in which the robot has not moved, and of each cell
    beside a plain wall.
    """

    def runs(some: Iterable[tuple[Cell, int]]) -> list[Record]:
        tasks = [
            msgspec.structs.replace(cell, seed=FIRST_SEED + number)
            for cell, count in some
            for number in range(count)
        ]
        return keeper.records(simulate, tasks, file, jobs=jobs, told=_told)

    each, unmoved, at_wall = seeds
    first = runs((cell, each) for cell in wanted)
    still = {_cell(one.task) for one in first if one.found.far < NOTHING}
    more = [
        (
            cell,
            max(
                each,
                unmoved if cell in still and cell.mode != "still" else 0,
                at_wall if cell.beside == "wall" and cell.mode == "platform" else 0,
            ),
        )
        for cell in wanted
    ]
    return runs(more)


def _told(record: Record) -> str:
    found = record.found
    return f"{record.task.name} seed {record.task.seed}: {found.near:.3f} m, {found.far:.3f} m"


def _cell(task: Cell) -> Cell:
    return msgspec.structs.replace(task, seed=FIRST_SEED)


def keep(records: Iterable[Record], file: Path) -> None:
    """Write the values of each run, a line of JSON: cell, then numbers with three decimals."""
    lines = []
    for one in sorted(records, key=lambda record: record.task):
        values = msgspec.structs.asdict(one.found)
        short = {
            key: round(value, 3) if isinstance(value, float) else value
            for key, value in values.items()
        }
        lines.append(msgspec.json.encode([*msgspec.structs.astuple(one.task), *short.values()]))
    file.write_bytes(b"\n".join([*lines, b""]))


def load(file: Path) -> dict[Cell, Found]:
    """The values of each run in a file of `keep`."""
    found = {}
    count = len(Cell.__struct_fields__)
    for line in file.read_bytes().splitlines():
        values = msgspec.json.decode(line)
        cell = msgspec.convert(dict(zip(Cell.__struct_fields__, values, strict=False)), Cell)
        numbers = dict(zip(Found.__struct_fields__, values[count:], strict=True))
        found[cell] = msgspec.convert(numbers, Found)
    return found


def values_of(records: Iterable[Record]) -> dict[Cell, Found]:
    """The values of each run by its cell."""
    return {one.task: one.found for one in records}


Runs = Mapping[Cell, Found]
_MODE_NAMES = {
    "platform": "{}",
    "off": "{}, **protection off**",
    "still": "{}, asks for no motion",
    "walls_stand": "{}, with `walls_stand`",
}


def summary(runs: Runs, before: Runs) -> str:
    """Markdown: a row for each mode and platform; after an arrow what `before` had.

    Of both, the runs that both have.
    """
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in runs:
        groups.setdefault((cell.mode, cell.platform), []).append(cell)
    rows = [
        [
            *("robot", "runs", f"not moved in {LONG:g} s", f"{WANTED:g} m away in {SHORT:g} s"),
            *(f"{AWAY:g} m away in {LONG:g} s", "held", "least gap [m]", "touches", "at fault"),
            *("hardest [cm/s]",),
        ]
    ]
    order = sorted(groups, key=lambda group: (MODES.index(group[0]), group[1]))
    for mode, platform in order:
        some = groups[mode, platform]
        earlier = [before[cell] for cell in some if cell in before]
        now = [runs[cell] for cell in some]
        name = _MODE_NAMES[mode].format(f"`{platform}`")
        rows.append([name, str(len(some)), *_both(earlier, now, len(earlier) == len(some))])
    return markdown(rows)


def _both(earlier: Sequence[Found], now: Sequence[Found], is_whole: bool) -> list[str]:
    cells_ = _sums(now)
    if not is_whole:
        return cells_
    return [
        later if was == later else f"{was} → {later}"
        for was, later in zip(_sums(earlier), cells_, strict=True)
    ]


def _sums(some: Sequence[Found]) -> list[str]:
    return [
        str(sum(one.far < NOTHING for one in some)),
        str(sum(one.near >= WANTED for one in some)),
        str(sum(one.left is not None for one in some)),
        f"{float(np.mean([one.held for one in some])):.0%}",
        f"{min(one.least_gap for one in some):.3f}",
        str(sum(one.touches for one in some)),
        str(sum(one.faults for one in some)),
        f"{100.0 * max(one.hardest for one in some):.1f}",
    ]


def by_gap(runs: Runs, before: Runs, mode: str = "platform") -> str:
    """Markdown: a row for each thing and platform, a column for each gap.

    A cell has the m away in SHORT s and in LONG s of the run that came least far, of all headings
    and seeds; after an arrow those of `runs`.
    """
    some = [cell for cell in runs if cell.mode == mode]
    named = {platform: named_gap(platform) for platform in {cell.platform for cell in some}}
    gaps_ = sorted(
        {cell.gap for cell in some if cell.gap in GAPS or cell.gap != named[cell.platform]}
    )
    rows = [["beside", "robot", *(f"{gap:g} m" for gap in gaps_), "the distance that it names"]]
    places = dict.fromkeys((cell.beside, cell.platform) for cell in sorted(some))
    for beside, platform in sorted(places, key=lambda place: (list(THINGS).index(place[0]), place)):
        row = [beside, f"`{platform}`"]
        for gap in (*gaps_, named[platform]):
            of = [c for c in some if (c.beside, c.platform, c.gap) == (beside, platform, gap)]
            now = _least([runs[cell] for cell in of])
            was = _least([before[cell] for cell in of if cell in before])
            row.append(now if was in ("-", now) else f"{was} → {now}")
        rows.append(row)
    return markdown(rows)


def _least(some: Sequence[Found]) -> str:
    """Such as `0.05, >0.5`: m in SHORT s, and in LONG s; `>` where the run had ended before."""
    if not some:
        return "-"
    near = min(one.near for one in some)
    far = min(some, key=lambda one: min(one.far, AWAY)).far
    return f"{near:.2f}, {'≥' * (far >= AWAY)}{min(far, AWAY):.2f}"


def each(runs: Runs) -> str:
    """Markdown: a row for each run."""
    rows = [[*Cell.__struct_fields__, *Found.__struct_fields__]]
    for cell in sorted(runs):
        found = msgspec.structs.asdict(runs[cell]).values()
        rows.append(
            [
                *(str(value) for value in msgspec.structs.astuple(cell)),
                *(f"{value:.3f}" if isinstance(value, float) else str(value) for value in found),
            ]
        )
    return markdown(rows)
