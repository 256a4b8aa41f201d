"""From a fresh clone to moving robots: `make demo`, by stage.

The clone holds what is committed here. `--cold` gives pip an empty cache, so that it downloads all;
`--commit` measures another commit. The network and the registry count, too.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from benchmarks.table import Row, print_table

ROOT = Path(__file__).resolve().parent.parent
ARGS = "ARGS=-n 7 --seconds 10 --headless"
STARTS = "Starting a world"
STAGE = re.compile(r"  ([\w ]+): (?:.*, )?(\d+) s")
MOVING = re.compile(r"  all moving after +([\d.]+) s")


def processor_time() -> float:
    used = getrusage(RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def rows(commit: str, is_cold: bool) -> Iterator[Row]:
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "swarmd"
        subprocess.run(["git", "clone", "--quiet", ROOT, clone], check=True)
        subprocess.run(["git", "-C", clone, "checkout", "--quiet", "--detach", commit], check=True)
        environment = {name: value for name, value in os.environ.items() if name != "MAKEFLAGS"}
        if is_cold:
            environment["PIP_CACHE_DIR"] = str(Path(folder) / "cache")
        cpu, began = processor_time(), time.monotonic()
        with subprocess.Popen(
            ["make", "--no-print-directory", "demo", ARGS],
            cwd=clone,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        ) as demo:
            assert demo.stdout is not None
            text = ""
            for line in demo.stdout:
                text += line
                if line.startswith(STARTS):
                    started = time.monotonic() - began
                elif found := MOVING.match(line):
                    moving, summary = float(found[1]), time.monotonic() - began
                elif found := STAGE.match(line):
                    yield Row(found[1], [float(found[2])])
        if demo.returncode not in (0, 1) or MOVING.search(text) is None:
            sys.exit(f"make demo ended with code {demo.returncode}:\n{text}")
        yield Row("the installation before the demo", [started])
        yield Row("all seven robots have moved", [started + moving], "30 s")
        yield Row("the summary, after 10 s of simulated time", [summary])
        yield Row("the end, with all that is installed meanwhile", [time.monotonic() - began])
        yield Row("processor time", [processor_time() - cpu])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.first_start", description=__doc__)
    parser.add_argument("--cold", action="store_true", help="with an empty cache of pip")
    parser.add_argument("--commit", default="HEAD", help="what is measured [HEAD]")
    options = parser.parse_args()
    print_table("From a fresh clone", rows(options.commit, options.cold))


if __name__ == "__main__":
    main()
