"""The keys of a scenario's file. Lengths in m, times in s, angles in degrees."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import Meta, Struct, field

from swarmd.core.bounds import BoundedScalar
from swarmd.kit.touch_config import TouchGrants
from swarmd.settings.robot_settings import RobotSettings
from swarmd.sim.world.field_kind import Coordinate, Degrees, Point
from swarmd.sim.world.item_kind import ItemKind
from swarmd.sim.world.radio import RadioSettings

Size = Annotated[float, Meta(ge=0.01, le=10_000.0)]
Distance = Annotated[float, Meta(ge=0.0, le=10_000.0)]
Seconds = Annotated[float, Meta(gt=0.0, le=1e6)]
Placed = tuple[Coordinate, Coordinate, Degrees]
Values = dict[str, BoundedScalar | None]
Targets = str | list[str]


class BoxSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A box by centre and side lengths; with a `mass` in kg it is movable.

    - `name`: by which events place and remove the box.
    - `at`: the centre. A movable box without `at` is outside the arena until an event places it.
    - `size`: the lengths of its sides.
    - `yaw_deg`: its heading.
    - `mass`: in kg; None: the box is fixed.
    """

    name: str = ""
    at: Point | None = None
    size: tuple[Size, Size]
    yaw_deg: Degrees = 0.0
    mass: Annotated[float, Meta(gt=0.0, le=100_000.0)] | None = None


class PoleSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A round pole."""

    at: Point
    radius: Size


class SegmentSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A thin inner wall, `from` a point `to` another."""

    start: Point = field(name="from")
    end: Point = field(name="to")


class ArenaSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Four walls around the origin, `size` along x and y, and obstacles."""

    size: tuple[Size, Size] = (6.0, 6.0)
    boxes: list[BoxSection] = []
    poles: list[PoleSection] = []
    segments: list[SegmentSection] = []


class StartSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Where robots start.

    - `layout`: `row`, `grid` and `paper` (a row that begins in the middle) have `spacing`; `ring`
      has `radius`; `random` has `clearance` and `size`; `chain` has `near` and `far`; `list` has
      `poses`. All but `list` have `center` and `heading_deg`.
    - `spacing`: m between neighbours.
    - `radius`: m of the ring.
    - `clearance`: m that are free around each robot.
    - `near`, `far`: bounds in m of the distance to the nearest robot.
    - `size`: the lengths of the area.
    - `center`: the middle of the robots.
    - `heading_deg`: the heading of the robots.
    - `poses`: x, y and heading in degrees of each robot.
    """

    layout: str | None = None
    spacing: Size | None = None
    radius: Size | None = None
    clearance: Distance | None = None
    near: Size | None = None
    far: Size | None = None
    size: tuple[Size, Size] | None = None
    center: Point | None = None
    heading_deg: Degrees | None = None
    poses: list[Placed] | None = None


class GroupSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Robots of one platform: `count` robots named `<prefix>-01` and on, or the ids in `robots`.

    - `platform`: the platform of the robots.
    - `count`, `prefix`: how many robots, and how their names begin.
    - `robots`: their ids, instead.
    - `start`: where these robots start.
    - `pattern`: what the robots run from the start. Robots that join later run no pattern without a
      `run` event.
    - `parameters`: apply whenever `pattern` runs.
    - `touch`: by pattern, the directions in which the pattern may press against obstacles, as in a
      daemon's file. It prevails over that of the file.
    """

    platform: str = "waffle_pi"
    count: Annotated[int, Meta(ge=1, le=100_000)] | None = None
    robots: list[str] | None = None
    prefix: str | None = None
    start: StartSection | None = None
    pattern: str | None = None
    parameters: Values = {}
    touch: TouchGrants = {}


class EventSection(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Exactly one of the actions of `schedule.ACTIONS`, `at` a time.

    - `at`: s after the start of the run.
    - `run`: a pattern, for `targets`.
    - `param`: values of parameters, for `targets`, such as `{speed: 0.2}`.
    - `stop`, `estop`, `reset`, `join`, `leave`, `kill`: robots, a group or `all`.
    - `place`: a box.
    - `remove`: a box, or robots, whose daemons are killed and which leave the arena for good.
    - `fields`: fields that replace the fields of the same names.
    - `fault`: a fault of `robots` by its place and kind, then its parameters, such as `{scan:
      noise, sd: 0.2}`; with `for` it ends after this time.
    - `targets`: the robots of `run` and `param`; None: all.
    - `robots`: the robots of `fault`.
    - `parameters`: of the pattern of `run`.
    - `seconds` (`for` in files), `until`: the run ends after this time in s, or with a condition
      such as `nearer:0.5`.
    - `pose`: x, y and heading in degrees of the box of `place`.
    """

    at: Annotated[float, Meta(ge=0.0, le=1e6)]
    run: str | None = None
    param: Values | None = None
    stop: Targets | None = None
    estop: Targets | None = None
    reset: Targets | None = None
    join: Targets | None = None
    leave: Targets | None = None
    kill: Targets | None = None
    place: str | None = None
    remove: str | None = None
    fields: list[dict[str, Any]] | None = None
    fault: dict[str, Any] | None = None
    targets: Targets | None = None
    robots: Targets | None = None
    parameters: Values | None = None
    seconds: Seconds | None = field(default=None, name="for")
    until: list[str] | None = None
    pose: Placed | None = None


