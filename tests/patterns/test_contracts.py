"""Every pattern that is installed is held to the contract: by its own tests, or here."""

from __future__ import annotations

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
MISSION = FIND("discuss_then_disperse")


class TestDiscussThenDisperse(PatternContract):
    """The mission that comes along; its distances are for TurtleBots."""

    pattern = MISSION
    platforms: ClassVar = ("burger", "waffle_pi")


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
    missions = [name for name, origin in FOUND.items() if origin.source == "swarmd"]
    assert missions == ["discuss_then_disperse"]


def test_each_file_of_the_folder_is_installed() -> None:
    folder = Path(__file__).resolve().parents[2] / "patterns"
    assert sorted(path.stem for path in folder.glob("[a-z]*.py")) == OURS
