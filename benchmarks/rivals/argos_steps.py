"""Speed of the simulator ARGoS: `argos_steps.py PREFIX LIBRARY ROBOTS RAYS RANGE NEAR SECONDS`.

Prints the simulated robot-seconds and their CPU seconds. PREFIX is the folder where ARGoS 3 is
installed, and LIBRARY the compiled argos_steps.cpp. Foot-bots have 24 proximity rays of 0.1 m, so
that RAYS, RANGE and NEAR change nothing; `dynamics2d` with its ten steps of 0.01 s.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

WORLD = """<?xml version="1.0" ?>
<argos-configuration>
  <framework>
    <system threads="0" />
    <experiment length="0" ticks_per_second="10" random_seed="1" />
  </framework>
  <controllers>
    <walker id="walker" library="{library}">
      <actuators><differential_steering implementation="default" /></actuators>
      <sensors><footbot_proximity implementation="default" show_rays="false" /></sensors>
      <params />
    </walker>
  </controllers>
  <loop_functions library="{library}" label="clock" robots="{robots}" seconds="{seconds}" />
  <arena size="{size},{size},1" center="0,0,0.5">
    <box id="n" size="{side},0.1,0.5" movable="false">
      <body position="0,{half},0" orientation="0,0,0" /></box>
    <box id="s" size="{side},0.1,0.5" movable="false">
      <body position="0,-{half},0" orientation="0,0,0" /></box>
    <box id="e" size="0.1,{side},0.5" movable="false">
      <body position="{half},0,0" orientation="0,0,0" /></box>
    <box id="w" size="0.1,{side},0.5" movable="false">
      <body position="-{half},0,0" orientation="0,0,0" /></box>
    <distribute>
      <position method="uniform" min="-{inner},-{inner},0" max="{inner},{inner},0" />
      <orientation method="uniform" min="0,0,0" max="360,0,0" />
      <entity quantity="{robots}" max_trials="100">
        <foot-bot id="fb"><controller config="walker" /></foot-bot>
      </entity>
    </distribute>
  </arena>
  <physics_engines><dynamics2d id="dyn2d" iterations="10" /></physics_engines>
  <media />
</argos-configuration>
"""


def world(library: str, robots: int, seconds: float) -> str:
    """The file of ARGoS."""
    side = math.sqrt(robots)
    return WORLD.format(
        library=library,
        robots=robots,
        seconds=seconds,
        size=side + 2.0,
        side=side + 0.1,
        half=side / 2.0 + 0.05,
        inner=side / 2.0 - 0.2,
    )


def main(prefix: Path, library: str, robots: int, seconds: float) -> int:
    libraries = prefix / "lib" / "argos3"
    made = {**os.environ, "LD_LIBRARY_PATH": str(libraries), "ARGOS_PLUGIN_PATH": str(libraries)}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.argos"
        path.write_text(world(library, robots, seconds))
        program = [str(prefix / "bin" / "argos3"), "--no-color", "--no-visualization", "-c"]
        done = subprocess.run(
            [*program, str(path)], env=made, stdout=subprocess.PIPE, text=True, check=False
        )
    lines = [line for line in done.stdout.splitlines() if line[:1].isdigit()]
    print(*lines[-1:])  # behind what ARGoS logs
    return done.returncode


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[7])))
