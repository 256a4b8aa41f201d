"""Metrics beyond the catalog in experiments: columns, errors, digests, traces measured later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.compare import Side, compare
from swarmd.sim.experiments.manifest import read_manifest
from swarmd.sim.experiments.rerun import warnings
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import simulate

FILE = """\
from swarmd.sim.metrics.own import metric

@metric(unit="m", better="more")
def seed(trace):
    return 10 * trace.meta["seed"]

def odd(trace):
    return 1 / trace.meta["seed"]

def order(trace):
    return hash("swarm") % 1000
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    return path


def small(duo: Path, out: Path, *metrics: str, **more: Any) -> Results:
    return simulate(duo, 2, set={"duration": 0.2}, out=out, metrics=metrics, **more)


@pytest.mark.integration
def test_they_are_columns_in_worker_processes_with_the_digest_in_the_manifest(
    duo: Path, file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x"
    results = small(duo, out, f"{file}:seed", f"{file}:odd", "report:none", cores=2)
    assert results.metric("mine.py:seed").tolist() == [0.0, 10.0]
    assert list(results.errors) == ["s0000"]
    assert "ZeroDivisionError" in results.errors["s0000"]["mine.py:odd"]
    assert list(results.unreported()) == ["report:none"]
    assert results.about("report:turns.max").unit == "rounds"  # as the pattern declares
    again = load_results(out)
    assert again.metrics[-3:] == ("mine.py:seed", "mine.py:odd", "report:none")
    assert again.errors == results.errors
    assert [one.unit for one in map(again.about, again.metrics[-3:])] == ["m", "", ""]
    with pytest.raises(ConfigError, match=r"did you mean 'mine\.py:seed'"):
        again.asked("seed")
    manifest = read_manifest(out)
    assert set(manifest.plugins) >= {f"{file}:seed", f"{file}:odd"}
    assert warnings(out) == []
    file.write_text(FILE.replace("10 *", "20 *"))
    with pytest.raises(ConfigError, match=r"mine\.py:odd has changed"):
        small(duo, out, f"{file}:seed", f"{file}:odd", "report:none")


@pytest.mark.integration
def test_sets_of_names_have_one_order_in_all_workers(duo: Path, file: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", "print(hash('swarm') % 1000)"]
    environment = {"PYTHONHASHSEED": "0"}
    told = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    results = small(duo, tmp_path / "x", f"{file}:order")
    assert results.metric("mine.py:order").tolist() == [float(told.stdout)] * 2


@pytest.mark.long
def test_traces_are_measured_later_and_again_by_changed_code(
    duo: Path, file: Path, tmp_path: Path
) -> None:
    results = small(duo, tmp_path / "x", f"{file}:odd")
    assert results.metric(f"{file}:seed").tolist() == [0.0, 10.0]
    file.write_text(FILE.replace("1 /", "1 + 0 *"))
    asked = results.asked("mine.py:odd")
    np.testing.assert_array_equal(results.metric("mine.py:odd"), [np.nan, 1.0])
    assert results.metric(asked).tolist() == [1.0, 1.0]
    assert results.errors == {"s0000": {}}
    (difference,) = compare(
        Side("a", results, ""), Side("b", results, ""), [results.asked(f"{file}:seed")]
    )
    assert (difference.unit, difference.mean_a) == ("m", 5.0)
    file.unlink()
    assert results.asked("mine.py:odd").name == "mine.py:odd"
    with pytest.raises(ConfigError, match="none"):
        results.metric("report:none")


@pytest.mark.parametrize("change", ["a new file", "another user", "other code"])
def test_a_file_that_results_name_is_imported_if_it_is_known_or_trusted(
    duo: Path, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: str
) -> None:
    out = tmp_path / "x"
    small(duo, out, f"{file}:odd")
    assert load_results(out).asked("mine.py:odd").origin == f"{file}:odd"
    manifest = out / "manifest.json"
    if change == "other code":
        file.write_text(FILE.replace("1 /", "1 + 0 *"))
    elif change == "another user":
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "other"))
    else:
        manifest.write_text(manifest.read_text().replace(f'"{file}:odd": ', '"gone.py:odd": '))
    results = load_results(out)
    known = results.about("mine.py:odd")
    for act in (results.asked, lambda _: known.series and known.series(results.traces[0])):
        with pytest.raises(ConfigError, match=r"mine\.py:odd .*--trust$"):
            act("mine.py:odd")
    trusted = load_results(out, is_trusted=True).asked("mine.py:odd")
    if change == "another user":  # who has run it now
        assert load_results(out).asked("mine.py:odd").digest == trusted.digest


def test_without_traces_a_metric_that_was_not_measured_is_refused(
    duo: Path, tmp_path: Path
) -> None:
    results = small(duo, tmp_path / "x", traces=False)
    with pytest.raises(SwarmError, match="--metrics report:state=wait"):
        results.metric("report:state=wait")


def test_two_metrics_of_one_name_are_refused(duo: Path, file: Path, tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    other = tmp_path / "b" / "mine.py"
    other.write_text(FILE)
    with pytest.raises(ConfigError, match=r"two metrics are named mine\.py:seed"):
        small(duo, tmp_path / "x", f"{file}:seed", f"{other}:seed")
    assert not (tmp_path / "x").exists()
