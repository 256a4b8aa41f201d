"""Experiments from Python, also in a script without a guard."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.cli.progress import progress
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import Progress, simulate
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.trace import Trace
from tests.sim.conftest import write_duo

SPEED = "groups.all.parameters.speed"
END = "groups.all.parameters.end"


def small(duo: Path, **more: Any) -> Results:
    return simulate(duo, **{"seeds": 2, "set": {"duration": 1}, **more})


def metrics(results: Results) -> list[dict[str, Any]]:
    return [{k: v for k, v in row.items() if k != "wall"} for row in results.rows]


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """The results of two runs in a folder, for reading alone."""
    folder = tmp_path_factory.mktemp("plain")
    return small(write_duo(folder), out=folder / "x")


def test_results_have_rows_statistics_and_traces(plain: Results) -> None:
    assert [(row["run"], row["seed"]) for row in plain.rows] == [("s0000", 0), ("s0001", 1)]
    paths = plain.metric("path_length")
    assert paths.shape == (2,)
    summary = plain.summary()["path_length"]
    assert summary.mean == pytest.approx(paths.mean())
    assert summary.mean_interval is not None
    assert isinstance(plain.traces[0], Trace)
    assert [trace.meta["seed"] for trace in plain.traces] == [0, 1]
    assert plain.traces["s0001"].meta["seed"] == 1
    assert plain.traces[-1].meta["seed"] == 1
    assert repr(plain) == f"Results({str(plain.folder)!r}, 2 of 2 runs)"
    assert len(repr(plain.runs)) < 100 * len(plain.runs)  # without the whole scenario
    text = str(plain)
    assert f"{plain.plan.scenario}: 2 of 2 runs" in text
    assert "path_length" in text
    *rows, left_out = text.splitlines()
    assert not any(row.startswith("items_delivered") for row in rows)
    assert left_out.startswith("without a value")
    assert "items_delivered" in left_out
    assert "items_delivered" in plain.text(["items_delivered"]).splitlines()[-1]
    with pytest.raises(ConfigError, match="'path_length'"):
        plain.metric("path_lenght")
    with pytest.raises(ConfigError, match="'s0009'"):
        plain.traces["s0009"]
    with pytest.raises(IndexError):
        plain.traces[2]


@pytest.mark.integration
def test_without_a_folder_nothing_stays(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    traces = small(duo).traces  # which keep the folder
    gc.collect()
    assert [path.is_dir() for path in temporary.iterdir()] == [True]
    assert len(list(traces)) == 2
    del traces
    gc.collect()
    assert list(temporary.iterdir()) == []
    with pytest.raises(SwarmError, match="s0000"):
        small(duo, seeds=1, set={END: "exit"}, jobs=2)
    gc.collect()
    assert list(temporary.iterdir()) == []


@pytest.mark.integration
@pytest.mark.long
def test_a_folder_is_not_done_again_and_a_script_without_a_guard_gives_the_same_bits(
    plain: Results, tmp_path: Path
) -> None:
    duo, folder = plain.plan.scenario, plain.folder
    stamps = {path: path.stat().st_mtime_ns for path in (folder / "traces").iterdir()}
    again = small(Path(duo), out=folder)
    assert metrics(again) == metrics(plain) == metrics(load_results(folder))
    assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
    script = tmp_path / "script.py"
    script.write_text(
        "from swarmd.sim.experiments.simulate import simulate\n"
        f"results = simulate({duo!r}, 1, set={{'duration': 1}}, jobs=2, out='2')\n"
        "print(len(results.rows))\n"
    )
    done = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "1\n", "")
    assert metrics(load_results(tmp_path / "2")) == metrics(plain)[:1]
    one, other = (place / "traces" / "s0000.npz" for place in (folder, tmp_path / "2"))
    assert one.read_bytes() == other.read_bytes()


def test_sweeps_have_a_variant_for_each_point(duo: Path) -> None:
    results = small(duo, set={"duration": 0.3}, sweep={SPEED: [0.1, 0.2]})
    assert results.variants == ("speed=0.1", "speed=0.2")
    assert [row[SPEED] for row in results.rows] == [0.1, 0.1, 0.2, 0.2]
    slow, fast = (results.metric("path_length", name) for name in results.variants)
    assert (fast > slow).all()
    np.testing.assert_array_equal(results.metric("path_length"), [*slow, *fast])
    assert results.summary("speed=0.2")["path_length"].mean == pytest.approx(fast.mean())
    with pytest.raises(ConfigError, match="2 variants"):
        results.summary()
    with pytest.raises(ConfigError, match=r"'speed=0\.3'"):
        results.summary("speed=0.3")


def test_progress_is_told_after_each_run(duo: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told: list[Progress] = []
    small(duo, on_progress=told.append, in_process=True)  # workers report shares of runs, too
    assert [(one.done, one.total, one.failed) for one in told] == [(0, 2, 0), (1, 2, 0), (2, 2, 0)]
    assert [one.worked for one in told] == [0.0, told[0].left / 2, told[0].left]
    assert told[-1].left == 0.0
    assert capsys.readouterr() == ("", "")
    with progress() as show:
        small(duo, on_progress=show)
    assert "2 of 2 runs" in capsys.readouterr().err


def test_a_scenario_that_is_loaded_can_be_run_and_changed(duo: Path) -> None:
    loaded = load_scenario(duo, {"duration": 0.3})
    results = simulate(loaded, seeds=[4], sweep={SPEED: [0.05, 0.2]})
    assert metrics(results)[1] == {
        **metrics(simulate(duo, seeds=[4], set={"duration": 0.3, SPEED: 0.2}))[0],
        "run": "speed=0.2_s0004", "variant": "speed=0.2", SPEED: 0.2,
    }  # fmt: skip


def test_seeds_may_be_numbers_of_numpy(duo: Path) -> None:
    three = small(duo, seeds=np.int64(3), set={"duration": 0.1})
    some = small(duo, seeds=np.arange(2) + 1, set={"duration": 0.1})
    assert [row["seed"] for row in three.rows] == [0, 1, 2]
    assert metrics(some) == metrics(three)[1:]


@pytest.mark.integration
def test_failed_runs_are_reported_and_the_others_kept(duo: Path) -> None:
    results = small(duo, seeds=1, sweep={END: ["exit", "none"]}, jobs=2)
    assert list(results.failures) == ["end=exit_s0000"]
    assert [row["run"] for row in results.rows] == ["end=none_s0000"]
    assert "1 of 2 runs, 1 failed" in str(results)


@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ({"jobs": 0}, "jobs"),
        ({"timeout": 0.5}, "timeout"),
        ({"seeds": 0}, "seeds"),
        ({"seeds": [1, 1]}, "seeds: 1"),
        ({"sweep": {"duration": []}}, "sweep duration"),
        ({"sweep": {"duraton": [1]}}, "'duration'"),
        ({"sweep": {"duration": [1, -1]}}, "duration"),
        ({"scenario": "agregation"}, "'aggregation'"),
        ({"set": {"arena.size": [0.2, 0.2]}}, "start"),
    ],
)
def test_mistakes_are_found_before_anything_runs(
    duo: Path, tmp_path: Path, arguments: dict[str, Any], fault: str
) -> None:
    with pytest.raises(ConfigError, match=fault):
        simulate(**{"scenario": duo, "out": tmp_path / "x", **arguments})
    assert not (tmp_path / "x").exists()
