"""A small scenario of which tests change single values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml

from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.scenarios.scenariofile import load_scenario

Load = Callable[..., Scenario]

_BASE: Mapping[str, Any] = {
    "duration": 60,
    "accepts_faster": ["waffle_pi"],
    "arena": {
        "size": [8, 6],
        "boxes": [
            {"name": "crate", "at": [3, 2], "size": [0.5, 0.4], "yaw_deg": 45, "mass": 2},
            {"name": "spare", "size": [0.5, 0.5], "mass": 2},
            {"name": "block", "at": [-3, 2], "size": [0.5, 0.4]},
        ],
        "poles": [{"at": [3, -2], "radius": 0.1}],
        "segments": [{"from": [-3, -2], "to": [-2, -2]}],
    },
    "fields": [{"kind": "gaussian", "name": "light", "sigma": 2}],
    "groups": {
        "red": {
            "platform": "burger",
            "count": 2,
            "pattern": "attraction",
            "start": {"layout": "row", "spacing": 1.0},
        },
        "blue": {
            "robots": ["s-one", "s-two"],
            "start": {"layout": "row", "spacing": 1.0, "center": [1, 0]},
        },
    },
    "events": [{"at": 10, "run": "drive", "targets": "blue"}],
}


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Load:
    """Loads `here.yaml`: the small scenario, changed at dotted keys; "+" appends to a list."""
    monkeypatch.chdir(tmp_path)

    def load_changed(
        changes: Mapping[str, Any] | None = None, overrides: Mapping[str, Any] | None = None
    ) -> Scenario:
        data = deepcopy(dict(_BASE))
        for key, value in (changes or {}).items():
            _change(data, key.split("."), deepcopy(value))
        Path("here.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
        return load_scenario("here.yaml", overrides)

    return load_changed


def _change(data: Any, keys: list[str], value: Any) -> None:
    for key in keys[:-1]:
        data = data[int(key)] if isinstance(data, list) else data.setdefault(key, {})
    if keys[-1] == "+":
        data.append(value)
    else:
        data[int(keys[-1]) if isinstance(data, list) else keys[-1]] = value
