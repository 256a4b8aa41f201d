"""Classes from files: read when a load begins, and kept until the next load."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from swarmd.kit.behavior import Pattern
from swarmd.kit.factory import assemble
from swarmd.kit.params import Params
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform

CODE = """
from pathlib import Path
from swarmd.api import *

with Path(__file__).with_suffix(".count").open("a") as file:
    file.write("1")

class OwnParams(Params, frozen=True):
    speed: Annotated[float, about("how fast", ge=0.0, le=1.0, unit="m/s")] = SPEED

class Own(MovementPattern[OwnParams]):
    params_type = OwnParams

    def drive(self, inputs):
        return Twist(self.params.speed)
"""
MISSION = """
mission: Votes on a speed
parts: {vote: {pattern: majority_rule}, go: {pattern: own}, other: {pattern: dispersion}}
map: [{from: vote.opinion, to: other.distance, values: [1.0, 1.1, 1.2]}]
parallel: [vote, go, other]
drives: go
parameters: {speed: go.speed}
"""


def load_mission(loader: PatternLoader, folder: Path) -> Pattern[Params]:
    """The mission as a host loads it."""
    found = pattern_names(folder)
    loader.begin({name: (origin.value, origin.is_file) for name, origin in found.items()})
    return assemble(
        "mission",
        (),
        find=loader,
        robot="robot-1",
        platform=load_platform("waffle_pi"),
        rng=np.random.default_rng(0),
    ).pattern


def test_a_mission_takes_its_parts_from_the_files_at_its_load(tmp_path: Path) -> None:
    loader = PatternLoader({})
    (tmp_path / "mission.yaml").write_text(MISSION)
    for speed in (0.1, 0.2):
        (tmp_path / "own.py").write_text(CODE.replace("SPEED", str(speed)))
        assert getattr(load_mission(loader, tmp_path).params, "speed") == speed  # noqa: B009
    assert (tmp_path / "own.count").read_text() == "11"  # once a load
