"""Simulates scenes, each into a trace: `measure.py FOLDER SCENES`, where SCENES is a JSON file.

A program by itself, so that it also runs on the code of an earlier commit: it imports nothing but
what simulates.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from swarmd.core.errors import SwarmError
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.scenarios.scenariofile import load_scenario, scenario_of


def main(folder: Path, scenes: Path) -> None:
    """Write FOLDER/NAME.npz for each scene, or FOLDER/NAME.error with the reason in a line."""
    for name, scene in json.loads(scenes.read_bytes()).items():
        source = scene["scenario"]
        try:
            scenario = (
                load_scenario(source, scene["set"])
                if isinstance(source, str)
                else scenario_of(source)
            )
            trace = simulate_run(scenario, scene["seed"], seconds=scene["seconds"])
        except SwarmError as error:
            (folder / f"{name}.error").write_text(f"{error}\n")
            continue
        trace.save(folder / f"{name}.npz")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
