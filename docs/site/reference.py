"""The generated parts of pages: plugins, YAML files, schemas, command lines and docstrings.

A page has a line with the name of a part. On the site, `conf.py` replaces this line by the part.
A short part that people read while they work is kept in its page, between two comments.
`make reference` runs this file, which then writes the kept parts into their pages, and all pages
with all parts below `build/pages`.
`make names` runs this file with `--names`, which writes the file `NAMES`.
"""

from __future__ import annotations

import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import compress, zip_longest
from pathlib import Path
from typing import Any, get_args

import click
import driver_messages
import msgspec
import zenoh
from docstrings import module, prose

from swarmd.core.errors import ConfigError
from swarmd.core.key_table import ANSWERED, HANDED_OVER, PUBLISHED
from swarmd.core.keys import CONTROL, SHARED, STATE, build
from swarmd.core.low_battery import LowBatterySettings
from swarmd.core.values import (
    POSE_OPTIONS,
    Detection,
    Heights,
    Inputs,
    Limits,
    Message,
    Neighbor,
    Odometry,
    Outputs,
    Platform,
    Pose,
    Scan,
    Twist,
)
from swarmd.core.verbs import VERBS
from swarmd.daemon.driver import make_driver
from swarmd.drivers.replay import ReplayOptions
from swarmd.drivers.ros.options import RmwOptions, Ros1Options, RosOptions, TopicOptions
from swarmd.drivers.simulated import SimulatedOptions
from swarmd.kit.behavior import Context
from swarmd.kit.touch_config import TouchSection
from swarmd.link.access import robot_access
from swarmd.link.keys.roster import Roster
from swarmd.link.members.neighbor_settings import NeighborSettings
from swarmd.operator.cli.daemon import swarmd
from swarmd.operator.cli.plugin_check import describe_patterns
from swarmd.operator.cli.swarmctl import VERBS as COMMANDS
from swarmd.operator.cli.swarmctl import cli
from swarmd.operator.texts.values import centimetres, short_number
from swarmd.operator.texts.why import SENTENCES
from swarmd.robot.protection.compatibility import assumed_speed, body_of, sees
from swarmd.robot.protection.fence.fence_settings import FenceSettings
from swarmd.robot.protection.modes import make_mode, narrowest_passage
from swarmd.robot.protection.set_down import set_down
from swarmd.robot.protection.settings import (
    BarrierSettings,
    PotentialFieldSettings,
    StopZoneSettings,
)
from swarmd.settings.driver_options import BaseOptions
from swarmd.settings.platforms import (
    PlatformFile,
    ProtectionSection,
    ScanSection,
    SensorSection,
    SweepSection,
    load_platform,
    platform_names,
    platform_sources,
)
from swarmd.settings.robot_settings import RobotSettings
from swarmd.settings.settings import load_daemon_settings
from swarmd.settings.swarmfile import (
    DaemonFile,
    GoalSection,
    ParametersSection,
    RecordingSection,
)
from swarmd.sim.metrics.catalog import METRICS
from swarmd.sim.metrics.placed import KINDS
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_names, task_names
from swarmd.sim.scenarios.schema import (
    ArenaSection,
    BoxSection,
    EventSection,
    GroupSection,
    PoleSection,
    ScenarioFile,
    SegmentSection,
    StartSection,
)
from swarmd.sim.world.faults import KINDS as FAULTS
from swarmd.sim.world.floor import Patch
from swarmd.sim.world.item_kind import ItemKind
from swarmd.sim.world.radio import RadioSettings
from swarmd.sim.world.realism import Actuation, LidarNoise, OdometryNoise
from swarmd.sim.world.scalar_fields import Field
from tests.histories.invariants import RULES
from tests.sequences.figures import read_figures

ROOT = Path(__file__).resolve().parents[2]
_PLATFORM = "waffle_pi"  # for defaults that depend on the robot
NAMES = ROOT / "tests/docs/public_names.txt"
"""The names and signatures on which users build; tests compare the file with the code."""
_NAMED = (
    "api",
    "testing",
    "experiments",
    "python",
    "commands",
    "keys",
    "payloads",
)  # parts with such names
_EXPLAINED = ("meaning", "what", "rate, while somebody subscribes")  # columns that name nothing
_PART = re.compile(r"^\*`make reference` makes this part, `(\w+)`, .*\*$", re.MULTILINE)
_KEPT = re.compile(
    r"^(<!-- `make reference` writes this part, `(\w+)`, .*-->\n)(?:.*\n)*?"
    r"(?=<!-- end of `\2` -->$)",
    re.MULTILINE,
)
_SECTION = re.compile(r"^#+ (.+)\n(?:\n```\w+\n((?:.|\n)*?)\n```)?", re.MULTILINE)


