"""Custom metrics, in files and packages."""

from __future__ import annotations

import hashlib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.metrics import own
from swarmd.sim.metrics.catalog import beyond_catalog, measure, metric_of
from swarmd.sim.metrics.own import MetricError
from swarmd.sim.trace import Trace
from tests.sim.metrics.runs import run

FILE = '''\
import numpy as np
from swarmd.sim.metrics.own import metric

@metric(unit="m", better="less", is_time_to_event=True)
def robots(trace):
    """How many there are.

    More text.
    """
    return len(trace.ids)

def seconds(trace):
    return trace.t

seconds.unit = "s"

def never(trace):
    return None

def one(trace):
    return np.bool_(True)

def broken(trace):
    return 1 / 0

def text(trace):
    return "x"

def rows(trace):
    return trace.pose
'''


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


@pytest.fixture
def trace() -> Trace:
    return run(np.zeros((5, 2, 3)))


def test_a_function_of_a_file_is_a_metric_with_unit_direction_and_digest(file: Path) -> None:
    found = metric_of(f"{file}:robots")
    assert (found.name, found.origin) == ("mine.py:robots", f"{file}:robots")
    assert (found.unit, found.better, found.is_time_to_event) == ("m", "less", True)
    assert found.meaning == "How many there are."
    assert found.digest == hashlib.sha256(FILE.encode()).hexdigest()
    assert metric_of(f"{file}:seconds").unit == "s"


@pytest.mark.parametrize(
    ("name", "value"), [("robots", 2.0), ("seconds", 0.3), ("never", None), ("one", 1.0)]
)
def test_it_gives_a_number_or_values_over_time(
    file: Path, trace: Trace, name: str, value: float | None
) -> None:
    (found,) = measure(trace, [f"{file}:{name}"]).values()
    assert found == (None if value is None else pytest.approx(value))


def test_values_over_time_can_be_drawn(file: Path, trace: Trace) -> None:
    series = metric_of(f"{file}:seconds").series
    assert series is not None
    np.testing.assert_array_equal(series(trace), trace.t)
    assert metric_of(f"{file}:robots").series(trace) is None  # type: ignore[misc]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("broken", ("ZeroDivisionError", "mine.py:24")),
        ("text", ("a str",)),
        ("rows", ("(5, 2, 3)", "(5,)")),
    ],
)
def test_an_error_names_its_line_or_the_wrong_value(
    file: Path, trace: Trace, name: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(MetricError) as caught:
        measure(trace, [f"{file}:{name}"])
    assert all(word in str(caught.value) for word in words)


def test_a_changed_file_is_read_again(file: Path, trace: Trace) -> None:
    before = metric_of(f"{file}:robots")
    file.write_text("def robots(trace):\n    return 7\n")
    after = metric_of(f"{file}:robots")
    assert (before.value(trace), after.value(trace)) == (2.0, 7.0)
    assert before.digest != after.digest


def test_what_is_missing_or_faulty_is_named(file: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="robots"):
        metric_of(f"{file}:robot")
    with pytest.raises(ConfigError, match=r"none\.py"):
        metric_of(f"{tmp_path}/none.py:x")
    file.write_text("def x(:\n")
    with pytest.raises(ConfigError, match="SyntaxError"):
        metric_of(f"{file}:x")
    file.write_text("def x(t): ...\nx.better = 'up'\n")
    with pytest.raises(ConfigError, match="'up'"):
        metric_of(f"{file}:x")


def test_metrics_of_packages_are_found_by_name(
    monkeypatch: pytest.MonkeyPatch, trace: Trace
) -> None:
    point = EntryPoint("span", f"{__name__}:span", own.GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: span)
    monkeypatch.setattr(own, "entry_points_of", lambda group: [point] if group == own.GROUP else [])
    assert measure(trace, ["span"]) == {"span": pytest.approx(0.4)}
    assert metric_of("span").digest
    with pytest.raises(ConfigError, match="span"):
        metric_of("spam")


def span(trace: Trace) -> float:
    """Its duration."""
    return trace.duration


def test_metrics_beyond_the_catalog_are_named_once(file: Path) -> None:
    names = ["gather_time", f"{file}:one", "report:x", f"{file}:one"]
    found = beyond_catalog(map(metric_of, names))
    assert [one.name for one in found] == ["mine.py:one", "report:x"]
