"""From the command to all robots moving: `swarmctl demo`, installed.

The time starts with the process and ends when the world has seen
every robot move, to 0.1 s.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from benchmarks.table import Row, print_table

RUNS = 5
ROBOTS = 7


def one_run(folder: Path) -> dict[str, object]:
    command = [str(Path(sys.executable).with_name("swarmctl")), "demo", "-n", str(ROBOTS)]
    command += ["--seconds", "3", "--headless", "-o", "json"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)
    if done.returncode not in (0, 1):
        sys.exit(f"{' '.join(command)} ended with code {done.returncode}: {done.stderr}")
    answer: dict[str, object] = json.loads(done.stdout)
    return answer


def rows(runs: int = RUNS) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        starts = [one_run(Path(folder))["seconds_to_moving"] for _ in range(runs)]
    seconds = [moving for moving in starts if isinstance(moving, float)]
    note = f"all moved in {len(seconds)} of {runs} runs"
    yield Row(f"swarmctl demo: {ROBOTS} robots moving", seconds, "1.8 s", note)


def main() -> None:
    print_table("Starting a demo", rows())


if __name__ == "__main__":
    main()