def patterns() -> Iterator[str]:
    """Each pattern with its parameters."""
    for row in describe_patterns((), None, _PLATFORM):
        if "error" in row:
            raise RuntimeError(f"{row['name']}: {row['error']}")
        yield f"## {row['name']}"
        yield prose(row["text"])
        channels = ", ".join(f"`{name}` ({kind})" for name, kind in row["channels"].items())
        needs = ", ".join(f"`{need}`" for need in row["needs"])
        yield f"Kind: {row['kind']}. Needs: {needs or 'no sensor'}. Sends: {channels or 'nothing'}."
        rows = [
            (
                f"`{param['name']}`",
                param["description"],
                _default(param),
                param["unit"],
                param["wanted"],
                "platform" if param["is_derived"] else param["source"],
            )
            for param in row["params"]
        ]
        yield _table(("parameter", "meaning", "default", "unit", "accepted", "source"), rows)


def films() -> Iterator[str]:
    """Each pattern with its film and the first sentence of its page, for `patterns/README.md`."""
    lines = ["| film | pattern |", "|---|---|"]
    for page in sorted((ROOT / "patterns").glob("*/page.md")):
        name, film = page.parent.name, page.parent / "film.gif"
        text = page.read_text(encoding="utf-8").partition("\n\n")[2].partition("\n\n")[0]
        first = re.split(r"(?<=\.) (?=[A-Z])", " ".join(text.split()))[0]
        image = f'<img src="{name}/film.gif" width="300" alt="film of {name}">'
        lines.append(
            f"| {image if film.exists() else ''} | [**{name}**]({name}/page.md): {first} |"
        )
    yield "\n".join(lines)


def comparison() -> Iterator[str]:
    """Tables by pattern: inputs and messages, the first outcome, and what breaks the pattern.

    Outcomes and breaks are taken from the pattern's page.
    """
    inputs, outcomes, breaks = [], [], []
    for row in describe_patterns((), None, _PLATFORM):
        page = ROOT / "patterns" / row["name"] / "page.md"
        if page.exists():
            name, text = f"`{row['name']}`", page.read_text(encoding="utf-8")
            channels = ", ".join(f"`{word}`" for word in row["channels"])
            needs = ", ".join(f"`{word}`" for word in row["needs"])
            inputs.append((name, needs or "no sensor", channels or "nothing"))
            outcomes.append((name, *_first_outcome(text.partition("\n## Measured\n")[2])))
            fails = text.partition("\n## When it fails\n")[2].strip().removeprefix("- ")
            breaks.append((name, fails.partition("\n- ")[0].replace("**", "")))
    yield "### What it needs and sends"
    yield _table(("pattern", "needs", "sends"), inputs)
    yield "### The first outcome"
    yield _table(("pattern", "what", "wanted", "reached", "from"), outcomes)
    yield "### What breaks it"
    yield _table(("pattern", "first of its failures"), breaks)


def runs_on() -> Iterator[str]:
    """The platforms that provide what each pattern and mission needs, by their drivers' options."""
    platforms = [load_platform(name) for name in platform_names()]
    shipped = {one.name: _provided(one) for one in platforms}
    shared = {
        one.name: frozenset().union(*(_provided(one, option) for option in POSE_OPTIONS))
        for one in platforms
    }
    rows = []
    for row in describe_patterns((), None, _PLATFORM):
        needs = frozenset(row["needs"])
        as_shipped = [name for name, provides in shipped.items() if needs <= provides]
        others = [name for name, has in shared.items() if needs <= has and name not in as_shipped]
        words = [_all_or(as_shipped, platforms)] if as_shipped else []
        words += [f"with a shared frame: {_all_or(others, platforms)}"] if others else []
        fewest = min((sorted(needs - has) for has in shared.values()), key=len)
        lacking = ", ".join(f"`{need}`" for need in fewest)
        alone = f"in simulation alone: no platform has {lacking}"
        rows.append((f"`{row['name']}`", "; ".join(words) or alone))
    yield _table(("pattern or mission", "runs on"), rows)


def _provided(platform: Platform, *options: str) -> frozenset[str]:
    """What a robot of the platform provides with those of its drivers that take the options."""
    provided = platform.provides
    for driver in platform.drivers:
        given = {
            "platform": platform.name,
            "driver": driver,
            "driver_options": dict.fromkeys(options, "pose"),
        }
        settings = load_daemon_settings(None, {"id": "r1", **given}, {"HOME": "/"})
        with suppress(ConfigError):
            make_driver(settings)
            provided |= settings.platform.provides
    return provided


def _all_or(names: Sequence[str], platforms: Sequence[Platform]) -> str:
    return f"all {len(names)}" if len(names) == len(platforms) else ", ".join(names)


def _first_outcome(text: str) -> tuple[str, str, str, str]:
    """The cells what, wanted, reached and from of the first row of the first table of a page.

    Empty without a table.
    """
    lines = [line.strip()[1:-1] for line in text.splitlines() if line.startswith("|")]
    table = [[cell.strip() for cell in line.split(" | ")] for line in (*lines[:1], *lines[2:3])]
    if len(table) < 2 or "wanted" not in table[0][:-1] or len(table[0]) != len(table[1]):
        return "", "", "", ""
    heads, cells = table
    at = heads.index("wanted")
    return cells[0], cells[at], cells[at + 1], cells[-1] if heads[-1] == "from" else ""


