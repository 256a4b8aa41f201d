"""`python -m studies.safety hours | progress | one`: see docs/safety.md.

hours: robot-hours over all scenes. progress: goals reached in each mode. one: a single run with
every collision. Runs that build/safety has from the same sources are not repeated.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path

from benchmarks.table import machine
from studies.safety import hours, progress
from studies.safety.judge import Collision, collisions
from studies.safety.judgement import judge
from studies.safety.runs import Task, carry_out, rammers
from studies.safety.scenes import (
    ACCEPTANCE_SEEDS,
    DEV_SEEDS,
    FAMILIES,
    MODES,
    PLATFORMS,
    RAM,
    VISIBILITIES,
    Scene,
    scenario,
)
from swarmd.core.errors import SwarmError
from swarmd.sim.lockstep.lockstep import simulate_run

Options = argparse.Namespace


def run_hours(options: Options) -> str:
    """Robot-hours of protected swarms, then a share of them among ramming robots."""
    seeds = DEV_SEEDS if options.dev else ACCEPTANCE_SEEDS
    among = options.robot_hours / 6.0 if options.ram_hours is None else options.ram_hours
    tasks = []
    for share, families in (
        (options.robot_hours, [f for f in options.families if f != RAM]),
        (among, [f for f in options.families if f == RAM]),
    ):
        scenes = hours.cells(
            families, options.platforms, options.visibilities, options.mode, options.duration
        )
        tasks += hours.plan(share, scenes, seeds) if scenes else []
    records = carry_out(tasks, options.out / "hours.jsonl", options.jobs)
    return f"Sources {records[0].code}, {machine()}\n\n{hours.tables(records)}"


def run_progress(options: Options) -> str:
    """Goals reached in each mode, compared with ghosts."""
    seeds = (DEV_SEEDS if options.dev else ACCEPTANCE_SEEDS)[: options.seeds]
    tasks = progress.plan(
        options.families,
        options.platforms,
        options.visibilities,
        options.modes,
        seeds,
        options.duration,
    )
    records = carry_out(tasks, options.out / "progress.jsonl", options.jobs)
    return f"Sources {records[0].code}, {machine()}\n\n{progress.tables(records)}"


def run_one(options: Options) -> str:
    """One run, with every collision in it."""
    scene = Scene(
        options.family,
        options.platform,
        options.visibility,
        options.mode,
        is_sparse=options.sparse,
        duration=options.duration,
    )
    task = Task(scene, options.seed)
    trace = simulate_run(scenario(scene), task.seed)
    if options.trace is not None:
        trace.save(options.trace)
    among = rammers(trace)
    lines = [_told(one) for one in collisions(trace, among)]
    return "\n".join([f"{scene.name} seed {task.seed}", *lines, str(judge(trace, among))])


def _told(one: Collision) -> str:
    decision = (
        "ran into it"
        if one.is_hit
        else "at fault"
        if one.is_fault
        else "pushed"
        if one.is_pushed
        else "at no fault"
    )
    speed = one.pushed_speed if one.is_pushed else one.own_speed
    return f"{one.time:7.2f} s {one.a} {one.b}: {one.robot} {decision}, {100.0 * speed:.1f} cm/s"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m studies.safety", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB")
    for name, act, families, platforms in (
        ("hours", run_hours, FAMILIES, PLATFORMS),
        ("progress", run_progress, ("goals",), ("burger",)),
    ):
        verb = verbs.add_parser(name, help=act.__doc__)
        verb.set_defaults(act=act)
        verb.add_argument("--families", nargs="+", choices=FAMILIES, default=families)
        verb.add_argument("--platforms", nargs="+", choices=PLATFORMS, default=platforms)
        verb.add_argument("--visibilities", nargs="+", choices=VISIBILITIES, default=VISIBILITIES)
        verb.add_argument("--duration", type=float, default=600.0, help="of a run in s")
        verb.add_argument("--dev", action="store_true", help="seeds to work with, not to accept by")
        verb.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
        verb.add_argument("--out", type=Path, default=Path("build/safety"))
        if name == "hours":
            verb.add_argument("--robot-hours", type=float, default=300.0)
            verb.add_argument("--ram-hours", type=float, help="default: a sixth of that")
            verb.add_argument("--mode", choices=MODES, default="barrier")
        else:
            verb.add_argument("--modes", nargs="+", choices=MODES, default=progress.MODES)
            verb.add_argument("--seeds", type=int, default=5, help="how many")
    _add_one(verbs.add_parser("one", help=run_one.__doc__))
    return parser


def _add_one(verb: argparse.ArgumentParser) -> None:
    verb.set_defaults(act=run_one)
    verb.add_argument("family", choices=FAMILIES)
    verb.add_argument("platform", choices=PLATFORMS)
    verb.add_argument("visibility", choices=VISIBILITIES)
    verb.add_argument("mode", choices=MODES)
    verb.add_argument("seed", type=int)
    verb.add_argument("--sparse", action="store_true")
    verb.add_argument("--duration", type=float, default=600.0, help="in s")
    verb.add_argument("--trace", type=Path, help="where to keep the trace")


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the verb, and print its result."""
    options = _parser().parse_args(arguments)
    print(options.act(options))


if __name__ == "__main__":
    try:
        main()
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
