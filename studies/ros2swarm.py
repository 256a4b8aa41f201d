"""ROS2swarm's own nodes, unmodified: `python -m studies.ros2swarm SOURCE`.

SOURCE: the folder `src` of a checkout of github.com/ROS2swarm/ROS2swarm (Apache-2.0), which is not
kept here. The figures of docs/ros2_nodes.md are of commit
df3aba185f2e355e7fba4bfe2333c95afc6d6f6d. Runs experiment 1 of Kaiser et al., ICRA 2022, in the
paper's hardware arena with their nodes: behind their protection and ours, behind ours alone, and
behind theirs alone. The controls are robots that do not move (docs/paper.md). `--patterns` runs
each of their patterns on each platform instead.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.table import markdown
from studies import keeper, kept, paper
from swarmd.settings import yamlfile
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.scenarios.scenariofile import load_scenario

SECONDS = 12.0
"""Of a run of `--patterns`: their timers of 5 s are over, and a robot has met a wall or not."""
COMMIT = "df3aba185f2e355e7fba4bfe2333c95afc6d6f6d"
PLATFORMS = ("burger", "waffle_pi", "jackal")
BOTH = "both"
OURS = "ours alone"
THEIRS = "theirs alone"
PROTECTIONS = (BOTH, OURS, THEIRS)
CHAIN = {"layout": "chain", "near": 0.62, "far": 0.8}
FREE = {"layout": "random", "clearance": 0.75}
"""The two starts of the hardware arena, as in config/scenarios."""
OFF: Mapping[str, Any] = {"protection": {"mode": "off"}}
RANGE = {"attraction_max_range": 0.8}
"""In the paper's hardware arena: their file has "0.8 on turtle"."""


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
    if not (folder / SOURCE).exists():
        (folder / SOURCE).symlink_to(source.absolute())
    path = folder / f"{pattern}_{protection.replace(' ', '_')}.yaml"
    path.write_text(yamlfile.text_of(launch(pattern, protection, values)))
    return path.absolute()


def experiment(
    source: Path, folder: Path, name: str, protection: str, seeds: range, jobs: int
) -> Results:
    """Experiment 1 in a start of the hardware arena (`paper.HARDWARE`) with their attraction."""
    path = write_launch(folder, source, "attraction", protection, RANGE)
    start = {"hardware": CHAIN, "hardware_free": FREE}[name]
    scenario: dict[str, Any] = {
        "extends": "paper_exp1_waffle_pi",
        "arena": {"size": [6.6, 4.8]},
        "groups": {
            "all": {
                "pattern": "ros2_nodes",
                "parameters": {"launch": str(path)},
                "start": start,
            }
        },
    }
    if protection == THEIRS:
        scenario["platforms"] = {"waffle_pi": {"extends": "waffle_pi", **OFF}}
    file = folder / f"{name}_{protection.replace(' ', '_')}.yaml"
    file.write_text(yamlfile.text_of(scenario))
    return simulate(
        str(file),
        seeds,
        sweep={"lidar_visibility": ["body"]},
        jobs=jobs,
        out=folder / f"{len(seeds)}-{name}-{protection.replace(' ', '_')}",
        on_progress=kept.on_progress(f"{name}, {protection}"),
    )


def experiments(source: Path, folder: Path, options: argparse.Namespace) -> str:
    """The table of experiment 1, with the columns of docs/paper.md."""
    seeds = paper.HARDWARE_SEEDS[: options.seeds]
    rows = []
    for protection in options.protections:
        for name in options.starts:
            results = experiment(source, folder, name, protection, seeds, options.jobs)
            variant = results.variants[0]
            cells = [cell(results, variant, name) for _, cell in paper.TOGETHER]
            failed = len(results.failures)
            duty = paper.median(results.metric("protection_duty_late", variant))
            rows.append([f"{name}, {protection}", *cells, duty, str(failed)])
    heads = [head for head, _ in paper.TOGETHER]
    return markdown([["", *heads, "late duty of ours", "failed runs"], *rows])


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


def main() -> None:
    """Do the runs and print the table; the same command resumes."""
    parser = argparse.ArgumentParser(prog="python -m studies.ros2swarm", description=__doc__)
    parser.add_argument("source", type=Path, help="the folder src of a checkout of ROS2swarm")
    parser.add_argument("--seeds", type=int, default=len(paper.HARDWARE_SEEDS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--starts", nargs="+", default=list(paper.HARDWARE[::-1]))
    parser.add_argument("--protections", nargs="+", default=list(PROTECTIONS), choices=PROTECTIONS)
    parser.add_argument("--patterns", action="store_true", help="each pattern on each platform")
    options = parser.parse_args()
    source = options.source.absolute()
    folder = keeper.experiment_folder("ros2swarm")
    made = pattern_runs if options.patterns else experiments
    part = "ros2swarm_patterns" if options.patterns else "ros2swarm_hardware"
    kept.print_parts({part: made(source, folder, options)})


if __name__ == "__main__":
    main()
