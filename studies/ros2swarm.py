"""ROS2swarm's own nodes, unmodified: `python -m studies.ros2swarm [SOURCE]`.

SOURCE: the folder `src` of a checkout of github.com/ROS2swarm/ROS2swarm (Apache-2.0), which is not
kept here; by default the folder that the variable SWARMD_ROS2SWARM names. The figures of
docs/ros2_nodes.md are of commit df3aba185f2e355e7fba4bfe2333c95afc6d6f6d. Runs experiment 1 of
Kaiser et al., ICRA 2022, in the paper's arenas: their nodes behind our protection, behind theirs
and ours, our rewrite of their equations, our law, and robots that do not move. The same command
resumes. `--patterns` runs each of their patterns on each platform instead.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from msgspec import Struct

from benchmarks.table import markdown
from studies import keeper, kept, paper
from studies.keeper import Traced, traced
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.pin import restart_pinned
from swarmd.core.values import Array
from swarmd.settings import yamlfile
from swarmd.sim.lockstep.lockstep import Lockstep, simulate_run
from swarmd.sim.metrics import aggregation, window
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario

VARIABLE = "SWARMD_ROS2SWARM"
"""The variable with the folder of the sources."""
SECONDS = 12.0
"""Of a run of `--patterns`: their timers of 5 s are over, and a robot has met a wall or not."""
COMMIT = "df3aba185f2e355e7fba4bfe2333c95afc6d6f6d"
PLATFORMS = ("burger", "waffle_pi", "jackal")
BOTH = "both"
OURS = "ours alone"
THEIRS = "theirs alone"
PROTECTIONS = (BOTH, OURS, THEIRS)
OFF: Mapping[str, Any] = {"protection": {"mode": "off"}}
RANGE = {"attraction_max_range": 0.8}
"""In the paper's hardware arena: their file has "0.8 on turtle"."""

ARENAS: Mapping[str, str] = {
    "hardware_free": "paper_exp1_hardware_free",
    "hardware": "paper_exp1_hardware",
    "arena": "paper_exp1_waffle_pi",
}
"""The scenarios of the paper with seven Waffle Pis: two starts of its arena of hardware, and its
arena of 18 x 18 m, where their file has a range of 2 m."""
SEEDS: Mapping[str, Sequence[int]] = {
    "hardware_free": paper.HARDWARE_SEEDS,
    "hardware": paper.HARDWARE_SEEDS,
    "arena": (*paper.SEEDS, *paper.FRESH),
}
PLATFORM = "waffle_pi"
NODES: Mapping[str, str] = {"nodes": OURS, "nodes_both": BOTH, "nodes_theirs": THEIRS}
"""The rows with their own attraction node, with what protects."""
ROWS: Mapping[str, str] = {
    "nodes": "their own node",
    "paper": "our rewrite of its equations (law `paper`)",
    "nodes_both": "their own node, their protection and ours",
    "nodes_theirs": "their own node, their protection alone",
    "settling": "ours (law `settling`)",
    "still": "nobody: robots that do not move",
}
TABLE = ("nodes", "paper", "nodes_both", "settling", "still")
"""The rows of the page."""
FEWER = {"hardware_free": 25, "hardware": 25, "arena": 6}
"""The seeds of the row whose runs take the longest, `nodes_both`: 70 s of processor time each."""


class Node(NamedTuple):
    """A node of ROS2swarm below `ros2swarm`, and its file below `config/<platform>`."""

    module: str
    file: str
    remap: Mapping[str, str] = {}


_BASIC = "movement_pattern.basic"
_COMBINED_FILE = "movement_pattern/combined/discussed_dispersion_pattern.yaml"


def _basic(name: str) -> list[Node]:
    return [Node(f"{_BASIC}.{name}", f"movement_pattern/basic/{name}.yaml")]


def _voting(name: str) -> list[Node]:
    return [Node(f"voting_pattern.basic.{name}", f"voting_pattern/basic/{name}.yaml")]


