"""Every sequence of actions on the real `Robot`, judged by the rules; `make sequences` runs it.

Three searches: all sequences of commands, deep; of commands and events, less deep; of hands::

    python -m tests.sequences robot                       # both, at the depth of `make sequences`
    python -m tests.sequences robot events --depth 5 --draw 100  # 100,000 random ones, 20 minutes
    python -m tests.sequences robot --replay run,hazard:lifted,stop

Finished parts are kept in a file per search, so that the same command goes on. A sequence that
breaks a rule is printed as the `--replay` that repeats it, and the exit status is 1.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.sequences.figures import write_figures
from tests.sequences.robot_faults import FAULTS
from tests.sequences.robot_world import ACTIONS, RobotWorld
from tests.sequences.search import Head, Labels, Search, Tally

ROOT = Path(__file__).resolve().parents[2]
SEARCHED = (
    "swarmd",
    *("tests/sequences/robot_world.py", "tests/sequences/robot_rules.py"),
    *("tests/support/robot_harness.py", "tests/support/stub_patterns.py"),
)
"""What decides about the result: another content of these files begins a search anew."""


@dataclass(frozen=True)
class Alphabet:
    """The actions of a search. `depth`: of `make sequences`. `short`: of `make test`."""

    actions: tuple[str, ...]
    depth: int
    short: int

    def choices(self, labels: Labels) -> list[str]:
        """The actions that may follow a sequence, each with its kinds."""
        found: list[str] = []
        for name in self.actions:
            action = ACTIONS[name]
            before = [one for one in labels if one.partition(":")[0] == name]
            if action.is_switch and before:
                found.append(before[0])
            else:
                found += [f"{name}:{kind}" for kind in action.kinds] or [name]
        return found


ALPHABETS: Mapping[str, Alphabet] = {
    "commands": Alphabet(
        ("run", "run_for", "old_run", "stop", "estop", "reset", "resume", "copy"), 6, 3
    ),
    "events": Alphabet(
        (
            *("run", "stop", "estop", "reset", "driver", "host_dies", "hangs", "no_scans"),
            *("obstacle", "clock_set", "freeze", "raises", "unknown", "hazard", "no_pose"),
            *("battery", "push", "peer_goal"),
        ),
        4,
        2,
    ),
    "hands": Alphabet(
        (
            *("run", "take", "old_take", "silent", "late_word", "release"),
            *("stop", "estop", "resume", "copy"),
        ),
        4,
        2,
    ),
}


def main(folder: Path, arguments: Sequence[str]) -> int:
    """Search or replay as the arguments say; 1 if a rule is broken. Results land in `folder`."""
    parser = argparse.ArgumentParser(prog="python -m tests.sequences robot")
    parser.add_argument("searches", nargs="*", metavar="SEARCH", help=", ".join(ALPHABETS))
    parser.add_argument("--depth", type=int, help="actions of the longest sequences")
    parser.add_argument("--short", action="store_true", help="the depths of `make test`")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--draw", type=int, metavar="N", help="N thousand random sequences")
    parser.add_argument("--replay", metavar="ACTION,...", help="carry out one sequence")
    parser.add_argument("--fault", choices=FAULTS, default="", help="a robot with this fault")
    parser.add_argument("--shortest", action="store_true", help="the shortest broken sequence")
    parser.add_argument("--figures", action="store_true", help="write figures.json, for the pages")
    options = parser.parse_args(arguments)
    if unknown := {*options.searches} - {*ALPHABETS}:
        parser.error(f"no search {', '.join(sorted(unknown))}")
    if options.fault:
        FAULTS[options.fault].plant(setattr)
    if options.replay:
        total = Tally()
        Search(RobotWorld, lambda labels: (), 0).replay(tuple(options.replay.split(",")), total)
        return _told("replay", total)
    status = 0
    for name in options.searches or ALPHABETS:
        alphabet = ALPHABETS[name]
        depth = options.depth or (alphabet.short if options.short else alphabet.depth)
        search = Search(RobotWorld, alphabet.choices, depth)
        if options.draw is not None:
            total = search.draws(options.draw, options.jobs)
            status |= _told(f"{name}, depth {depth}, drawn", total)
            continue
        if options.shortest:
            print(name, search.shortest())
            continue
        file = folder / f"robot-{name}-{depth}{options.fault and '-' + options.fault}.jsonl"
        total = search.run(options.jobs, file, Head(name, depth, _digest()), _tell)
        status |= _told(f"{name}, depth {depth}", total)
        if options.figures:
            write_figures("robot", name, len(alphabet.actions), depth, total)
    return status


def _tell(percent: int, total: Tally) -> None:
    if sys.stderr.isatty():
        print(f"\r{percent} %, {total.sequences} sequences", end="", file=sys.stderr)


def _told(what: str, total: Tally) -> int:
    """Print a tally; 1 if it has a violation."""
    print(f"{what}: {total.sequences} sequences, {len(total.outcomes)} outcomes")
    for rule, count in sorted(total.judged.items(), key=lambda row: -row[1]):
        print(f"  {rule} was put to the test by {count}")
    for one in sorted(total.violations, key=lambda one: (len(one.labels), one.labels)):
        print(f"{one.text}\n  python -m tests.sequences robot --replay {','.join(one.labels)}")
    return 1 if total.violations else 0


def _digest() -> str:
    """A digest of all that decides about the result."""
    digest = hashlib.sha256()
    for name in SEARCHED:
        place = ROOT / name
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()[:16]
