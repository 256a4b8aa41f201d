"""Comparison of this commit with a second: `python -m benchmarks --compare COMMIT [NAME...]`.

Both commits run each benchmark alternately, in ABBA order, so that a change of the machine's load
affects both. The ratio is that of the medians (p50) of a pair of runs. Its interval is Student's t
interval, at 95 %, of the logarithms of the ratios. The second commit has a checkout and an
environment in build/compare.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.table import SCALES, markdown

ROOT = Path(__file__).resolve().parent.parent
SIZES = {name: size for scales in SCALES.values() for size, name in scales}
_VALUE = re.compile(r"(-?[0-9.]+(?:e[+-]?[0-9]+)?) ?(\S*)")


def compare(commit: str, names: Sequence[str], rounds: int) -> None:
    """Print the ratio of every row that both commits have; SystemExit if one cannot run."""
    old_folder = checkout(commit)
    runs: dict[str, list[dict[str, float]]] = {"old": [], "new": []}
    for number in range(rounds):
        for side in ("old", "new") if number % 2 == 0 else ("new", "old"):
            print(f"round {number + 1} of {rounds}: {side}", file=sys.stderr, flush=True)
            folder = old_folder if side == "old" else ROOT
            text = "".join(run(folder, name) for name in names)
            runs[side].append(medians(text))
    print(f"new: this tree; old: {commit}; {rounds} pairs; times in s\n")
    print(markdown([("what", "old p50", "new p50", "new / old", "95 %"), *ratios(runs)]))


def checkout(commit: str) -> Path:
    """The folder of a checkout of the commit with an environment of its own."""
    revision = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--verify", f"{commit}^{{commit}}"],
        capture_output=True,
        text=True,
        check=False,
    )
    if revision.returncode:
        sys.exit(f"--compare: no commit {commit!r} here; expected a name, tag or hash of git")
    sha = revision.stdout.strip()
    folder = ROOT / "build" / "compare" / sha[:12]
    if not folder.exists():
        print(f"checking {sha[:12]} out to {folder}", file=sys.stderr)
        subprocess.run(["git", "clone", "--quiet", "--shared", str(ROOT), str(folder)], check=True)
    # An earlier call may have ended between the two.
    subprocess.run(["git", "-C", str(folder), "checkout", "--quiet", sha], check=True)
    command = ["make", "--no-print-directory", f"PYTHON={sys.executable}", ".venv/tools"]
    subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
    return folder


def run(folder: Path, name: str) -> str:
    """What a benchmark prints in a checkout; SystemExit if it fails."""
    python = folder / ".venv" / "bin" / "python"
    program = ["-m", "benchmarks", name]
    if name == "bursts":  # this tree's file, since an older commit has none; the commit's sources
        program = ["-P", str(ROOT / "benchmarks" / "bursts.py")]
    done = subprocess.run(
        [str(python if python.exists() else sys.executable), *program],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        sys.exit(f"{folder}: benchmarks {name} ended with {done.returncode}: {done.stderr[-500:]}")
    return done.stdout


def medians(text: str) -> dict[str, float]:
    """The p50 of each row of printed tables, in s or in the unit of the row."""
    medians_by_row: dict[str, float] = {}
    column: int | None = None
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[0] == "what":
            column = cells.index("p50")
        elif not line.startswith("|"):
            column = None
        elif column is not None and (value := _VALUE.fullmatch(cells[column])):
            number, unit = value.groups()
            medians_by_row[cells[0]] = float(number) * SIZES.get(unit, 1.0)
    return medians_by_row


def ratios(runs: Mapping[str, Sequence[Mapping[str, float]]]) -> list[tuple[str, ...]]:
    """For each row of both: the medians over rounds, the ratio and its interval."""
    from scipy import stats  # 1.1 s of CPU, which a collection of tests must not spend

    pairs = list(zip(runs["old"], runs["new"], strict=True))
    common = [what for what in pairs[0][0] if all(what in run for pair in pairs for run in pair)]
    rows = []
    for what in common:
        old, new = [pair[0][what] for pair in pairs], [pair[1][what] for pair in pairs]
        if min(*old, *new) <= 0.0:
            continue
        logs = [math.log(b / a) for a, b in zip(old, new, strict=True)]
        mean = sum(logs) / len(logs)
        interval = "-"
        if len(logs) > 1:
            half = float(stats.t.ppf(0.975, len(logs) - 1)) * float(stats.sem(logs))
            interval = f"{math.exp(mean - half):.2f} to {math.exp(mean + half):.2f}"
        middle = (f"{sorted(some)[len(some) // 2]:.3g}" for some in (old, new))
        rows.append((what, *middle, f"{math.exp(mean):.2f}", interval))
    return rows