PATTERNS: Mapping[str, list[Node]] = {
    "attraction": _basic("attraction_pattern"),
    "dispersion": _basic("dispersion_pattern"),
    "drive": _basic("drive_pattern"),
    "random_walk": _basic("random_walk_pattern"),
    "minimalist_flocking": _basic("minimalist_flocking_pattern"),
    "majority_rule": _voting("majority_rule_pattern"),
    "attraction2": _basic("attraction_pattern2"),
    "rat_search": _basic("rat_search_pattern"),
    "magnetometer": _basic("magnetometer_pattern"),
    "aggregation": _basic("aggregation_pattern"),
    "discussed_dispersion": [
        Node("movement_pattern.combined.discussed_dispersion_pattern", _COMBINED_FILE),
        Node(
            f"{_BASIC}.dispersion_pattern",
            _COMBINED_FILE,
            {
                "max_distance": "dispersion_distance",
                "drive_command": "drive_command_dispersion_pattern",
            },
        ),
        Node("voting_pattern.basic.majority_rule_pattern", _COMBINED_FILE),
    ],
    "voter_model": _voting("voter_model_pattern"),
    "voter_model_with_limiter": _voting("voter_model_with_limiter_pattern"),
}
"""As their launch files start them."""


SOURCE = "src"
"""The link to the sources beside the launch files."""


