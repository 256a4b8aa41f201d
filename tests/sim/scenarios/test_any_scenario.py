"""Any scenario loads and reloads from its plain values, or fails with one line."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarmd.core.errors import SwarmError
from swarmd.sim.scenarios.scenariofile import scenario_of
from tests.support.examples import examples

if TYPE_CHECKING:
    from tests.sim.scenarios.conftest import Load

Path = tuple[str | int, ...]

_WORDS = st.sampled_from(["red", "all", "crate", "drive", "burger", "row", "random", "s-one"])
_KEYS = st.sampled_from(["at", "run", "targets", "layout", "near", "kind", "preset", "extends"])
_PLAIN = st.none() | st.booleans() | st.integers(-3, 20) | st.integers() | st.floats() | _WORDS
_ANYTHING = st.recursive(
    _PLAIN | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(_KEYS | st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=5,
)
_MORE: Mapping[str, Any] = {
    "radio": {"loss": 0.1},
    "realism": {"preset": "ideal"},
    "platforms": {"burger": {"limits": {"linear": 0.1}}},
    "parameters": {"drive": {"speed": 0.1}},
}
_EVENTS: list[dict[str, Any]] = [
    {"at": 20, "place": "spare", "pose": [0, 2, 0]},
    {"at": 30, "join": "red-02"},
    {"at": 31, "param": {"speed": 0.2}, "targets": "blue"},
]


@pytest.fixture
def whole(load: Load) -> dict[str, Any]:
    """A scenario with something under every key."""
    first = {"at": 10, "run": "drive", "targets": "blue", "parameters": {"speed": 0.1}, "for": 50}
    return dict(load({**_MORE, "events": [first, *_EVENTS]}).effective)


@settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(data=st.data())
def test_any_change_is_taken_or_refused_in_one_line(
    whole: dict[str, Any], data: st.DataObject
) -> None:
    changed = deepcopy(whole)
    path = data.draw(st.sampled_from([path for path in _paths(whole) if path]))
    _put(changed, path, data.draw(_ANYTHING))
    fault = ""
    try:
        scenario = scenario_of(changed)
        again = scenario_of(json.loads(json.dumps(scenario.effective)))
        assert again.effective == scenario.effective
        scenario.starts(1)
    except SwarmError as error:
        fault = str(error)
    assert "\n" not in fault
    assert len(fault) < 600


def _paths(data: object, path: Path = ()) -> Iterator[Path]:
    yield path
    items: Any = ()
    if isinstance(data, dict):
        items = data.items()
    elif isinstance(data, list):
        items = enumerate(data)
    for key, value in items:
        yield from _paths(value, (*path, key))


def _put(data: Any, path: Path, value: object) -> None:
    for key in path[:-1]:
        data = data[key]
    data[path[-1]] = value