def platforms() -> Iterator[str]:
    """The figures of each platform, then the keys of a platform's file."""
    yield "## Shipped platforms"
    rows = []
    for name in platform_names():
        platform = load_platform(name)
        length, width = platform.footprint.max(axis=0) - platform.footprint.min(axis=0)
        description = platform_sources(name)[0][1].get("description", "")
        rows.append(
            (
                f"`{name}`",
                str(description),
                f"{platform.limits.linear:g}, {platform.limits.angular:g}",
                f"{length:.3g} x {width:.3g}",
                str(len(platform.scan.bearings)),
                f"{platform.scan.rate:g}",
                f"{platform.scan.range_min:g} to {platform.scan.range_max:g}",
            )
        )
    heads = ("platform", "robot", "limits [m/s, rad/s]", "outline [m]")
    yield _table((*heads, "rays", "scans [Hz]", "ranges [m]"), rows)
    yield "## Keys of the file"
    yield from _schema("", PlatformFile)
    yield from _schema("limits", Limits)
    yield from _schema("scan", ScanSection)
    yield from _schema("scan.sweep", SweepSection)
    yield from _schema("heights", Heights)
    yield from _schema("sensors.NAME", SensorSection)
    yield from _schema("protection", ProtectionSection)
    yield from _schema("protection.barrier", BarrierSettings)
    yield from _schema("protection.stop_zone", StopZoneSettings)
    yield from _schema("protection.presets.NAME", PotentialFieldSettings)


def settings() -> Iterator[str]:
    """The keys of the files of a swarm and of a daemon."""
    yield from _schema("", DaemonFile, RobotSettings)
    yield from _schema("goal", GoalSection)
    yield from _schema("parameters", ParametersSection)
    yield from _schema("touch.PATTERN", TouchSection)
    yield from _schema("fence", FenceSettings)
    yield from _schema("on_low_battery", LowBatterySettings)
    yield from _schema("neighbors", NeighborSettings)
    yield from _schema("recording", RecordingSection)


def driver_options() -> Iterator[str]:
    """The options common to all drivers, and those of the drivers that need no robot."""
    yield from _schema("All drivers", BaseOptions)
    yield from _schema("simulated", SimulatedOptions)
    yield from _schema("replay", ReplayOptions)


def ros_options() -> Iterator[str]:
    """The options of the drivers for ROS: those of all, then those of each."""
    yield from _schema("All drivers for ROS", TopicOptions)
    yield from _schema("ros2dds and rmw_zenoh", RosOptions, beyond=TopicOptions)
    yield from _schema("rmw_zenoh", RmwOptions, beyond=RosOptions)
    yield from _schema("ros1", Ros1Options, beyond=TopicOptions)


def mixed() -> Iterator[str]:
    """What protection of each platform sees, and what it assumes, of each platform as a peer."""
    speeds = {name: assumed_speed(load_platform(name)) for name in platform_names()}
    bodies = {name: body_of(load_platform(name)) for name in platform_names()}
    rows = []
    for name, own in bodies.items():
        speed = speeds[name]
        unseen = [f"`{peer}`" for peer, body in bodies.items() if not sees(own, body)]
        faster = [
            f"`{peer}`"
            for peer, body in bodies.items()
            if speed is not None and body.surface_speed > speed
        ]
        rows.append(
            (
                f"`{name}`",
                f"{own.scan_plane:.3f}",
                f"{own.lowest:.3f} to {own.highest:.3f}",
                f"{own.surface_speed:.2f}",
                "nothing" if speed is None else f"{speed:.2f}",
                "any platform" if len(unseen) == len(bodies) else ", ".join(unseen) or "-",
                ", ".join(faster) or "-",
            )
        )
    heads = ("platform", "scan plane [m]", "opaque [m]", "`surface_speed` [m/s]")
    yield _table((*heads, "assumes [m/s]", "does not see", "assumes less than the speed of"), rows)


def distances() -> Iterator[str]:
    """The distance from walls at which a robot of each platform may be set down."""
    rows = []
    for name in platform_names():
        platform = load_platform(name)
        found = set_down(platform, narrowest_passage(make_mode(platform)))
        if found is not None:
            around = "-" if found.lidar is None else f"{found.lidar:.2f} m"
            rows.append((f"`{name}`", centimetres(found.gap), around, centimetres(found.unseen)))
    yield _table(("platform", "from walls", "free around the lidar", "assumed unseen"), rows)


