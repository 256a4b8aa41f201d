"""Made again from the manifest alone, and a single other bit is told."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.rerun import rerun, warnings
from swarmd.sim.experiments.results import Results, load_results
from swarmd.sim.experiments.simulate import simulate
from swarmd.sim.experiments.trace_differences import first_difference, trace_differences
from swarmd.sim.experiments.trust import check_code
from swarmd.sim.trace import load_trace
from tests.sim.conftest import write_duo


@pytest.fixture(scope="module")
def conducted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of four runs, whose scenario is gone."""
    folder = tmp_path_factory.mktemp("conducted")
    duo = write_duo(folder)
    simulate(duo, seeds=4, set={"duration": 0.6}, out=folder / "x")
    duo.unlink()
    return folder / "x"


@pytest.fixture
def results(conducted: Path, tmp_path: Path) -> Results:
    """The same for a test's own use."""
    return load_results(shutil.copytree(conducted, tmp_path / "x"))


def again(results: Results, tmp_path: Path) -> dict[str, str]:
    return rerun(results.folder, tmp_path / "y", 1)


def stamps(folder: Path) -> dict[Path, int]:
    return {path: path.stat().st_mtime_ns for path in folder.rglob("*")}


def test_a_pattern_that_is_not_installed_is_named(results: Results, tmp_path: Path) -> None:
    path = results.folder / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["variants"][0]["effective"]["groups"]["all"]["pattern"] = "of_another_computer"
    path.write_text(json.dumps(manifest))
    with pytest.raises(ConfigError, match="'of_another_computer'"):
        again(results, tmp_path)


@pytest.mark.integration
def test_each_other_bit_is_reported_even_without_the_scenario(
    results: Results, tmp_path: Path
) -> None:
    assert warnings(results.folder) == []
    traces, table = results.folder / "traces", results.folder / "runs.csv"
    trace = load_trace(traces / "s0001.npz")
    pose = trace.pose.copy()
    pose[-1, 0, 2] = np.nextafter(pose[-1, 0, 2], np.inf)
    dataclasses.replace(trace, pose=pose).save(traces / "s0001.npz")
    for row in results.rows[2:]:
        old = repr(row["minimum_gap"])
        assert table.read_text().count(f",{old},") == 1
        table.write_text(table.read_text().replace(f",{old},", f",{float(old) + 1e-12!r},"))
    (traces / "s0003.npz").unlink()
    before = stamps(results.folder)
    assert again(results, tmp_path) == {
        "s0000": "",
        "s0001": f"trace: pose; first at 0.60 s: pose of {trace.ids[0]}",
        "s0002": "metrics of the same trace: minimum_gap",
        "s0003": "metrics: minimum_gap",
    }
    assert stamps(results.folder) == before


@pytest.mark.integration
def test_the_new_results_show_the_metrics_that_the_old_ones_show(
    results: Results, tmp_path: Path
) -> None:
    path = results.folder / "manifest.json"
    manifest = json.loads(path.read_bytes()) | {"shown": ["minimum_gap"]}
    path.write_text(json.dumps(manifest))
    again(results, tmp_path)
    assert json.loads((tmp_path / "y" / "manifest.json").read_bytes())["shown"] == ["minimum_gap"]


@pytest.mark.integration
def test_a_run_that_fails_now_is_reported(duo: Path, tmp_path: Path) -> None:
    results = simulate(duo, seeds=1, set={"duration": 0.6}, out=tmp_path / "x")
    plugin = duo.parent / "plugins" / "moody.py"
    plugin.write_text(plugin.read_text().replace('self.params.end == "exit"', "True"))
    for act in (warnings, lambda folder: rerun(folder, None, 1)):
        with pytest.raises(ConfigError, match=r"moody\.py has changed.*--trust"):
            act(results.folder)
    told = warnings(results.folder, is_trusted=True)
    assert told == [f"plugin {plugin} has changed"]
    found = rerun(results.folder, tmp_path / "y", 1, is_trusted=True)
    assert found["s0000"].startswith("failed now: its process ended with code 7")


def test_functions_that_give_other_bits_are_a_likelier_cause_than_a_name(results: Results) -> None:
    path = results.folder / "manifest.json"
    manifest = json.loads(path.read_bytes())
    manifest["made_with"] |= {"libm": "0badf00d", "mujoco": "1.0.0", "kernels": "of another kind"}
    path.write_text(json.dumps(manifest))
    first, second, third = warnings(results.folder)
    assert "C library" in first
    assert "mujoco" in second
    assert "kernels" in third


