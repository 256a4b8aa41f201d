"""Parts of an experiment, run apart and joined, are what one machine gives, bit for bit."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.manifest import read_manifest, write_json
from swarmd.sim.experiments.merge import merge
from swarmd.sim.experiments.rerun import rerun
from swarmd.sim.experiments.simulate import simulate
from tests.sim.conftest import write_duo

SWEEP = {"groups.all.count": [2, 1]}


def run(duo: Path, out: Path, **more: Any) -> Path:
    simulate(duo, **{"seeds": 2, "set": {"duration": 0.5}, "sweep": SWEEP, **more, "out": out})
    return out


@pytest.fixture(scope="module")
def conducted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scenario, its three parts and the folder of one machine, for reading alone."""
    folder = tmp_path_factory.mktemp("conducted")
    duo = write_duo(folder)
    run(duo, folder / "whole")
    for k in (1, 2, 3):
        run(duo, folder / f"part-{k}", shard=f"{k}/3")
    return folder


@pytest.fixture
def duo(conducted: Path) -> Path:
    return conducted / "duo" / "duo.yaml"


@pytest.fixture
def whole(conducted: Path) -> Path:
    return conducted / "whole"


@pytest.fixture
def parts(conducted: Path, tmp_path: Path) -> list[Path]:
    """The three parts, for a test's own use."""
    names = [f"part-{k}" for k in (1, 2, 3)]
    return [shutil.copytree(conducted / name, tmp_path / name) for name in names]


def table(folder: Path) -> list[str]:
    return [line.rpartition(",")[0] for line in (folder / "runs.csv").read_text().splitlines()]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.integration
def test_all_parts_give_the_folder_of_one_machine(
    whole: Path, parts: list[Path], tmp_path: Path
) -> None:
    results, lacking = merge([parts[2], parts[0], parts[1]], tmp_path / "m")
    assert lacking == []
    assert len(results.rows) == 4
    assert table(tmp_path / "m") == table(whole)
    for path in (whole / "traces").iterdir():
        assert (tmp_path / "m" / "traces" / path.name).read_bytes() == path.read_bytes()
    one, other = (read_manifest(folder) for folder in (whole, tmp_path / "m"))
    assert msgspec.structs.replace(one, created="") == msgspec.structs.replace(other, created="")
    assert set(rerun(tmp_path / "m", None, 1).values()) == {""}


@pytest.mark.long
def test_an_incomplete_merge_names_what_is_missing_and_goes_on(
    whole: Path, parts: list[Path], tmp_path: Path
) -> None:
    part = parts[2]
    kept = table(part)[1].split(",")[0]
    gone = table(part)[2].split(",")[0]
    lines = (part / "runs.csv").read_text().splitlines(keepends=True)
    (part / "runs.csv").write_text("".join(lines[:2]))
    results, (of_part, of_none) = merge([part, parts[0]], tmp_path / "m")
    assert kept in [row["run"] for row in results.rows]
    assert of_part == f"{part} (part 3/3): 1 of 2 runs: {gone}"
    assert of_none == f"part 2/3, in no folder: {table(parts[1])[1].split(',')[0]}"
    (part / "runs.csv").write_text("".join(lines))
    results, lacking = merge(parts, tmp_path / "m")
    assert (len(results.rows), lacking) == (4, [])
    assert table(tmp_path / "m") == table(whole)


def test_only_parts_with_missing_runs_are_named(duo: Path, tmp_path: Path) -> None:
    parts = [run(duo, tmp_path / f"of-6-{k}", shard=f"{k}/6") for k in (1, 2)]
    merge([parts[0]], tmp_path / "m")
    _, (line,) = merge([parts[1]], tmp_path / "m")
    # Part 1 is there already, and parts 5 and 6 have no runs: the experiment has four.
    assert line.startswith("part 3/6, 4/6, in no folder: ")


