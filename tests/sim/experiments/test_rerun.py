"""Made again from the manifest alone, and a single other bit is told."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.rerun import rerun, trace_differences, warnings
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.trace import load_trace


@pytest.fixture
def results(duo: Path, tmp_path: Path) -> Results:
    return simulate(duo, seeds=2, set={"duration": 1}, out=tmp_path / "x")


def again(results: Results, tmp_path: Path) -> dict[str, str]:
    return rerun(results.folder, tmp_path / "y", 2)


def test_every_run_is_identical_even_without_the_scenario(
    results: Results, duo: Path, tmp_path: Path
) -> None:
    duo.unlink()
    before = {path: path.stat().st_mtime_ns for path in results.folder.rglob("*")}
    assert warnings(results.folder) == []
    assert again(results, tmp_path) == {"s0000": "", "s0001": ""}
    assert {path: path.stat().st_mtime_ns for path in results.folder.rglob("*")} == before


def test_one_other_bit_is_reported(results: Results, tmp_path: Path) -> None:
    path = results.folder / "traces" / "s0001.npz"
    trace = load_trace(path)
    pose = trace.pose.copy()
    pose[-1, 0, 2] = np.nextafter(pose[-1, 0, 2], np.inf)
    dataclasses.replace(trace, pose=pose).save(path)
    assert again(results, tmp_path) == {"s0000": "", "s0001": "trace: pose"}


@pytest.mark.parametrize(
    ("has_traces", "why"),
    [(True, "metrics of the same trace: minimum_gap"), (False, "metrics: minimum_gap")],
)
def test_other_metrics_are_reported_with_and_without_traces(
    results: Results, tmp_path: Path, has_traces: bool, why: str
) -> None:
    if not has_traces:
        shutil.rmtree(results.folder / "traces")
    table = results.folder / "runs.csv"
    old = repr(results.rows[1]["minimum_gap"])
    assert table.read_text().count(f",{old},") == 1
    table.write_text(table.read_text().replace(f",{old},", f",{float(old) + 1e-12!r},"))
    assert again(results, tmp_path) == {"s0000": "", "s0001": why}


def test_a_run_that_fails_now_is_reported(results: Results, duo: Path, tmp_path: Path) -> None:
    plugin = duo.parent / "plugins" / "moody.py"
    plugin.write_text(plugin.read_text().replace('self.params.end == "exit"', "True"))
    assert warnings(results.folder) == [f"plugin {duo.parent}/plugins/moody.py has changed"]
    found = again(results, tmp_path)
    assert found["s0000"].startswith("failed now: its process ended with code 7")


def test_without_a_folder_only_finished_runs_are_made_and_nothing_stays(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    table = results.folder / "runs.csv"
    table.write_text("".join(table.read_text().splitlines(keepends=True)[:2]))
    told: list[tuple[int, int, int]] = []
    found = rerun(
        results.folder, None, 1, lambda now: told.append((now.done, now.total, now.failed))
    )
    assert found == {"s0000": ""}
    assert (told[0], told[-1]) == ((0, 1, 0), (1, 1, 0))
    assert list((tmp_path / "temporary").iterdir()) == []


def test_nothing_to_compare_is_an_error(results: Results) -> None:
    with pytest.raises(ConfigError, match="--out"):
        rerun(results.folder, results.folder / ".." / results.folder.name, 1)
    table = results.folder / "runs.csv"
    table.write_text(table.read_text().splitlines(keepends=True)[0])
    with pytest.raises(ConfigError, match=str(results.folder)):
        rerun(results.folder, None, 1)


def test_traces_differ_in_values_types_and_words(results: Results) -> None:
    trace = results.traces[0]
    for other, names in (
        (trace, []),
        (dataclasses.replace(trace, t=-trace.t), ["t"]),
        (dataclasses.replace(trace, requested=None), ["requested"]),
        (dataclasses.replace(trace, ids=("a", "b")), ["ids"]),
        (dataclasses.replace(trace, safe=trace.safe.astype(np.float32)), ["safe"]),
        (dataclasses.replace(trace, meta={**trace.meta, "seed": 9}), ["meta"]),
        (dataclasses.replace(trace, report={"x": trace.t}), ["report"]),
    ):
        assert trace_differences(trace, other) == names
