"""Every pattern that is installed is held to the contract: by its own tests, or here."""

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


@pytest.mark.parametrize("name", OURS)
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
    kinds = [one.pattern for one in vars(sys.modules[__name__]).values() if _is_contract(one)]
    assert sorted(kinds, key=str) == sorted(map(FIND, MISSIONS), key=str)


def _is_contract(value: object) -> bool:
    is_class = isinstance(value, type) and issubclass(value, PatternContract)
    return is_class and value is not PatternContract


def test_each_file_of_the_folder_is_installed() -> None:
    folder = Path(__file__).resolve().parents[2] / "patterns"
    assert sorted(path.stem for path in folder.glob("[a-z]*.py")) == OURS
