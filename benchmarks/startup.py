"""From the command to all robots moving: `swarmctl demo`, installed, once and then warm.

Budget: 4 s for seven robots. The time starts with the process and ends when the world has seen
every robot move, to 0.1 s.
"""

from __future__ import annotations

import json
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

BUDGET = 4.0
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


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        seconds = []
        for number in range(RUNS):
            moving = one_run(Path(folder))["seconds_to_moving"]
            print(f"run {number + 1}: {moving} s")
            if isinstance(moving, float):
                seconds.append(moving)
    if not seconds:
        sys.exit("no run in which all robots moved")
    print(
        f"{ROBOTS} robots moving: median {statistics.median(seconds):.1f} s,"
        f" worst {max(seconds):.1f} s of {len(seconds)} (budget {BUDGET:.1f} s)"
    )


if __name__ == "__main__":
    main()
