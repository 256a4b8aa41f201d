"""The examples in docstrings of modules run as they stand."""

from __future__ import annotations

import inspect
import re
import textwrap
from importlib import import_module
from typing import Any

import numpy as np
import pytest

import swarmd.sim.experiments.simulate
import swarmd.sim.metrics.own
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.testing.driver_contract import DriverContract
from swarmd.testing.pattern_contract import PatternContract
from tests.support.traces import trace_of

EXAMPLE = re.compile(r"::\n\n((?:    .*\n|\n)+)")


def ran(module: str, **given: object) -> dict[str, Any]:
    """The names that the example in the docstring of a module leaves, with those that it lacks."""
    text = inspect.getdoc(import_module(module))
    (example,) = EXAMPLE.findall(f"{text}\n")
    names: dict[str, Any] = {"__name__": module, **given}
    exec(textwrap.dedent(example), names)
    return names


@pytest.mark.long
def test_that_of_simulate_runs_both_spacings(monkeypatch: pytest.MonkeyPatch) -> None:
    """With runs of 4 s."""

    def short(*words: Any, set: dict[str, Any], **options: Any) -> Results:
        return simulate(*words, set={**set, "duration": 4}, **options)

    monkeypatch.setattr(swarmd.sim.experiments.simulate, "simulate", short)
    results = ran(swarmd.sim.experiments.simulate.__name__)["results"]
    assert isinstance(results, Results)
    assert results.variants == ("spacing=0.6", "spacing=0.8")
    assert len(results.rows) == 6


def test_that_of_metrics_counts_robots_near_a_place() -> None:
    warm = ran(swarmd.sim.metrics.own.__name__)["warm"]
    trace = trace_of(np.array([[(1.5, 0.0, 0.0), (4.0, 0.0, 0.0)]]))
    assert warm(trace).tolist() == [0.5]


@pytest.mark.parametrize(
    ("contract", "name", "given"),
    [
        (PatternContract, "TestSwirl", {"Swirl": object}),
        (DriverContract, "TestMyDriver", {"MyRig": object}),
    ],
)
def test_those_of_contracts_make_a_test_class(
    contract: type, name: str, given: dict[str, object]
) -> None:
    assert issubclass(ran(contract.__module__, **given)[name], contract)