def rules() -> Iterator[str]:
    """The rules of the tests, with the numbers of sequences and histories that judged each.

    Then the searches through sequences.
    """
    figures = read_figures()
    searches = [
        (subject, name, found)
        for subject, by_name in figures.items()
        for name, found in by_name.items()
    ]
    rows = []
    for rule in RULES.values():
        count = sum(found.judged.get(rule.name, 0) for _, _, found in searches)
        histories = f"{rule.histories:,}" if rule.functions else "-"
        rows.append((f"`{rule.name}`", rule.sentence, f"{count:,}" if count else "-", histories))
    yield _table(("rule", "what holds", "sequences", "histories"), rows)
    found_rows = [
        (
            f"{subject}, {name}",
            f"{found.actions}",
            f"{found.depth}",
            f"{found.sequences:,}",
            f"{found.violations:,}",
        )
        for subject, name, found in searches
    ]
    yield _table(("search", "actions", "longest", "sequences", "break a rule"), found_rows)


def words() -> Iterator[str]:
    """What the words of an operator mean to the robots whose platform files say so."""
    for name in platform_names():
        for driver, meanings in load_platform(name).words.items():
            rows = [(f"`{word}`", meaning) for word, meaning in meanings.items()]
            yield _table(("word", f"a {name} of driver {driver}"), rows)


def scenarios() -> Iterator[str]:
    """Each shipped scenario, then the keys of a scenario's file."""
    yield "## Shipped scenarios"
    rows = []
    for name in scenario_names():
        scenario = load_scenario(name)
        run = {str(group["pattern"]) for group in scenario.effective["groups"].values()}
        description = " ".join(scenario.description.split())
        cells = (
            str(len(scenario.robots)),
            f"{scenario.duration:g}",
            ", ".join(sorted(run)),
            description,
        )
        rows.append((f"`{name}`", *cells))
    yield _table(("scenario", "robots", "duration [s]", "pattern", "description"), rows)
    yield "## Keys of the file"
    yield from _schema("", ScenarioFile)
    yield from _schema("groups.NAME", GroupSection)
    yield from _schema("start", StartSection)
    yield from _schema("arena", ArenaSection)
    yield from _schema("arena.boxes", BoxSection)
    yield from _schema("arena.poles", PoleSection)
    yield from _schema("arena.segments", SegmentSection)
    yield from _schema("items", ItemKind)
    for kind in get_args(Field):
        yield from _schema(f"fields, kind {kind.__struct_config__.tag}", kind)
    yield from _schema("fields, kind floor: patches", Patch)
    yield from _schema("events", EventSection)
    for fault in FAULTS:
        yield from _schema(
            f"events, fault: {{{fault.place}: {fault.__struct_config__.tag}}}", fault
        )
    yield from _schema("radio", RadioSettings)
    yield from _schema("realism.lidar", LidarNoise)
    yield from _schema("realism.odometry", OdometryNoise)
    yield from _schema("realism.actuation", Actuation)


def metrics() -> Iterator[str]:
    """All metrics of a run."""
    rows = [(f"`{m.name}`", m.meaning, m.unit, m.better or "", m.source) for m in METRICS.values()]
    heads = ("meaning", "unit", "better", "source")
    yield _table(("metric", *heads), rows)
    yield (
        "Names with a place or a number are computed where they are asked for. AREA is"
        " `disc:x:y:radius` or `box:x:y:length:width` in m; several areas follow each other."
    )
    rows = [(f"`{m.usage}`", m.meaning, m.unit, m.better, m.source) for m in KINDS.values()]
    yield _table(("name", *heads), rows)


def benchmark_tasks() -> Iterator[str]:
    """The tasks of the benchmark suite."""
    for name in task_names():
        task = load_scenario(name)
        yield f"### {task.name}"
        yield prose(" ".join(task.description.split()))
        groups = ", ".join(name for name, g in task.effective["groups"].items() if not g["pattern"])
        about = {
            "robots": f"{len(task.robots)}, of which `{groups}` run the pattern",
            "time budget": f"{task.duration:g} s",
            "metric": f"`{task.effective['metric']}`",
            "patterns": ", ".join(f"`{pattern}`" for pattern in task.effective["patterns"]),
        }
        yield _table(("key", "value"), list(about.items()))


def commands() -> Iterator[str]:
    """Both programs, each verb with its arguments and options."""
    yield from _command(swarmd, "swarmd", None)
    sections: dict[str, list[str]] = defaultdict(list)
    for name, verb in cli.all_verbs().items():
        sections[verb.section].append(f"[{name}](#swarmctl-{name})")
    yield "\n".join(f"- {title}: {', '.join(names)}" for title, names in sections.items())
    yield from _command(cli, "swarmctl", None)


def reasons() -> Iterator[str]:
    """The sentence of each reason, as `describe` prints it, without its details."""
    known = {"robot": "ROBOT", "late": "much", "peer": "a peer is not seen, or is too fast"}
    filled = defaultdict(str, known)
    rows = [(f"`{reason}`", text.format_map(filled)) for reason, text in SENTENCES.items()]
    yield _table(("reason", "meaning and remedy"), rows)


