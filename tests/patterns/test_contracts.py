"""Every pattern that is installed is held to the contract: by tests of its own, or here."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import ClassVar

import pytest

from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import installed_patterns
from swarmd.testing.pattern_contract import PatternContract

FOUND = installed_patterns()
FIND = PatternLoader({name: (origin.value, origin.is_file) for name, origin in FOUND.items()})
OURS = sorted(name for name, origin in FOUND.items() if origin.value.startswith("swarmd.patterns."))
MISSIONS = [name for name, origin in FOUND.items() if origin.source == "swarmd"]
TURTLEBOTS = ("burger", "waffle_pi")
HERE, FOLDER = Path(__file__).parent, Path(__file__).resolve().parents[2] / "patterns"
TESTED = [name for name in OURS if (HERE / f"test_{name}.py").exists()]

for _name in sorted({*OURS} - {*TESTED}):  # it has no rule that only a test of its own can check
    _title = f"Test_{_name}"
    globals()[_title] = type(_title, (PatternContract,), {"pattern": FIND(_name)})


class TestDiscussThenDisperse(PatternContract):
    """Its distances are for TurtleBots."""

    pattern = FIND("discuss_then_disperse")
    platforms: ClassVar = TURTLEBOTS


class TestSearchGatherDecideDisperse(PatternContract):
    """Its distances are for TurtleBots."""

    pattern = FIND("search_gather_decide_disperse")
    platforms: ClassVar = TURTLEBOTS


class TestPatrolWithoutLeader(PatternContract):
    pattern = FIND("patrol_without_leader")


class TestForageAtVotedSource(PatternContract):
    pattern = FIND("forage_at_voted_source")


class TestGatherOnDarkFloor(PatternContract):
    pattern = FIND("gather_on_dark_floor")


@pytest.mark.parametrize("name", TESTED)
def test_each_pattern_passes_the_contract_on_every_platform(name: str) -> None:
    module = import_module(f"tests.patterns.test_{name}")
    contracts = [
        value
        for key, value in vars(module).items()
        if key.startswith("Test") and isinstance(value, type) and issubclass(value, PatternContract)
    ]
    plain = [one for one in contracts if one.pattern is FIND(name) and not one.params]
    assert plain, f"tests/patterns/test_{name}.py has no PatternContract of {name} as it is"
    assert all(not one.platforms for one in plain)
    for point in vars(PatternContract):
        if point.startswith("test_"):
            assert all(getattr(one, point) is getattr(PatternContract, point) for one in plain)


def test_every_shipped_mission_is_tested() -> None:
    kinds = {one.pattern for one in vars(sys.modules[__name__]).values() if _is_contract(one)}
    assert {*map(FIND, MISSIONS)} <= kinds


def _is_contract(value: object) -> bool:
    is_class = isinstance(value, type) and issubclass(value, PatternContract)
    return is_class and value is not PatternContract


@pytest.mark.parametrize("name", OURS)
def test_each_of_our_patterns_has_a_group(name: str) -> None:
    assert FIND(name).group


def test_each_folder_is_a_pattern_with_scenario_and_page() -> None:
    folders = [path for path in FOLDER.iterdir() if path.is_dir() and path.name[0] != "_"]
    assert sorted(path.name for path in folders) == OURS
    wanted = {"pattern.py", "scenario.yaml", "page.md"}
    for path in folders:
        names = {file.name for file in path.iterdir() if file.is_file()}
        further = {"outcomes.yaml", "metrics.py", "outcome.json", "film.gif", "figure.png"}
        assert wanted <= names <= wanted | further, path.name
