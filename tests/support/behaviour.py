"""Compares a scene with the ledger of behaviours."""

from __future__ import annotations

from functools import cache
from math import floor
from pathlib import Path

import pytest

from studies.behaviour.in_worker import simulated_scene
from studies.behaviour.ledger import RENEWAL, Ledger, described, differences, drives_of, read

ROOT = Path(__file__).resolve().parents[2]
PATTERNS = frozenset(path.parent.name for path in ROOT.glob("patterns/*/pattern.py"))


@cache
def kept() -> tuple[Ledger, str]:
    """The ledger, and why it is not comparable here."""
    ledger = read()
    return ledger, ledger.other_software()


def assert_drives_as_kept(name: str, folder: Path, seconds: float | None = None) -> None:
    """Fail with a line for each robot of a scene that drives otherwise; skip on other software.

    `seconds`: the first ones alone, without the one that has begun: the last instant of a run lacks
    what robots decide at its end, so it is not that of a longer run.
    """
    ledger, other = kept()
    if other:
        pytest.skip(f"the ledger is not comparable here: {other}")
    drives = drives_of(simulated_scene(name, folder, seconds))
    if seconds is not None:
        drives = {robot: one.before(floor(seconds)) for robot, one in drives.items()}
    now = {name: drives}
    was = {name: ledger.scenes[name]} if name in ledger.scenes else {}
    found = [described(one) for one in differences(was, now)]
    assert not found, "\n".join([*found, f"if that is meant, `{RENEWAL}` writes the ledger again"])
