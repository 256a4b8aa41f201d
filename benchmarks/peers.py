"""Robot-seconds per CPU-second, beside other simulators: `python -m benchmarks.peers`.

Three tables by what is computed: bodies with eight short rays beside Enki (C++, Debian's
libenki-dev, compiled here), 24 rays and 360 rays beside ir-sim (from PyPI, in an environment of its
own in build/ir_sim). `--vmas PYTHON` names an interpreter that has vmas and torch; without it the
rows of VMAS are left out. All rows of a number of robots and rays follow each other. Robots have
1 m2 each, and each sensor casts its rays ten times a second.

What a simulator leaves out stands in the note of its row. swarmd simulates physics of bodies, noisy
lidars whose rays have different ages, delays, radio, protection, and a pattern.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks import learning
from benchmarks.lockstep import one_per_square_metre, seconds_of
from benchmarks.table import Row, print_table

SIZES: Mapping[int, Sequence[int]] = {8: (7, 100, 1000), 24: (7, 100), 360: (7, 100)}
"""Numbers of robots by number of rays."""
RANGES = {24: 1.2, 360: 3.5}  # m by number of rays, as in benchmarks/irsim_steps.py
PATTERNS = ("attraction", "random_walk")
SECONDS = {7: 20, 100: 6, 1000: 2}
IR_SIM = "ir-sim==2.12.0"
ENKI_LACKS = "rays of 12 cm without noise, no delays, radio, protection"
IR_SIM_LACKS = "no physics of bodies, noise, delays, radio, protection; robots pass through others"


def lidar(rays: int) -> Mapping[str, Any]:
    """Overrides of a scenario: a Waffle Pi with `rays` rays at 10 Hz; 8 rays are an e-puck2's."""
    if rays == 8:
        return {"groups.all.platform": "epuck2"}
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


def enki_row(program: str, robots: int) -> Row:
    """The row of Enki, measured by the compiled benchmarks/enki_steps.cpp."""
    done = subprocess.run([program, str(robots)], stdout=subprocess.PIPE, text=True, check=True)
    rates = [float(line) for line in done.stdout.split()]
    return Row(f"Enki, {robots} e-pucks, 8 rays, avoiding", rates, note=ENKI_LACKS, unit="")


def compiled_enki(program: Path = Path("build/enki_steps")) -> str:
    """The path of the program that steps Enki; "" without Debian's libenki-dev."""
    source = str(Path(__file__).with_name("enki_steps.cpp"))
    program.parent.mkdir(exist_ok=True)
    command = ["g++", "-O2", "-o", str(program), source, "-lenki"]
    return _made(str(program), [command], "Enki cannot be compiled (apt install libenki-dev)")


def installed_ir_sim(folder: Path = Path("build/ir_sim")) -> str:
    """The path of an interpreter with ir-sim; "" if `folder` cannot get ir-sim."""
    python = str(folder / "bin" / "python")
    commands = (
        [sys.executable, "-m", "venv", str(folder)],
        [python, "-m", "pip", "-q", "install", IR_SIM],
    )
    return _made(python, commands, f"{IR_SIM} cannot be installed")


def _made(program: str, commands: Iterable[Sequence[str]], failure: str) -> str:
    """`program`, once all commands have succeeded; "" if one fails."""
    try:
        for command in commands:
            subprocess.run(command, check=True)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"{failure}: its rows are left out: {error}")
        return ""
    return program


def rows(rays: int, program: str, seconds: Mapping[int, int] = SECONDS) -> Iterator[Row]:
    """Rows of swarmd and of the peer `program`, Enki with 8 rays and else ir-sim, in turn."""
    for robots in SIZES[rays]:
        yield from own_rows(robots, rays, seconds[robots])
        if program:
            is_enki = rays == 8
            yield enki_row(program, robots) if is_enki else ir_sim_row(program, robots, rays)


def main(words: Sequence[str] = ()) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.peers", description=__doc__)
    parser.add_argument("--vmas", metavar="PYTHON", help="an interpreter that has vmas and torch")
    given = parser.parse_args(words)
    peers = {8: compiled_enki(), **dict.fromkeys((24, 360), installed_ir_sim())}
    for rays, program in peers.items():
        print_table(f"Robot-seconds a CPU-second, one processor, {rays} rays", rows(rays, program))
    if given.vmas:
        learning.main(["--vmas", given.vmas])


if __name__ == "__main__":
    main(sys.argv[1:])