def launch(
    pattern: str, protection: str = BOTH, values: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The launch file of a pattern of theirs; `values`: parameters in place of those of the file.

    Their protection stands between the pattern and the base, unless it is `ours alone`. The
    Jackal's folder has no file of the sensor: it has that of the Limo.
    """
    package = f"{SOURCE}/ros2swarm"
    config = f"{package}/config/{{platform}}"
    has_theirs = protection != OURS
    nodes: list[dict[str, Any]] = [
        {
            "run": "ros2swarm.sensor_layer.lidar_layer",
            "parameters": [f"{package}/config/limo/sensor_specification.yaml"],
        }
    ]
    if has_theirs:
        nodes.append(
            {
                "run": "ros2swarm.hardware_protection_layer",
                "parameters": [f"{config}/hardware_protection_layer.yaml"],
            }
        )
    nodes += [
        {
            "run": f"ros2swarm.{node.module}",
            "parameters": [f"{config}/{node.file}", dict(values or {})],
            "remap": dict(node.remap),
        }
        for node in PATTERNS[pattern]
    ]
    return {
        "path": [package, SOURCE],
        "namespace": "/robot_namespace_{number}",
        "nodes": nodes,
        "start": [
            {
                "topic": "/swarm_command",
                "type": "communication_interfaces/Int8Message",
                "values": {"data": 1},
            }
        ],
        "shared": ["/majority_broadcast", "/voting_broadcast"],
        "topics": {"command": "cmd_vel" if has_theirs else "drive_command"},
        "one_element_arrays": True,
        "log_level": "error",
    }


def write_launch(
    folder: Path,
    source: Path,
    pattern: str,
    protection: str = BOTH,
    values: Mapping[str, Any] | None = None,
) -> Path:
    """Write the launch file into `folder`; returns its path."""
    folder.mkdir(parents=True, exist_ok=True)
    with suppress(FileExistsError):
        (folder / SOURCE).symlink_to(source.absolute())
    path = folder / f"{pattern}_{protection.replace(' ', '_')}.yaml"
    text = yamlfile.text_of(launch(pattern, protection, values))
    if not path.exists() or path.read_text() != text:
        partial = path.with_name(f".{path.name}.{os.getpid()}")
        partial.write_text(text)
        partial.replace(path)  # at once: the process of another run may read it
    return path.absolute()


class Task(Struct, frozen=True, order=True, kw_only=True):
    """A run to do; `arena`: a key of ARENAS; `row`: a key of ROWS.

    `sources`: the digest of their sources; empty in a row without their nodes.
    """

    arena: str
    row: str
    seed: int
    sources: str = ""
    duration: float = 120.0


class Found(Struct, frozen=True, kw_only=True):
    """What a run gave; distances in m, `cluster` in robots at the end, `group` late."""

    start: float
    end: float
    cluster: float
    group: float
    way: float
    contacts: float
    failure: str = ""


Record: TypeAlias = keeper.Record[Task, Found]
"""A finished run."""


def source_folder(environ: Mapping[str, str] = os.environ) -> Path:
    """The folder that VARIABLE names; ConfigError in one line without their sources in it."""
    named = environ.get(VARIABLE, "")
    folder = Path(named)
    if not named or not (folder / "ros2swarm").is_dir():
        raise ConfigError(
            f"{VARIABLE}={named} names no sources of ROS2swarm; set it to the folder src of a"
            " checkout of github.com/ROS2swarm/ROS2swarm"
        )
    return folder.absolute()


@cache
def digest(source: Path) -> str:
    """The digest of their sources: 12 hexadecimal digits."""
    found = hashlib.sha256()
    for path in sorted(source.rglob("*")):
        if path.suffix in (".py", ".yaml", ".msg", ".srv"):
            found.update(f"{path.relative_to(source).as_posix()}\0".encode())
            found.update(hashlib.sha256(path.read_bytes()).digest())
    return found.hexdigest()[:12]


def scenario(task: Task, source: Path | None = None) -> Scenario:
    """The scenario of a run; `source`: their sources, for the rows with their nodes."""
    changes: dict[str, Any] = {"lidar_visibility": "body", "duration": task.duration}
    name = ARENAS[task.arena]
    if task.row not in NODES:
        return load_scenario(name, {**changes, **paper.changes(name, task.row)})
    if source is None or digest(source) != task.sources:
        raise ConfigError(
            f"the run is of other sources of ROS2swarm ({task.sources}); set {VARIABLE}"
        )
    protection = NODES[task.row]
    is_small = task.arena != "arena"
    kind = load_scenario(name).effective
    path = write_launch(
        keeper.experiment_folder("ros2swarm") / f"{task.sources}-{task.arena}",
        source,
        "attraction",
        protection,
        RANGE if is_small else None,
    )
    changes |= {
        "arena": kind["arena"],
        "groups.all.pattern": "ros2_nodes",
        "groups.all.parameters.launch": str(path),
        "groups.all.start": kind["groups"]["all"]["start"],
    }
    if protection == THEIRS:
        changes[f"platforms.{PLATFORM}.protection.mode"] = "off"
    return load_scenario(ARENAS["arena"], changes)


def perform(task: Task) -> Traced[Found]:
    """Simulate and measure a run in this process."""
    failures: list[str] = []
    source = source_folder() if task.row in NODES else None
    trace = simulate_run(scenario(task, source), task.seed, on_failure=failures.append)
    start = f"{paper.MDC}_start"
    end = f"{paper.MDC}_end"
    values = measure(
        trace, [start, end, "largest_cluster", "path_length", "robot_contacts", "arena_contacts"]
    )
    known = {name: float("nan") if one is None else one for name, one in values.items()}
    found = Found(
        start=known[start],
        end=known[end],
        cluster=known["largest_cluster"],
        group=float(aggregation.largest_cluster(window.late(trace), paper.LINK).mean()),
        way=known["path_length"],
        contacts=known["robot_contacts"] + known["arena_contacts"],
        failure="; ".join(failures),
    )
    return traced(found, trace)


def tasks(source: Path, arenas: Iterable[str], rows: Sequence[str], seeds: int = 40) -> list[Task]:
    """The runs of the tables, `seeds` of each row at most; a seed of all rows before the next."""
    made = []
    for arena in arenas:
        for number, seed in enumerate(SEEDS[arena][:seeds]):
            for row in rows:
                if row in ("nodes_both", "nodes_theirs") and number >= FEWER[arena]:
                    continue
                sources = digest(source) if row in NODES else ""
                made.append(Task(arena=arena, row=row, seed=seed, sources=sources))
    return made


HEAD = (
    *("attraction of", "runs", "six linked at 120 s", "MDC at start [m]", "at 120 s [m]"),
    *("not above start", "late largest group", "way of a robot [m]", "contacts", "failed runs"),
)


def table(records: Sequence[Record], arena: str, rows: Sequence[str]) -> str:
    """The table of an arena, with the columns of docs/paper.md."""
    lines: list[Sequence[str]] = [HEAD]
    for row in rows:
        runs = [one.found for one in records if (one.task.arena, one.task.row) == (arena, row)]
        if runs:
            lines.append((ROWS[row], *_cells(runs)))
    return markdown(lines)


def _cells(runs: Sequence[Found]) -> list[str]:
    def values(name: str) -> Array:
        return np.array([getattr(one, name) for one in runs], dtype=np.float64)

    contacts = values("contacts")
    return [
        str(len(runs)),
        paper.share(values("cluster") >= paper.ENOUGH),
        paper.median(values("start")),
        paper.median(values("end")),
        paper.share(values("end") <= values("start")),
        paper.median(values("group")),
        paper.median(values("way")),
        f"{int(contacts.sum())} in {np.count_nonzero(contacts)}",
        str(sum(bool(one.failure) for one in runs)),
    ]


def pattern_runs(source: Path, folder: Path, options: argparse.Namespace) -> str:
    """What each of their patterns does on each platform, in one run of five robots."""
    rows = [["pattern", "platform", "protection", "runs", "way of a robot [m]", "contacts"]]
    for pattern in PATTERNS:
        for platform in PLATFORMS:
            for protection in options.protections:
                path = write_launch(folder, source, pattern, protection)
                rows.append([pattern, platform, protection, *_one_run(path, platform, protection)])
                print("; ".join(rows[-1]), file=sys.stderr, flush=True)
    return markdown(rows)


def _one_run(path: Path, platform: str, protection: str) -> list[str]:
    group = {
        "platform": platform,
        "count": 5,
        "pattern": "ros2_nodes",
        "parameters": {"launch": str(path)},
    }
    scenario: dict[str, Any] = {
        "duration": SECONDS,
        "arena": {"size": [8.0, 8.0]},
        "groups": {"tb3": group},
        "start": {"layout": "random", "clearance": 0.4},
    }
    if protection == THEIRS:
        scenario["platforms"] = {platform: {"extends": platform, **OFF}}
    file = path.with_suffix(f".{platform}.scenario.yaml")
    file.write_text(yamlfile.text_of(scenario))
    try:
        swarm = Lockstep(load_scenario(str(file)), 1)
        swarm.advance(SECONDS)
    except Exception as error:  # a node may raise anything; the row has the line
        return [" ".join(str(error).split())[:200], "-", "-"]
    trace = swarm.trace()
    steps = np.diff(trace.pose[:, :, :2], axis=0)
    way = float(np.hypot(steps[..., 0], steps[..., 1]).sum(axis=0).mean())
    return [swarm.failure() or "yes", f"{way:.2f}", str(len(trace.contact_t))]


def main(words: Sequence[str] | None = None) -> None:
    """Do the runs and print the tables; the same command resumes."""
    parser = argparse.ArgumentParser(prog="python -m studies.ros2swarm", description=__doc__)
    parser.add_argument("source", nargs="?", help=f"the folder src of a checkout [${VARIABLE}]")
    parser.add_argument("--seeds", type=int, default=40, help="of each row, at most [40]")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--arenas", nargs="+", default=["hardware_free", "arena"], choices=ARENAS)
    parser.add_argument("--rows", nargs="+", default=list(TABLE), choices=ROWS)
    parser.add_argument("--protections", nargs="+", default=list(PROTECTIONS), choices=PROTECTIONS)
    parser.add_argument("--patterns", action="store_true", help="each pattern on each platform")
    options = parser.parse_args(words)
    if options.source is not None:
        os.environ[VARIABLE] = options.source  # which the processes of the runs inherit
    source = source_folder()
    if options.patterns:
        folder = keeper.experiment_folder("ros2swarm")
        kept.print_parts({"ros2swarm_patterns": pattern_runs(source, folder, options)})
        return
    wanted = tasks(source, options.arenas, options.rows, options.seeds)
    records = keeper.records(perform, wanted, jobs=options.jobs)
    kept.print_parts(
        {f"ros2swarm_{arena}": table(records, arena, options.rows) for arena in options.arenas}
    )


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    try:
        main()
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