def keys() -> Iterator[str]:
    """The keys of a robot: content, rate, and which roles links let pass in a secured swarm."""
    yield "## What robots publish"
    rows = [
        (
            f"`state/{row.name}`",
            f"`{row.content.__name__}`",
            row.rate,
            row.text,
            _roles(STATE, row.name, "declare_subscriber"),
        )
        for row in PUBLISHED.values()
    ]
    yield _table(("key", "content", "rate, while somebody subscribes", "what", "may read"), rows)
    yield "## What robots answer"
    answered = [
        (f"`state/{name}`", "nothing", f"`{kind.__name__}`", "", _roles(STATE, name, "query"))
        for name, kind in ANSWERED.items()
    ]
    asked = [
        (
            f"`control/{row.name}/ASKER`",
            f"`{row.asked.__name__}`" if row.asked.__struct_fields__ else "nothing",
            f"`{row.answer.__name__}`",
            COMMANDS[row.name].text if row.name in COMMANDS else "",
            _roles(CONTROL, row.name, "query"),
        )
        for row in VERBS.values()
    ]
    shared = [
        (f"`shared/{name}/ASKER`", "a name and an offset", "bytes", text, _roles(SHARED, name))
        for name, text in HANDED_OVER.items()
    ]
    heads = ("key", "asked", "answer", "what", "may ask")
    yield _table(heads, [*answered, *asked, *shared])


def payloads() -> Iterator[str]:
    """The content of each key: an example, and its fields."""
    yield "## Content"
    known: list[type] = [published.content for published in PUBLISHED.values()]
    for row in VERBS.values():
        kinds = (row.asked, row.answer)
        known += [kind for kind in kinds if kind.__struct_fields__ and kind not in known]
    for kind in known:  # `_on_wire` appends the structs of the fields
        form = "array" if kind.__struct_config__.array_like else "map"
        yield f"### {kind.__name__}"
        yield prose(inspect.cleandoc(kind.__doc__ or ""))
        for name, published in PUBLISHED.items():
            if published.content is kind:
                yield f"`swarm/meadow/tb3-01/state/{name}`, as JSON:"
                yield f"```text\n{_example(name)}\n```"
        info = msgspec.inspect.type_info(kind)
        assert isinstance(info, msgspec.inspect.StructType)
        rows = [(f"`{field.encode_name}`", _on_wire(field.type, known)) for field in info.fields]
        if info.tag_field is not None:
            rows.insert(0, (f"`{info.tag_field}`", f"`{info.tag}`"))
        yield _table((f"field of the {form}", "type"), rows)


_OBSTACLE = {"bearing": 0.6, "gap": 0.25, "cap": 0.08}
_DECISION = {
    "mode": "barrier",
    "is_active": True,
    "requested_linear": 0.15,
    "safe_linear": 0.08,
    "rows": [_OBSTACLE],
}
_SHARED = {"robot": "tb3-01", "at": 5012.3}
_EXAMPLES: dict[str, Any] = {
    "status": {
        **{"robot": "tb3-01", "instance": "01ab", "platform": "waffle_pi", "host": "pi"},
        **{"driver": "rmw_zenoh", "profile": "field", "is_secured": True},
        **{"state": "running", "reason": None, "detail": "", "pattern": "flocking"},
        **{"generation": 3, "since": 41.5, "changed_by": "anna", "latches": {}},
        **{"labels": [], "params": {}, "report": {}, "decision": _DECISION},
        **{"epoch": {"instance": "01ab", "revision": 7}, "health": {}, "uptime": 9120.0},
    },
    "motion": [
        *_SHARED.values(),
        *(1.2, -0.4, 0.79),
        *([0.15, 0.3, 0.0], [0.08, 0.3, 0.0]),
        *(True, 0.25, [_OBSTACLE]),
    ],
    "pose": {
        **{**_SHARED, "age": 0.04, "x": 3.1, "y": 0.7, "yaw": 0.79},
        **{"error": 0.05, "yaw_error": 0.05, "frame": "hall"},
    },
    "decision": {**_SHARED, "state": "running", "reason": None, "decision": _DECISION},
    # The ranges are 1 m and 2 m; JSON has them as base64.
    "scan": [812, 1.75e9, b"\x00\x00\x80\x3f\x00\x00\x00\x40", [0.0, 0.0175], None],
    "tracks": ["tb3-01", [[0.6, 0.3, 0.1, -0.05, 0.09, "tb3-02"]]],
    "message": {**_SHARED, "channel": "voter_model/opinion", "value": 2},
    "log": {
        **{"robot": "tb3-01", "instance": "01ab", "now": 5012.3, "last": 1},
        "records": [[1, 5012.1, 20, "swarmd", "the run ended: operator"]],
    },
}
"""A payload of each key of PUBLISHED, as its fields."""


def _example(name: str) -> str:
    """A payload on `state/<name>` as JSON, the begin of a long one."""
    text = msgspec.json.encode(msgspec.convert(_EXAMPLES[name], PUBLISHED[name].content)).decode()
    return text if len(text) <= 400 else f"{text[:400]} ..."


