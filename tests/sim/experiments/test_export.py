"""Experiments as tables, read again by other programs' libraries."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import SwarmError
from swarmd.sim.experiments.export import _save, export
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import COLUMNS
from tests.sim.conftest import write_duo
from tests.support.traces import trace_of

SPEED = "groups.all.parameters.speed"


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """The results of two variants, for reading alone."""
    folder, sweep = tmp_path_factory.mktemp("results"), {SPEED: [0.1, 0.2]}
    return simulate(write_duo(folder), 1, set={"duration": 0.5}, sweep=sweep, out=folder / "x")


def test_results_are_a_table_of_runs_and_traces_of_instants_and_robots(results: Results) -> None:
    table = results.frame()
    assert table[["run", "variant", SPEED]].values.tolist() == [
        ["speed=0.1_s0000", "speed=0.1", 0.1],
        ["speed=0.2_s0000", "speed=0.2", 0.2],
    ]
    np.testing.assert_array_equal(table["path_length"], results.metric("path_length"))
    assert table["consensus_time"].isna().all()
    trace = results.traces[0]
    long = trace.frame()
    assert len(long) == len(trace.t) * len(trace.ids)
    assert [name for name in COLUMNS if name in long] == [
        name for name in long if not name.startswith("report:")
    ]
    last = long[(long["robot"] == trace.ids[1]) & (long["t"] == trace.t[-1])].iloc[0]
    assert (last["x"], last["y"]) == tuple(trace.pose[-1, 1, :2])
    assert last["state"] == trace.state[-1, 1]  # type: ignore[index]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_tables_are_read_again(results: Results, form: str, tmp_path: Path) -> None:
    import pandas  # here, since each worker of pytest imports this module: 0.3 s

    read = {"csv": pandas.read_csv, "parquet": pandas.read_parquet}[form]
    names = [f"results.{form}", *(f"traces/{run.id}.{form}" for run in results.runs)]
    files = [*export(results, form, tmp_path / "out")]  # type: ignore[arg-type]
    assert [str(path.relative_to(tmp_path / "out")) for path in files] == names
    np.testing.assert_array_equal(read(files[0])["path_length"], results.metric("path_length"))
    table = read(files[2])
    assert set(table["variant"]) == {"speed=0.2"}
    np.testing.assert_array_equal(table["x"], results.traces[1].pose[..., 0].ravel())


def test_a_formula_is_text_in_csv(tmp_path: Path) -> None:
    import pandas

    table = pandas.DataFrame({"=name": ["=1+1", "-1", None], "x": [-1.0, 0.5, 2.0]})
    _save(table, "csv", tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert lines == ["'=name,x", "'=1+1,-1.0", "-1,0.5", ",2.0"]


def test_a_missing_trace_leaves_no_table_of_it(results: Results, tmp_path: Path) -> None:
    shutil.copytree(results.folder, tmp_path / "x", ignore=shutil.ignore_patterns("*.npz"))
    without = load_results(tmp_path / "x")
    with pytest.raises(SwarmError, match="no trace"):
        list(export(without, "csv", tmp_path / "other"))
    assert [path.name for path in (tmp_path / "other").rglob("*")] == ["results.csv"]
    (only,) = export(without, "csv", tmp_path / "other", traces=False)
    assert only.name == "results.csv"


def test_a_file_that_cannot_be_written_is_one_line_and_leaves_nothing(
    results: Results, tmp_path: Path
) -> None:
    (tmp_path / "out").write_text("")
    with pytest.raises(SwarmError, match="out"):
        next(export(results, "csv", tmp_path / "out"))
    assert (tmp_path / "out").read_text() == ""


def test_without_pandas_the_command_that_installs_it_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(SwarmError, match=r"swarmd\[table\]"):
        trace_of(np.zeros((1, 1, 3))).frame()