def test_parts_may_overlap_if_they_agree(duo: Path, parts: list[Path], tmp_path: Path) -> None:
    shutil.copytree(parts[0], tmp_path / "again")
    assert merge([*parts, tmp_path / "again"], tmp_path / "m")[1] == []
    other = run(duo, tmp_path / "half", shard="1/2")
    assert merge([*parts, other], tmp_path / "m2")[1] == []
    name = table(parts[0])[1].split(",")[0]
    trace = tmp_path / "again" / "traces" / f"{name}.npz"
    trace.write_bytes(trace.read_bytes()[:-1] + b"x")
    with pytest.raises(ConfigError, match=f"again: their results of run {name} differ"):
        merge([*parts, tmp_path / "again"], tmp_path / "m3")
    assert not (tmp_path / "m3").exists()


def test_a_row_that_differs_is_refused(parts: list[Path], tmp_path: Path) -> None:
    shutil.copytree(parts[0], tmp_path / "again")
    path = tmp_path / "again" / "runs.csv"
    head, first, *rest = path.read_text().splitlines(keepends=True)
    cells = first.split(",")
    place = head.split(",").index("path_length")
    cells[place] = repr(float(cells[place]) + 1e-12)
    path.write_text("".join([head, ",".join(cells), *rest]))
    with pytest.raises(ConfigError, match=f"run {cells[0]} differ"):
        merge([*parts, tmp_path / "again"], tmp_path / "m")


Change = Callable[[dict[str, Any]], object]


@pytest.mark.parametrize(
    ("change", "subject"),
    [
        (lambda m: m.update(scenario="other"), "scenario was"),
        (lambda m: m.update(seeds=[0, 1, 2]), "seeds was"),
        (lambda m: m.update(sets={"duration": 0.4}), "sets was"),
        (lambda m: m.update(traces=False), "traces was"),
        (lambda m: m["made_with"].update(swarmd="9"), "swarmd was"),
        (lambda m: m["made_with"].update(code="9"), "code has changed"),
        (lambda m: m["made_with"].update(kernels="of another kind"), "kernels was"),
        (lambda m: m["plugins"].clear(), "plugin"),
        (lambda m: m["variants"][0]["effective"].update(duration=9.0), "contents"),
    ],
)
def test_what_does_not_belong_together_is_refused_and_nothing_is_made(
    parts: list[Path], tmp_path: Path, change: Change, subject: str
) -> None:
    manifest = json.loads((parts[1] / "manifest.json").read_text())
    change(manifest)
    write_json(parts[1] / "manifest.json", manifest)
    before = contents(tmp_path)
    with pytest.raises(ConfigError, match=f"{parts[0]} and {parts[1]} .*{subject}"):
        merge(parts, tmp_path / "m")
    assert contents(tmp_path) == before


def test_processors_may_differ_and_the_manifest_names_them_all(
    parts: list[Path], tmp_path: Path
) -> None:
    manifest = json.loads((parts[1] / "manifest.json").read_text())
    manifest["made_with"]["simd"] = "A"
    write_json(parts[1] / "manifest.json", manifest)
    simd = read_manifest(parts[0]).made_with["simd"]
    merge(parts, tmp_path / "m")
    names = sorted(["A", simd])
    assert read_manifest(tmp_path / "m").made_with["simd"] == " or ".join(names)


def test_missing_traces_and_folders_are_named(parts: list[Path], tmp_path: Path) -> None:
    name = table(parts[0])[1].split(",")[0]
    (parts[0] / "traces" / f"{name}.npz").unlink()
    for folders, subject in (
        (parts, f"{name}.npz"),
        ([*parts, tmp_path / "none"], f"{tmp_path / 'none'}: no experiment"),
    ):
        with pytest.raises(ConfigError, match=subject):
            merge(folders, tmp_path / "m")
    with pytest.raises(ConfigError, match="--out"):
        merge(parts[1:], parts[1])
    assert not (tmp_path / "m").exists()