def _roles(plane: str, name: str, message: str = "query") -> str:
    """The roles whose senders a robot's access rules let send `message` on a key of the robot."""
    roster = Roster(
        swarm="lab",
        generation=1,
        robots=("robots", "r1"),
        operators={"operators": bytes(64)},
        viewers=("viewers",),
        secret_digest=bytes(32),
    )
    access = robot_access(roster, "r1")
    names = {section["id"]: section["cert_common_names"] for section in access["subjects"]}
    rules = {section["id"]: section for section in access["rules"]}
    roles = []
    for role in ("operators", "viewers", "robots"):
        key = zenoh.KeyExpr(build("lab", "r1", plane, name, role if plane != STATE else ""))
        passing = [rules[section["rules"][0]] for section in access["policies"]
                   if role in names[section["subjects"][0]]]  # fmt: skip
        if any(
            message in rule["messages"]
            and "ingress" in rule["flows"]
            and any(zenoh.KeyExpr(own).includes(key) for own in rule["key_exprs"])
            for rule in passing
        ):
            roles.append(role)
    return ", ".join(roles)


def _on_wire(kind: msgspec.inspect.Type, known: list[type]) -> str:
    """The type of a field, in words; a struct is named, and added to `known`."""
    match kind:
        case msgspec.inspect.Metadata(type=inner, extra=words):
            unit = (words or {}).get("unit")
            return f"{_on_wire(inner, known)}, in {unit}" if unit else _on_wire(inner, known)
        case msgspec.inspect.StructType(cls=cls):
            if cls not in known:
                known.append(cls)
            return f"`{cls.__name__}`"
        case msgspec.inspect.UnionType(types=types):
            return " or ".join(dict.fromkeys(_on_wire(part, known) for part in types))
        case (
            msgspec.inspect.ListType(item_type=item) | msgspec.inspect.VarTupleType(item_type=item)
        ):
            return f"list of {_on_wire(item, known)}"
        case msgspec.inspect.TupleType(item_types=items):
            return f"[{', '.join(_on_wire(part, known) for part in items)}]"
        case msgspec.inspect.DictType(value_type=value):
            return f"map of text to {_on_wire(value, known)}"
        case msgspec.inspect.EnumType(cls=cls):
            return (
                f"text: `{cls.__name__}`"
                if len(cls) > 5
                else _one_of(member.value for member in cls)
            )
        case msgspec.inspect.LiteralType(values=values):
            return _one_of(values)
        case msgspec.inspect.NoneType():
            return "nil"
        case msgspec.inspect.BytesType():
            return "bytes"
        case msgspec.inspect.FloatType():
            return "number"
        case msgspec.inspect.IntType():
            return "integer"
    return _accepted(kind)


def _one_of(values: Iterable[object]) -> str:
    return "one of " + ", ".join(f"`{value}`" for value in values)


def api() -> Iterator[str]:
    """What authors of patterns import."""
    yield from module("swarmd.api")


def fields(kind: type) -> Iterator[str]:
    """The fields of a value that a pattern takes or gives."""
    bullets = _bullets(inspect.cleandoc(kind.__doc__ or ""))
    rows = [
        (f"`{name}`", f"`{annotation}`".replace(" | ", "` or `"), bullets[name])
        for name, annotation in inspect.get_annotations(kind).items()
    ]
    yield _table(("field", "type", "meaning"), rows)


def values() -> Iterator[str]:
    """The values inside of inputs, each with its fields."""
    rows = []
    for kind in (Odometry, Pose, Neighbor, Message, Detection):
        names = ", ".join(f"`{name}`" for name in inspect.get_annotations(kind))
        rows.append((f"`{kind.__name__}`", names, (kind.__doc__ or "").partition("\n")[0]))
    yield _table(("value", "fields", "meaning"), rows)


def testing() -> Iterator[str]:
    """Contracts and rigs."""
    yield from module("swarmd.testing.pattern_contract", ["PatternContract"])
    yield from module("swarmd.testing.driver_contract", ["DriverContract"])
    yield from module("swarmd.testing.scans")


def experiments() -> Iterator[str]:
    """Experiments from Python."""
    yield from module("swarmd.sim.experiments.simulate", ["simulate"])
    yield from module("swarmd.sim.experiments.tune", ["tune", "Tuning", "Candidate"])
    yield from module("swarmd.sim.experiments.results", ["Results", "Traces", "load_results"])
    yield from module("swarmd.sim.experiments.statistics", ["Summary", "Interval"])
    yield from module("swarmd.sim.trace")
    yield from module("swarmd.sim.metrics.own", ["metric"])
    yield from module("swarmd.sim.metrics.metric", ["Metric"])
    yield from module("swarmd.sim.learning.environment", ["env", "SwarmEnv"])
    yield from module("swarmd.sim.learning.rewards", ["State"])
    yield from module("swarmd.sim.learning.vector", ["vector_env", "JointEnv"])
    yield from module("swarmd.kit.observation")
    yield from module("swarmd.kit.policy_network")


