"""Robot-hours under protection with avoidance, and their control: `python -m studies.robot_hours`.

Whole swarms in lockstep on the platforms with a lidar, alone and with a third of the robots
attacking the others, in runs of 300 s with seeds that set nothing; each scene at least once. 4 % of
them are repeated with protection `off`, the control. Prints the runs at fault, the worst first,
then tables of all, by platform and visibility, and by family. `--walls-stand`: a fifth of the runs
with `walls_stand`, beginning with the scenes that it is about. The same command goes on in
build/safety.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.table import markdown
from studies.kept import print_parts
from studies.safety.columns import EVIDENCE, HOUR, Columns, upper_bound
from studies.safety.hours import again, cells, plan
from studies.safety.judgement import Judgement
from studies.safety.runs import Record, Task, carry_out, total
from studies.safety.scenes import FAMILIES, PLATFORMS, VISIBILITIES
from swarmd.core.pin import restart_pinned

SEEDS = range(120_000, 130_000)
MODES = {
    "orca": (1.0, ""),
    "off": (0.04, ", **protection off**"),
    "walls_stand": (0.2, ", with `walls_stand`"),
}
"""The modes of protection, each with its share of the robot-hours and its words."""
_COLUMNS: Columns = {
    **{name: EVIDENCE[name] for name in ("robot-hours", "touches", "pushed", "at fault")},
    "a robot-hour, at most (95 %)": lambda found: _bound(found),
    "hardest": EVIDENCE["hardest"],
    "held": EVIDENCE["held"],
    "smallest gap [m]": lambda found: f"{found.min_gap:.3f}",
}


def tasks(alone: float, attacked: float, mode: str) -> list[Task]:
    """The runs of so many robot-hours alone and among attackers, in a mode of protection."""
    found: list[Task] = []
    for is_attacked, robot_hours in ((False, alone), (True, attacked)):
        families = [name for name, one in FAMILIES.items() if bool(one.attack) == is_attacked]
        if mode == "walls_stand":
            families.sort(key=lambda name: FAMILIES[name].movers is None)
        scenes = cells(families, PLATFORMS, VISIBILITIES, mode, 300.0)
        found += plan(robot_hours, scenes, SEEDS, is_whole=mode == "orca")
    return found


def kind(record: Record) -> str:
    """Among whom the robots of a run drive, and whether protection is on."""
    family = record.task.scene.of
    among = "alone" if not family.attack else "among attackers"
    beyond = "" if family.is_claimed else ", beyond the claim"
    return f"{among}{beyond}{MODES[record.task.scene.mode][1]}"


def table(records: Sequence[Record], head: str, of: Callable[[Record], str]) -> str:
    """Markdown: a row for each kind of runs and each value of `of`, in the order of the records."""
    groups: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        groups.setdefault((kind(record), of(record)), []).append(record)
    rows = [["robots", head, *_COLUMNS]]
    for names, some in groups.items():
        whole = total(record.found for record in some)
        rows.append([*names, *(cell(whole) for cell in _COLUMNS.values())])
    return markdown(rows)


def worst(records: Sequence[Record]) -> str:
    """Markdown: the runs at fault of protected robots, the hardest first, with their commands."""
    rows = [["hardest", "at fault", "robots", "command"]]
    for record in sorted(records, key=lambda one: -max(one.found.worst, one.found.worst_touch)):
        cell = EVIDENCE["hardest"](record.found), EVIDENCE["at fault"](record.found)
        if cell[1] != "0" and record.task.scene.mode != "off":
            rows.append([*cell, kind(record), f"`{again(record.task)}`"])
    return markdown(rows) if rows[1:] else "No run had a touch at fault."


def main() -> None:
    """Do the runs that are missing, and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.robot_hours", description=__doc__)
    parser.add_argument("--alone", type=float, default=300.0, help="robot-hours [300]")
    parser.add_argument("--attacked", type=float, default=100.0, help="robot-hours [100]")
    parser.add_argument("--walls-stand", action="store_true", help="runs with `walls_stand`")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time")
    options = parser.parse_args()
    wanted = [
        task
        for mode in (("walls_stand",) if options.walls_stand else ("orca", "off"))
        for task in tasks(MODES[mode][0] * options.alone, MODES[mode][0] * options.attacked, mode)
    ]
    records = carry_out(wanted, Path("build/safety/hours.jsonl"), options.jobs)
    pace = sum(one.found.seconds for one in records) / sum(one.cpu for one in records)
    whole = sum(one.found.seconds for one in records) / HOUR
    about = f"{whole:.1f} robot-hours, {pace:.0f} robot-seconds in a CPU-second."
    name = "robot_hours_walls_stand" if options.walls_stand else "robot_hours"
    print_parts(
        {
            f"{name}_worst": worst(records),
            name: f"{table(records, 'runs', lambda record: 'all')}\n\n{about}",
            f"{name}_platforms": table(records, "platform and visibility", _place),
            f"{name}_families": table(records, "family", _family),
        }
    )


def _family(record: Record) -> str:
    return f"`{record.task.scene.family}`"


def _bound(found: Judgement) -> str:
    bound = upper_bound(found.faults + found.touch_faults, found.seconds / HOUR)
    return f"{bound:.2g}" if bound < 100.0 else f"{bound:.0f}"


def _place(record: Record) -> str:
    return f"{record.task.scene.platform}, {record.task.scene.visibility}"


if __name__ == "__main__":
    restart_pinned()  # as in a night, so that runs have its bits
    main()
