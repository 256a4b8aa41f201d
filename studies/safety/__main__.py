"""`python -m studies.safety VERB`: docs/evidence/safety.md and docs/evidence/beside.md.

hours: robot-hours over all scenes. progress: goals reached in each mode. encounters: how robots get
past each other in each mode. beside: a robot that is set down beside a wall. held: how much of
their time robots stand that nothing but protection holds. tracks: the errors of tracks. one: a
single run with every collision and those at fault. Runs that build/safety has from the same sources
are not repeated.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from benchmarks.table import machine
from studies.kept import print_parts
from studies.safety import beside, encounters, held, hours, progress, tracking
from studies.safety.columns import COLUMNS
from studies.safety.driven import faults
from studies.safety.judge import collisions
from studies.safety.judgement import judge
from studies.safety.moved_off import moved_off
from studies.safety.runs import Task, attackers, carry_out, simulate
from studies.safety.scenes import (
    ACCEPTANCE_SEEDS,
    DEV_SEEDS,
    FAMILIES,
    MODES,
    PLATFORMS,
    VISIBILITIES,
    Scene,
    scenario,
)
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.core.pin import restart_pinned
from swarmd.settings.platforms import platform_names

Options = argparse.Namespace


def plan_hours(options: Options, seeds: Sequence[int]) -> list[Task]:
    """Robot-hours of protected swarms, a share of them among attackers."""
    is_mixed = {bool(FAMILIES[family].attack) for family in options.families} == {True, False}
    share = options.attack_share if is_mixed else 1.0
    tasks = []
    for is_attack in (False, True):
        families = [f for f in options.families if bool(FAMILIES[f].attack) == is_attack]
        scenes = hours.cells(
            families, options.platforms, options.visibilities, options.mode, options.duration
        )
        part = share if is_attack or not is_mixed else 1.0 - share
        tasks += hours.plan(part * options.robot_hours, scenes, seeds) if scenes else []
    return tasks


def plan_progress(options: Options, seeds: Sequence[int]) -> list[Task]:
    """Goals reached in each mode, compared with ghosts."""
    return progress.plan(
        options.families,
        options.platforms,
        options.visibilities,
        options.modes,
        seeds[: options.seeds],
        options.duration,
    )


def _count(text: str) -> int:
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text} is below 1")
    return int(text)


def _seed(text: str) -> int:
    if int(text) < 0:
        raise argparse.ArgumentTypeError(f"{text} is below 0")
    return int(text)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m studies.safety", description=__doc__)
    verbs = parser.add_subparsers(required=True, metavar="VERB", dest="verb")
    for name, plan, tables, families, platforms in (
        ("hours", plan_hours, hours.tables, FAMILIES, PLATFORMS),
        ("progress", plan_progress, progress.tables, ("goals",), ("burger",)),
    ):
        verb = verbs.add_parser(name, help=plan.__doc__)
        verb.set_defaults(plan=plan, tables=tables)
        verb.add_argument("--families", nargs="+", choices=FAMILIES, default=families)
        verb.add_argument("--platforms", nargs="+", choices=PLATFORMS, default=platforms)
        verb.add_argument("--visibilities", nargs="+", choices=VISIBILITIES, default=VISIBILITIES)
        verb.add_argument("--duration", type=float, default=600.0, help="of a run in s")
        verb.add_argument("--dev", action="store_true", help="seeds to work with, not to accept by")
        verb.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes")
        verb.add_argument("--out", type=Path, default=Path("build/safety"))
        if name == "hours":
            verb.add_argument("--robot-hours", type=float, default=300.0, help="in all")
            verb.add_argument("--attack-share", type=float, default=0.4, help="of them")
            verb.add_argument("--mode", choices=MODES, default="barrier")
            verb.add_argument("--first-seed", type=_seed, help="counts up from it")
        else:
            verb.add_argument("--modes", nargs="+", choices=MODES, default=progress.MODES)
            verb.add_argument("--seeds", type=_count, default=5, help="how many")
    verb = verbs.add_parser("encounters", help="How robots get past each other in each mode.")
    verb.add_argument("--tasks", nargs="+", choices=encounters.TASKS, default=encounters.TASKS)
    modes = sorted({*encounters.MODES, *MODES})
    verb.add_argument("--modes", nargs="+", choices=modes, default=encounters.MODES)
    verb.add_argument("--seeds", type=_count, default=20, help="how many")
    verb.add_argument("--dev", action="store_true", help="seeds to work with, not to accept by")
    verb.add_argument("--first-seed", type=_seed, help="counts up from it")
    verb.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes")
    verb.add_argument("--out", type=Path, default=Path("build/safety"))
    _add_beside(verbs.add_parser("beside", help="A robot that is set down beside something."))
    verb = verbs.add_parser("held", help="How long robots stand that only protection holds.")
    verb.add_argument("--modes", nargs="+", choices=held.MODES, default=held.MODES)
    verb.add_argument("--seeds", type=_count, default=5, help="of each swarm")
    verb.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes")
    verb.add_argument("--out", type=Path, default=Path("build/safety"))
    verb = verbs.add_parser("tracks", help="Errors of tracks, for several lidars.")
    verb.add_argument("--seeds", type=_count, default=3, help="how many")
    verb.add_argument("--duration", type=float, default=60.0, help="of a run in s")
    verb.add_argument("--dev", action="store_true", help="seeds to work with, not to accept by")
    verb.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes")
    verb.add_argument("--out", type=Path, default=Path("build/safety"))
    one = verbs.add_parser("one", help="A single run with every collision.")
    for name, choices in (
        ("family", FAMILIES),
        ("platform", PLATFORMS),
        ("visibility", VISIBILITIES),
        ("mode", MODES),
    ):
        one.add_argument(name, choices=choices)
    one.add_argument("seed", type=_seed)
    one.add_argument("--duration", type=float, default=600.0, help="in s")
    return parser


def _add_beside(verb: argparse.ArgumentParser) -> None:
    """The options of `beside`."""
    verb.add_argument("--platforms", nargs="+", choices=platform_names(), default=platform_names())
    verb.add_argument("--things", nargs="+", choices=beside.THINGS, default=tuple(beside.THINGS))
    verb.add_argument("--gaps", nargs="+", type=float, help="in m")
    verb.add_argument("--headings", nargs="+", type=float, default=beside.HEADINGS)
    verb.add_argument("--modes", nargs="+", choices=beside.MODES, default=beside.MODES[:3])
    verb.add_argument("--seeds", type=_count, default=1, help="of each cell")
    verb.add_argument("--unmoved", type=_count, default=1, help="of a cell without motion")
    verb.add_argument("--at-wall", type=_count, default=1, help="of a cell beside a plain wall")
    verb.add_argument(
        "--full", action="store_true", help="all gaps; 5 seeds without motion, 20 at a plain wall"
    )
    verb.add_argument("--each", action="store_true", help="print a row for each run")
    verb.add_argument("--keep", type=Path, metavar="FILE", help="write the values of each run")
    verb.add_argument("--before", type=Path, metavar="FILE", help="such values, to compare with")
    verb.add_argument("--jobs", type=_count, default=os.cpu_count() or 1, help="processes")
    verb.add_argument("--out", type=Path, default=Path("build/safety"))


def _run_beside(options: Options) -> None:
    """Do the runs of `beside` that are missing, and print its tables."""
    gaps = beside.GAPS if options.full else options.gaps
    seeds = (1, 5, 20) if options.full else (options.seeds, options.unmoved, options.at_wall)
    wanted = beside.cells(options.platforms, options.things, gaps, options.headings, options.modes)
    records = beside.carry_out(wanted, seeds, options.jobs, options.out / "beside.jsonl")
    if options.keep:
        beside.keep(records, options.keep)
    runs = beside.values_of(records)
    before = beside.load(options.before) if options.before else {}
    cpu = sum(one.cpu for one in records) / 60.0
    about = f"{len(records)} runs, {cpu:.0f} CPU-minutes."
    print_parts(
        {
            "beside": f"{beside.summary(runs, before)}\n\n{about}",
            "beside_gaps": beside.by_gap(runs, before),
            **({"beside_each": beside.each(runs)} if options.each else {}),
        }
    )


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parser().parse_args(arguments)
    if options.verb in _RUNS:
        _RUNS[options.verb](options)
        return
    seeds = DEV_SEEDS if options.dev else ACCEPTANCE_SEEDS
    if options.verb in ("hours", "encounters") and options.first_seed is not None:
        seeds = range(options.first_seed, options.first_seed + len(ACCEPTANCE_SEEDS))
    if options.verb == "encounters":
        chosen, file = seeds[: options.seeds], options.out / "encounters.jsonl"
        found = encounters.carry_out(options.tasks, options.modes, chosen, options.jobs, file)
        print(encounters.table(found))
        return
    if options.verb == "tracks":
        file = options.out / "tracks.jsonl"
        chosen = seeds[: options.seeds]
        compared = tracking.carry_out(chosen, options.duration, options.jobs, file)
        print(tracking.table(compared))
        return
    tasks = options.plan(options, seeds)
    if not tasks:
        raise ConfigError(
            "no run: none of these families has a scene on these platforms, or --robot-hours is 0"
        )
    records = carry_out(tasks, options.out / f"{options.verb}.jsonl", options.jobs)
    words = shlex.join(sys.argv[1:] if arguments is None else arguments)
    print(f"`python -m studies.safety {words}`, {machine()}")
    cpu = sum(one.cpu for one in records)
    print(f"{sum(one.found.seconds for one in records) / cpu:.0f} robot-hours in a CPU-hour\n")
    print(options.tables(records))


def _run_one(options: Options) -> None:
    words = (options.family, options.platform, options.visibility, options.mode)
    made = scenario(Scene(*words, duration=options.duration))
    trace, told = simulate(made, options.seed)
    among, actuation = attackers(trace), made.realism.actuation
    print("Touches:", *(one.text for one in collisions(trace, among)), sep="\n")
    print("At fault:")
    for one in faults(trace, among, actuation):
        begun = moved_off(trace, one)
        print(one.text if begun is None else f"{one.text}; the other {begun.text}")
    found = judge(trace, among, actuation)
    if told:
        print("Told:", *told, sep="\n")
    print("Sums:", *(f"  {name}: {cell(found)}" for name, cell in COLUMNS.items()), sep="\n")


def _run_held(options: Options) -> None:
    records = held.carry_out(options.modes, options.seeds, options.jobs, options.out / "held.jsonl")
    print_parts({"held": held.table(records)})


_RUNS: Mapping[str, Callable[[Options], None]] = {
    "one": _run_one,
    "beside": _run_beside,
    "held": _run_held,
}


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    try:
        main()
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
