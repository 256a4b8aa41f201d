"""Tunes attraction and dispersion by their known misses; the sections "Tuned" of their pages.

python -m studies.tuning [attraction | dispersion ...]: folders and results in build/tuning. An
interrupted study continues with the same command.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

from swarmd.cli.output import warn
from swarmd.sim.experiments.cores import usable_cores
from swarmd.sim.experiments.tune import Tuning, tune

TUNINGS: Mapping[str, Mapping[str, Any]] = MappingProxyType(
    {
        # Experiment 1: the late distance to the centroid is at its bound, docs/paper.md.
        "attraction": {
            "scenario": "paper_exp1_burger",
            "metric": "mean_distance_to_centroid_late:min",
            "set": {"duration": 60},
            "param": ("slack=0..0.2", "brake=0.1..1.5", "range=1..7"),
        },
        # The way to the same distance, of which the bound is 0.73 m.
        "dispersion": {
            "scenario": "dispersion",
            "metric": "path_length:min",
            "set": {"groups.tb3.count": 5, "duration": 40},
            "param": ("ramp=0.05..1.5", "speed=0.05..0.22"),
        },
    }
)
SIZE: Mapping[str, Any] = MappingProxyType(
    {"budget": 40, "seeds": 8, "candidates": 5, "held_out": 50}
)


def tuned(name: str, folder: Path, **size: Any) -> Tuning:
    """The tuning of one pattern; `size` replaces values of SIZE."""
    return tune(out=folder, on_step=warn, **TUNINGS[name], **{**SIZE, **size})


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.tuning", description=__doc__)
    parser.add_argument("patterns", nargs="*", metavar="PATTERN", help=", ".join(TUNINGS))
    names = parser.parse_args(words).patterns or [*TUNINGS]
    if unknown := {*names} - {*TUNINGS}:
        parser.error(f"no tuning of {min(unknown)}; there are {', '.join(TUNINGS)}")
    for name in names:
        print(tuned(name, Path("build/tuning") / name, jobs=usable_cores()))


if __name__ == "__main__":
    main(sys.argv[1:])