@pytest.mark.integration
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


@pytest.mark.integration
@pytest.mark.parametrize("value", ["~no_such_user/x", "a\0", 5, ["a"], "gone"])
def test_a_folder_of_patterns_that_is_none_is_one_line(results: Results, value: object) -> None:
    path = results.folder / "manifest.json"
    manifest = json.loads(path.read_text())
    for variant in manifest["variants"]:
        variant["effective"]["plugin_dir"] = value
    path.write_text(json.dumps(manifest))
    try:
        found = rerun(results.folder, None, 1)
    except ConfigError as error:
        found = {"": str(error)}
    assert all("plugin_dir" in why and "\n" not in why for why in found.values())


@pytest.mark.parametrize(
    ("recorded", "fault"),
    [({"a.py": "odd\n\x1bdigest"}, "has changed"), ({"a.py": ""}, "is new"), ({}, "is new")],
)
def test_a_refusal_quotes_no_digest_of_a_manifest(
    tmp_path: Path, recorded: dict[str, str], fault: str
) -> None:
    with pytest.raises(ConfigError, match=f"a[.]py {fault}") as refusal:
        check_code(tmp_path, recorded, {"a.py": 64 * "0"}, is_trusted=False)
    assert str(refusal.value).isprintable()
    assert "digest" not in str(refusal.value)


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


def test_the_first_instant_that_differs_is_told_with_its_fields_and_robot(results: Results) -> None:
    trace = results.traces[0]
    assert trace.requested is not None
    pose, safe, requested = trace.pose.copy(), trace.safe.copy(), trace.requested.copy()
    pose[4, 1, 2] = np.nextafter(pose[4, 1, 2], np.inf)
    safe[6, 0, 0] += 1.0
    requested[4, 0, 1] = -0.0 if requested[4, 0, 1] == 0.0 else -requested[4, 0, 1]
    other = dataclasses.replace(trace, pose=pose, safe=safe)
    assert first_difference(trace, other) == f"first at {trace.t[4]:.2f} s: pose of {trace.ids[1]}"
    other = dataclasses.replace(other, requested=requested)
    alone = f"first at {trace.t[4]:.2f} s: requested of {trace.ids[0]}"
    assert first_difference(trace, other) == alone
    pose[4, 0, 1] += 1.0
    both = f"first at {trace.t[4]:.2f} s: requested, pose of {trace.ids[0]}"
    assert first_difference(trace, other) == both
    shorter = dataclasses.replace(other, t=trace.t[:4], pose=pose[:4], safe=safe[:4])
    assert first_difference(trace, dataclasses.replace(shorter, requested=requested[:4])) == ""
    assert first_difference(trace, dataclasses.replace(trace, ids=("a", "b"))) == ""


@pytest.mark.integration
def test_a_pattern_of_a_path_is_kept_with_its_folder_and_digests(tmp_path: Path) -> None:
    duo = write_duo(tmp_path)
    duo.write_text(duo.read_text().replace("plugin_dir: plugins\n", ""))
    duo.write_text(duo.read_text().replace("pattern: moody", "pattern: plugins/moody.py"))
    results = simulate(duo, seeds=1, set={"duration": 0.6}, out=tmp_path / "x")
    duo.unlink()
    manifest = json.loads((results.folder / "manifest.json").read_text())
    (variant,) = manifest["variants"]
    file = duo.parent / "plugins" / "moody.py"
    assert variant["effective"]["plugin_dir"] == str(file.parent)
    assert variant["effective"]["groups"]["all"]["pattern"] == "moody"
    assert str(file) in manifest["plugins"]
    assert set(rerun(results.folder, None, 1).values()) == {""}
    file.write_text(f"{file.read_text()}\n# changed\n")
    with pytest.raises(ConfigError, match="changed"):
        rerun(results.folder, None, 1)


def test_a_path_in_a_manifest_of_others_is_not_followed(results: Results, tmp_path: Path) -> None:
    """The digests are those of `plugin_dir`: a path would lead to a file beside them."""
    path = results.folder / "manifest.json"
    manifest = json.loads(path.read_text())
    beside = tmp_path / "beside.py"
    beside.write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    manifest["variants"][0]["effective"]["groups"]["all"]["pattern"] = str(beside)
    path.write_text(json.dumps(manifest))
    with pytest.raises(ConfigError, match="is a path"):
        again(results, tmp_path)
    assert not (tmp_path / "ran").exists()