def python() -> Iterator[str]:
    """The live client."""
    yield from module("swarmd.operator.client.connect", ["connect", "Connection"])
    yield from module("swarmd.operator.client.swarm", ["Swarm"])
    yield from module("swarmd.operator.client.async_swarm", ["AsyncSwarm"])
    yield from module("swarmd.operator.verbs.members.ask", ["Members", "Description"])
    yield from module("swarmd.operator.session.states", ["RobotState"])
    yield from module("swarmd.operator.verbs.events.feed", ["EventLine"])
    yield from module("swarmd.operator.verbs.push.ask", ["PushOutcome"])
    yield from module("swarmd.operator.verbs.acceptance.ask", ["Accepted"])
    yield from module("swarmd.operator.verbs.acceptance.talk", ["Question"])
    yield from module("swarmd.operator.verbs.incidents.ask", ["MarkOutcome"])
    yield from module("swarmd.operator.verbs.record.ask", ["Fetched", "FetchedFile"])
    yield from module("swarmd.operator.session.outcome", ["Outcome"])
    yield from module("swarmd.sim.live.simulated_swarm", ["demo", "SimulatedSwarm"])


PARTS: dict[str, Callable[[], Iterable[str]]] = {
    "patterns": patterns,
    "comparison": comparison,
    "films": films,
    "runs_on": runs_on,
    "platforms": platforms,
    "settings": settings,
    "driver_options": driver_options,
    "ros_options": ros_options,
    "mixed": mixed,
    "set_down": distances,
    "rules": rules,
    "words": words,
    "scenarios": scenarios,
    "metrics": metrics,
    "benchmark_tasks": benchmark_tasks,
    "commands": commands,
    "reasons": reasons,
    "keys": keys,
    "payloads": payloads,
    "inputs": lambda: fields(Inputs),
    "context": lambda: fields(Context),
    "scan": lambda: fields(Scan),
    "values": values,
    "outputs": lambda: fields(Outputs),
    "twist": lambda: fields(Twist),
    "api": api,
    "testing": testing,
    "experiments": experiments,
    "python": python,
    **driver_messages.PARTS,
}
"""The parts by the name in their pages."""


@cache
def part(name: str) -> str:
    """The Markdown of a part."""
    return "\n\n".join(filter(None, PARTS[name]()))


def filled(text: str) -> str:
    """The text of a page with its parts."""
    return _PART.sub(lambda line: part(line[1]), text)


def kept(text: str) -> str:
    """The text of a page in which the parts that it keeps are those of the code."""
    return _KEPT.sub(lambda found: f"{found[1]}\n{part(found[2])}\n\n", text)


def public_names() -> str:
    """A line with the signature or the fields of each public class, function, command and key."""
    lines = []
    for name in _NAMED:
        text = part(name)
        lines.append(f"[{name}]")
        sections = [*_SECTION.finditer(text)]
        for section, following in zip_longest(sections, sections[1:]):
            title, code = section[1], " ".join((section[2] or "").split())
            body = text[section.end() : following.start() if following else len(text)]
            rows = [line[2:-2].split(" | ") for line in body.splitlines() if line[:1] == "|"]
            shown = [head not in _EXPLAINED for head in rows[0]] if rows else []
            taken = [" ".join(compress(row, shown)) for row in rows[2:]]
            taken = [re.sub(r"[`\\]", "", entry) for entry in taken]
            if sum(shown) > 2:  # keys, each with its content and its readers
                lines += taken
            elif code or taken:
                owner = f"{title}: " if "." in title else ""
                lines.append(": ".join(filter(None, (owner + (code or title), ", ".join(taken)))))
    return "\n".join(lines) + "\n"


def _command(command: click.Command, path: str, parent: click.Context | None) -> Iterator[str]:
    ctx = click.Context(command, info_name=path.rpartition(" ")[2], parent=parent)
    yield f"{'#' * (path.count(' ') + 2)} {path}"
    yield f"```text\n{path} {' '.join(command.collect_usage_pieces(ctx))}\n```"
    text = inspect.cleandoc(command.help or "").replace("\b\n", "")
    yield prose(text)
    records = (option.get_help_record(ctx) for option in command.params)
    rows = [(f"`{names}`", text) for names, text in filter(None, records)]
    if rows:
        yield _table(("option", "meaning"), rows)
    if command.epilog:
        yield f"```text\n{inspect.cleandoc(command.epilog.replace(chr(8), ''))}\n```"
    if isinstance(command, click.Group):
        for name in command.list_commands(ctx):
            verb = command.get_command(ctx, name)
            if verb is not None and not verb.hidden:
                yield from _command(verb, f"{path} {name}", ctx)


