"""All benchmarks, one after the other: `python -m benchmarks [NAME...]`, about fifteen minutes.

`--compare COMMIT` runs another commit in turn and prints ratios.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

from benchmarks import (
    bursts,
    cdr,
    cli,
    latency,
    learning,
    lidar,
    lockstep,
    protection,
    recording,
    resources,
    ros2,
    startup,
    steps,
    switch,
)
from benchmarks.compare import compare
from benchmarks.table import machine

ALL: Mapping[str, Callable[[], None]] = {
    "steps": steps.main,
    "cdr": cdr.main,
    "protection": protection.main,
    "lidar": lidar.main,
    "lockstep": lambda: lockstep.main([]),
    "learning": learning.main,
    "latency": lambda: latency.main([]),
    "resources": lambda: resources.main([]),
    "recording": lambda: recording.main([]),
    "startup": startup.main,
    "cli": cli.main,
    "ros2": lambda: ros2.main([]),
    "switch": lambda: switch.main([]),
}
ON_REQUEST: Mapping[str, Callable[[], None]] = {"bursts": bursts.main}
"""By name, benchmarks that take real-time priority, and run only if they are named."""


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument(
        "names", nargs="*", metavar="NAME", help=f"of: {', '.join((*ALL, *ON_REQUEST))}"
    )
    parser.add_argument("--compare", metavar="COMMIT", help="run this commit in turn, print ratios")
    parser.add_argument("--rounds", type=int, default=3, help="pairs of runs with --compare [3]")
    options = parser.parse_args()
    known = {**ALL, **ON_REQUEST}
    names = options.names or list(ALL)
    for name in names:
        if name not in known:
            parser.error(f"no benchmark {name!r}; there are {', '.join(known)}")
    if options.compare:
        compare(options.compare, names, max(options.rounds, 1))
        return
    print(f"Measured on {machine()}. Rows with a goal are asserted nowhere.")
    for name in names:
        known[name]()


if __name__ == "__main__":
    main()
