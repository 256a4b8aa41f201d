"""Patterns and their parameters are checked before a run."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.scenarios.scenariofile import scenario_of

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

_NEEDY = """
from swarmd.api import MovementPattern, Params, Twist

class Needy(MovementPattern[Params]):
    '''Needs what few have.'''
    params_type = Params
    needs = frozenset({"neighbors.distance", "reading:light"})

    def drive(self, inputs):
        return Twist()
"""


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"groups.red.pattern": "atraction"}, "groups.red.pattern: .*'attraction'"),
        (
            {"groups.red.parameters": {"spaceing": 1}},
            "groups.red.parameters.spaceing: .*'spacing'",
        ),
        ({"groups.red.parameters": {"law": "papre"}}, "law.*group red.*paper"),
        ({"groups.red.parameters": {"spacing": math.nan}}, "groups.red.parameters.spacing"),
        ({"parameters": {"drive": {"sped": 1}}}, "parameters.drive.sped: .*'speed'.*scenario"),
        ({"parameters": {"driev": {"speed": 1}}}, "parameters: .*'drive'"),
        (
            {"groups.red.touch": {"driev": {"half_width_deg": 9, "speed": 0.1}}},
            "groups.red.touch.driev: .*'drive'",
        ),
        ({"events.0.parameters": {"speed": 100}}, r"events\[0\].parameters.speed: .*request"),
        (
            {"events.+": {"at": 20, "param": {"speeed": 1}, "targets": "blue"}},
            r"events\[1\].param.speeed: .*'speed'",
        ),
        ({"events.0.run": "drvie"}, r"events\[0\].run: .*'drive'"),
        ({"plugin_dir": "nowhere"}, "nowhere"),
    ],
)
def test_a_wrong_name_or_value_is_found(load: Load, changes: dict[str, Any], fault: str) -> None:
    with pytest.raises(ConfigError, match=rf"^here\.yaml: .*{fault}"):
        load(changes)


def test_a_wrong_parameter_that_was_set_is_not_looked_for_in_the_file(load: Load) -> None:
    effective = load().effective
    with pytest.raises(ConfigError, match=r"^--set: groups\.red.*\.spaceing"):
        scenario_of(effective, {"groups.red.parameters.spaceing": 1})


def test_a_robot_must_sense_what_the_pattern_needs(load: Load, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "needy.py").write_text(_NEEDY)
    (tmp_path / "mine" / "leaving.py").write_text(f"{_NEEDY}\nraise SystemExit\n")
    # Its sensors show no robot: a Burger would learn the places of peers by kin.
    blue = {"groups.blue.platform": "thymio", "groups.blue.pattern": "needy"}
    changes = {"plugin_dir": "mine", "lidar_visibility": "body", **blue}
    with pytest.raises(ConfigError, match=r"groups.blue.pattern: .*neighbors.distance"):
        load(changes)
    assert load({**changes, "radio": {"range_and_bearing": True}}).plugin_dir == tmp_path / "mine"
    with pytest.raises(ConfigError, match=r"groups\.blue\.pattern: leaving"):
        load({**changes, "groups.blue.pattern": "leaving"})


def test_layers_are_the_platforms_the_scenarios_and_the_groups(load: Load) -> None:
    changes: dict[str, Any] = {
        "platforms": {"burger": {"patterns": {"attraction": {"slack": 0.1}}}},
        "parameters": {"attraction": {"spacing": 0.8}},
        "groups.red.parameters": {"law": "paper"},
    }
    parameters = load(changes).parameters
    assert parameters["red-01"].layers("attraction", ()) == (
        ("platform", {"slack": 0.1}),
        ("scenario", {"spacing": 0.8}),
        ("group red", {"law": "paper"}),
    )
    assert parameters["s-one"].layers("attraction", ()) == (("scenario", {"spacing": 0.8}),)
    assert parameters["red-01"].layers("drive", ()) == ()