def _schema(
    where: str,
    kind: type[msgspec.Struct],
    *explained: type[msgspec.Struct],
    beyond: type[msgspec.Struct] | None = None,
) -> Iterator[str]:
    """A table of the keys of a section: what each accepts, its default and its meaning.

    `explained`: further classes whose docstrings explain keys. `beyond`: without its keys.
    """
    explaining = (*explained, *reversed(kind.__mro__))
    yield f"### {where}" if where else "### The whole file"
    text = inspect.cleandoc(kind.__doc__ or "")
    bullets = {
        name: meaning
        for base in explaining
        for name, meaning in _bullets(inspect.cleandoc(base.__doc__ or "")).items()
    }
    yield prose(re.sub(r"\n*^- `(?:.|\n  )*", "", text, flags=re.MULTILINE))
    comments = {name: meaning for base in explaining for name, meaning in _comments(base).items()}
    left_out = beyond.__struct_fields__ if beyond else ()
    info = msgspec.inspect.type_info(kind)
    assert isinstance(info, msgspec.inspect.StructType)
    rows = [
        (
            f"`{field.encode_name}`",
            bullets.get(field.name) or comments.get(field.name, ""),
            _accepted(field.type),
            "required" if field.required else _shown_default(field),
        )
        for field in info.fields
        if field.name not in left_out
    ]
    if any(row[1] for row in rows):
        yield _table(("key", "meaning", "accepted", "default"), rows)
    else:
        yield _table(("key", "accepted", "default"), [(row[0], *row[2:]) for row in rows])


def _bullets(text: str) -> dict[str, str]:
    """The meaning of each name in the bullets of a docstring."""
    return {
        name: " ".join(meaning.split())
        for names, meaning in re.findall(r"^- (`.+?): ((?:.|\n  )*)", text, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", names)
    }


@cache
def _comments(kind: type) -> dict[str, str]:
    """The comment above each field of a class."""
    comments: dict[str, str] = {}
    above: list[str] = []
    if kind in (object, msgspec.Struct) or kind.__name__.startswith("_"):
        return comments  # no source: built in, or made by `defstruct`
    for line in inspect.getsource(kind).splitlines():
        text = line.strip()
        if text.startswith("#"):
            above.append(text.removeprefix("#").strip())
            continue
        name = re.match(r"(\w+):", text)
        if name and above:
            comments[name[1]] = " ".join(above)
        above = []
    return comments


def _accepted(kind: msgspec.inspect.Type) -> str:
    """What a key accepts, in words."""
    match kind:
        case msgspec.inspect.UnionType(types=types):
            listed = [part for part in types if not isinstance(part, msgspec.inspect.NoneType)]
            return " or ".join(dict.fromkeys(map(_accepted, listed)))
        case msgspec.inspect.FloatType() | msgspec.inspect.IntType():
            word = "integer" if isinstance(kind, msgspec.inspect.IntType) else "number"
            above = f" from {kind.ge:.7g}" if kind.ge is not None else ""
            above = f" above {kind.gt:.7g}" if kind.gt is not None else above
            return word + above + (f" to {kind.le:.7g}" if kind.le is not None else "")
        case msgspec.inspect.LiteralType(values=values):
            return "one of " + ", ".join(f"`{part}`" for part in values)
        case (
            msgspec.inspect.ListType(item_type=item) | msgspec.inspect.VarTupleType(item_type=item)
        ):
            return f"list of: {_accepted(item)}"
        case msgspec.inspect.TupleType(item_types=items):
            return "[" + ", ".join(map(_accepted, items)) + "]"
        case msgspec.inspect.DictType() | msgspec.inspect.StructType():
            return "a section"
        case msgspec.inspect.BoolType():
            return "true or false"
        case msgspec.inspect.StrType():
            return "text"
    return "any value"


def _shown_default(field: msgspec.inspect.Field) -> str:
    value: Any = field.default
    if field.default_factory is not msgspec.NODEFAULT:
        value = field.default_factory()
    if value is None or value in ("", [], {}, ()) or isinstance(value, msgspec.Struct):
        return ""
    return f"`{str(value).lower()}`" if isinstance(value, bool) else f"`{value}`"


def _default(spec: dict[str, Any]) -> str:
    return "required" if spec["is_required"] else f"`{short_number(spec['default'])}`"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    def line(cells: Iterable[str]) -> str:
        return (
            "| " + " | ".join(prose(" ".join(c.replace("|", "\\|").split())) for c in cells) + " |"
        )

    return "\n".join([line(heads), "|" + "---|" * len(heads), *map(line, rows)])


if __name__ == "__main__":
    if "--names" in sys.argv:
        NAMES.write_text(public_names())
    else:
        for page in (
            *ROOT.glob("*.md"),
            *ROOT.glob("docs/**/*.md"),
            *ROOT.glob("patterns/**/*.md"),
            ROOT / "benchmarks/README.md",
        ):
            text = page.read_text()
            renewed = kept(text)
            if renewed != text:
                page.write_text(renewed)
                print("written again:", page.relative_to(ROOT))
            copy = ROOT / "build/pages" / page.relative_to(ROOT)
            copy.parent.mkdir(parents=True, exist_ok=True)
            copy.write_text(filled(renewed))
        print("the pages with their parts: build/pages, such as build/pages/docs/reference/api.md")
