"""Robot-seconds per CPU-second, beside other simulators: `python -m benchmarks.peers`.

ir-sim is installed from PyPI into a virtual environment of its own in build/ir_sim, at the first
run. `--vmas PYTHON` names an interpreter that has vmas and torch; without it the rows of VMAS are
left out. All rows of a number of robots and rays follow each other. Robots have 1 m2 each, and each
lidar casts its rays ten times a second.

What a simulator leaves out stands in the note of its row. swarmd simulates physics of bodies, noisy
lidars whose rays have different ages, delays, radio, protection, and a pattern.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import learning
from benchmarks.lockstep import one_per_square_metre, seconds_of
from benchmarks.table import Row, print_table

SIZES, RAYS = (7, 100), (24, 360)
RANGES = {24: 1.2, 360: 3.5}  # m by number of rays, as in benchmarks/irsim_steps.py
PATTERNS = ("attraction", "random_walk")
SECONDS = {7: 20, 100: 6}
IR_SIM = "ir-sim==2.12.0"
IR_SIM_LACKS = "no physics of bodies, noise, delays, radio, protection; robots pass through others"


def lidar(rays: int) -> Mapping[str, Any]:
    """Overrides of a scenario: a Waffle Pi with `rays` rays at 10 Hz."""
    scan = {"rays": rays, "rate": 10.0, "range_max": RANGES[rays]}
    if rays == 24:
        scan["max_gap_deg"] = 40.0
    return {
        "groups.all.platform": "benchmarked",
        "platforms.benchmarked": {"extends": "waffle_pi", "scan": scan},
    }


def own_rows(robots: int, rays: int, seconds: int) -> Iterator[Row]:
    """One row of swarmd for each pattern; a sample is a simulated second."""
    for pattern in PATTERNS:
        overrides = {**one_per_square_metre(robots, pattern), **lidar(rays)}
        rates = [robots / taken for taken in seconds_of("thousand", overrides, seconds)]
        yield Row(f"swarmd, {robots} robots, {rays} rays, {pattern}", rates, unit="")


def ir_sim_row(python: str, robots: int, rays: int) -> Row:
    """The row of IR-SIM, measured by interpreter `python`."""
    script = str(Path(__file__).with_name("irsim_steps.py"))
    command = [python, "-W", "ignore", script, f"{robots}:{rays}"]
    done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
    (result,) = json.loads(done.stdout.splitlines()[-1])
    name = f"ir-sim, {robots} robots, {rays} rays, goals at random"
    return Row(name, result["rates"], note=IR_SIM_LACKS, unit="")


def installed_ir_sim(folder: Path = Path("build/ir_sim")) -> str:
    """The path of an interpreter with ir-sim; "" if `folder` cannot get ir-sim."""
    python = str(folder / "bin" / "python")
    commands = (
        [sys.executable, "-m", "venv", str(folder)],
        [python, "-m", "pip", "-q", "install", IR_SIM],
    )
    if all(subprocess.run(command, check=False).returncode == 0 for command in commands):
        return python
    print(f"{IR_SIM} cannot be installed: its rows are left out.")
    return ""


def rows(seconds: Mapping[int, int] = SECONDS) -> Iterator[Row]:
    """Rows of swarmd and of ir-sim in turn."""
    ir_sim = installed_ir_sim()
    for robots in SIZES:
        for rays in RAYS:
            yield from own_rows(robots, rays, seconds[robots])
            if ir_sim:
                yield ir_sim_row(ir_sim, robots, rays)


def main(words: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("--vmas", metavar="PYTHON", help="an interpreter that has vmas and torch")
    given = parser.parse_args(words)
    print_table("Robot-seconds a CPU-second, one processor", [*rows()])
    if given.vmas:
        learning.main(["--vmas", given.vmas])


if __name__ == "__main__":
    main(sys.argv[1:])