class ScenarioFile(RobotSettings, Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole file.

    The keys of robots (`touch` to `on_low_battery`) are as in swarm.yaml, for all robots. The
    shared frame is `world`.

    - `name`: of the scenario; None: that of its file.
    - `description`: what `exp list` shows.
    - `extends`: another scenario, which gives all keys that this file leaves out.
    - `duration`: s of simulation.
    - `trace_rate`: recorded instants a second.
    - `lidar_visibility`: `body`: a lidar sees whole robots. `real`: it sees what is at its height.
    - `realism`: noise of sensors and bases: `realistic`, `ideal`, or single values.
    - `radio`: which robots receive from each other.
    - `arena`: four walls, and the obstacles between them.
    - `fields`: scalar fields, such as a floor, light and temperature, whose value each robot reads
      at its place.
    - `items`: objects that robots carry or push.
    - `platforms`: values that replace those of a platform's own file, or a new platform.
    - `groups`: robots of one platform each, by name.
    - `start`: places the robots of all groups that have no `start` of their own, as one group.
    - `parameters`: by pattern, for all robots; the parameters of a group prevail.
    - `events`: what happens at a time.
    - `pattern`: the groups without a pattern run it. As an override (`--pattern`, `--set`) of a
      scenario whose groups all have the same one, it replaces this in groups and events, without
      their parameters. Here and wherever a pattern is named, the path of a pattern's file
      or folder is taken, too, relative to this file (`mine/wall.py`).
    - `patterns`: parameters of further choices of `pattern`, by pattern: `NAME` for all of these
      groups, `GROUP.NAME` for one of them. `swarmctl exp bench` runs each choice.
    - `metric`: by which `exp bench` ranks them; no Python file.
    - `plugin_dir`: a folder of patterns and missions of your own, relative to the file. The folder
      of a pattern that is named by its path is taken without this key.
    - `pseudo_reality`: bounds of keys of `realism` and `radio`, such as
      `{realism.lidar.dropout: [0, 0.1]}`. Each seed draws values within the bounds. True: the
      bounds of `pseudo_reality.BOUNDS`.
    """

    name: str | None = None
    description: str = ""
    extends: str | None = None
    duration: Seconds = 60.0
    trace_rate: Annotated[float, Meta(gt=0.0, le=100.0)] = 10.0
    lidar_visibility: Literal["body", "real"] = "body"
    realism: str | dict[str, Any] = "realistic"
    radio: RadioSettings = RadioSettings()
    arena: ArenaSection = ArenaSection()
    fields: list[dict[str, Any]] = []
    items: list[ItemKind] = []
    platforms: dict[str, dict[str, Any]] = {}
    groups: dict[str, GroupSection]
    start: StartSection = StartSection()
    parameters: dict[str, Values] = {}
    events: list[EventSection] = []
    pattern: str | None = None
    patterns: dict[str, Values] = {}
    metric: str | None = None
    plugin_dir: str | None = None
    pseudo_reality: bool | dict[str, Any] = False
