"""The folder of an experiment is complete at every instant; other folders are not changed."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.manifest import Manifest, manifest_of
from swarmd.sim.experiments.plan import Plan, Variant, make_plan
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.store import (
    TABLE,
    Row,
    cell,
    header,
    lines,
    open_store,
    read_failures,
    read_table,
)

METRICS = ("gap", "time")
VALUES = {"gap": 0.5, "time": None}


@pytest.fixture
def manifest(duo: Path) -> Manifest:
    return manifest_of(plan_of(duo, range(3)), traces=True, command=[])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "deep" / "x"


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_new_folder_is_an_experiment_from_the_beginning(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        assert names(folder) == ["manifest.json", "runs.csv", "traces"]
        assert [run.id for run in store.missing] == ["s0000", "s0001", "s0002"]
        assert store.trace_of(store.missing[0]) == folder / "traces" / "s0000.npz"


def test_rows_are_written_at_once_and_sorted_at_the_end(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        for run in reversed(store.missing):
            store.add(run, VALUES, 0.25)
            assert run.id in read_table(folder, store.plan)[1]
        assert (folder / "runs.csv").read_text().splitlines()[1].startswith("s0002,")
        store.close({"some": "thing"})
    lines = (folder / "runs.csv").read_text().splitlines()
    assert [line[:5] for line in lines[1:]] == ["s0000", "s0001", "s0002"]
    assert json.loads((folder / "summary.json").read_text()) == {
        "apiVersion": "swarm/v1", "kind": "ExperimentSummary", "some": "thing",
    }  # fmt: skip


def test_goes_on_after_a_torn_line_and_a_partial_trace(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[1], VALUES, 0.25)
    whole = (folder / "runs.csv").read_bytes()
    (folder / "runs.csv").write_bytes(whole + b"s0000,,0,1.")
    (folder / "traces" / ".s0000.npz.partial").write_bytes(b"PK")
    with open_store(folder, manifest, METRICS) as store:
        assert [run.id for run in store.missing] == ["s0000", "s0002"]
        assert store.rows["s0001"].metrics == VALUES
        assert names(folder / "traces") == []
        store.add(store.missing[0], VALUES, 0.25)
        assert list(read_table(folder, store.plan)[1]) == ["s0000", "s0001"]


def test_a_table_of_an_earlier_version_goes_on_with_the_columns_of_today(
    folder: Path, manifest: Manifest
) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[0], VALUES, 0.25)
    table = folder / "runs.csv"
    table.write_text("run,variant,seed,gap,time,wall\ns0000,,0,0.5,,0.250\n")
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[0], VALUES, 0.25, bits="0123456789ab", rules=("contact",))
    assert table.read_text().splitlines() == [
        "run,variant,seed,gap,time,bits,rules,wall",
        "s0000,,0,0.5,,,,0.250",
        "s0001,,1,0.5,,0123456789ab,contact,0.250",
    ]


def test_begins_where_a_manifest_or_a_table_was_never_finished(
    folder: Path, manifest: Manifest
) -> None:
    folder.mkdir(parents=True)
    (folder / ".manifest.json.partial").touch()
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3
    (folder / "runs.csv").unlink()
    (folder / "traces").rmdir()
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3
        assert names(folder) == ["manifest.json", "runs.csv", "traces"]


@pytest.mark.parametrize("name", ["notes.txt", "runs.csv", "traces", ".hidden"])
def test_a_folder_with_other_files_is_not_changed(
    folder: Path, manifest: Manifest, name: str
) -> None:
    folder.mkdir(parents=True)
    (folder / name).write_text("mine")
    with (
        pytest.raises(ConfigError, match=name),
        open_store(folder, manifest, METRICS),
    ):
        pass
    assert names(folder) == [name]
    assert (folder / name).read_text() == "mine"


@pytest.mark.parametrize("place", ["file", "file/below", "/proc/nowhere"])
def test_a_folder_that_cannot_be_made_is_named(
    tmp_path: Path, manifest: Manifest, place: str
) -> None:
    (tmp_path / "file").write_text("mine")
    with (
        pytest.raises(SwarmError, match=str(tmp_path / place.partition("/below")[0])),
        open_store(tmp_path / place, manifest, METRICS),
    ):
        pass


@pytest.mark.parametrize(
    ("changes", "metrics", "subject"),
    [({"seeds": [0]}, METRICS, "seeds"), ({}, ("gap",), "metrics")],
)
def test_another_experiment_is_refused(
    folder: Path,
    manifest: Manifest,
    changes: dict[str, Any],
    metrics: tuple[str, ...],
    subject: str,
) -> None:
    with open_store(folder, manifest, METRICS):
        pass
    other = msgspec.structs.replace(manifest, **changes)
    with pytest.raises(ConfigError, match=subject), open_store(folder, other, metrics):
        pass


def test_a_folder_in_use_is_refused(folder: Path, manifest: Manifest) -> None:
    with (
        open_store(folder, manifest, METRICS),
        pytest.raises(ConfigError, match=str(folder)),
        open_store(folder, manifest, METRICS),
    ):
        pass
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3


def test_a_full_disk_is_one_line_and_loses_no_row(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[0], VALUES, 0.25)
        kept = (folder / "runs.csv").read_bytes()
        (folder / "runs.csv").unlink()
        (folder / "runs.csv").symlink_to("/dev/full")
        with pytest.raises(SwarmError, match=str(folder)):
            store.add(store.missing[0], VALUES, 0.25)
        assert [run.id for run in store.missing] == ["s0001", "s0002"]
        (folder / "runs.csv").unlink()
        (folder / "runs.csv").write_bytes(kept)
        (folder / ".runs.csv.partial").symlink_to("/dev/full")
        with pytest.raises(SwarmError, match=str(folder)):
            store.close({})
    assert (folder / "runs.csv").read_bytes() == kept


def test_failures_are_kept_in_order_and_run_again(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        for run in reversed(store.missing[:2]):
            store.fail(run, f"why {run.id}")
        assert list(read_failures(folder)) == ["s0000", "s0001"]
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3
        assert store.failures == {}
        for run in store.missing:
            store.add(run, VALUES, 0.25)
        store.close({})
    assert read_failures(folder) == {}


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"failures": [3]}', '{"failures": 3}'])
def test_damaged_failures_are_one_line(tmp_path: Path, text: str) -> None:
    (tmp_path / "failures.json").write_text(text)
    with pytest.raises(ConfigError, match=r"failures\.json"):
        read_failures(tmp_path)


PLAN = Plan(
    "duo", (4, 2),
    (Variant('law="a,b"', {"x.law": "a,b"}, {}), Variant("law=1.5", {"x.law": 1.5}, {})),
    sweep={"x.law": ["a,b", 1.5]},
)  # fmt: skip


def written(folder: Path, *rows: Row) -> Path:
    path = folder / TABLE
    path.write_text(lines([header(PLAN, METRICS), *(row.cells for row in rows)]))
    return path


def row(number: int, gap: float | None, time: float | None) -> Row:
    return Row(PLAN.runs[number], {"gap": gap, "time": time}, 0.125)


def test_rows_are_read_bit_by_bit_in_the_order_of_the_plan(tmp_path: Path) -> None:
    third, first = row(2, 0.1 + 0.2, -0.0), row(0, None, 5e-324)
    written(tmp_path, third, first)
    metrics, found = read_table(tmp_path, PLAN)
    assert metrics == METRICS
    assert list(found.values()) == [first, third]
    assert str(found[third.run.id].metrics["time"]) == "-0.0"


def test_a_row_has_the_bits_of_its_run_and_the_rules_that_acted(tmp_path: Path) -> None:
    one = replace(row(1, 1.0, 2.0), bits="0123456789ab", rules=("barrier", "recovery"))
    path = written(tmp_path, one)
    assert path.read_text().endswith(",1.0,2.0,0123456789ab,barrier recovery,0.125\n")
    assert list(read_table(tmp_path, PLAN)[1].values()) == [one]


def test_a_table_of_an_earlier_version_is_read(tmp_path: Path) -> None:
    first = row(0, 1.0, 2.0)
    path = written(tmp_path, first)
    old = path.read_text().replace(",bits,rules,", ",").replace(",2.0,,,", ",2.0,")
    assert old.splitlines()[0] == "run,variant,x.law,seed,gap,time,wall"
    path.write_text(old)
    assert read_table(tmp_path, PLAN) == (METRICS, {first.run.id: first})


@pytest.mark.parametrize(
    ("text", "safe"),
    [
        ("=1+1", "'=1+1"),
        ("+cmd|'x'!A1", "'+cmd|'x'!A1"),
        ("-1+1", "'-1+1"),
        ("@SUM(A1)", "'@SUM(A1)"),
        ("\t=1", "'\t=1"),
        ("\r=1", "'\r=1"),
        ("-0.5", "-0.5"),
        ("+1e-3", "+1e-3"),
        ("law=1.5", "law=1.5"),
        ("", ""),
    ],
)
def test_a_cell_is_no_formula(text: str, safe: str) -> None:
    assert cell(text) == safe
    assert cell(safe) == safe


def test_a_table_with_formulas_has_them_as_text_and_is_read_again(tmp_path: Path) -> None:
    sweep = {"x.law": ["=1+1", "-1+1", -1.5]}
    plan = make_plan("duo", [4], {}, sweep, lambda overrides: overrides)
    metrics = ("gap", "=own.py:gap")
    rows = [Row(run, dict.fromkeys(metrics, 1.0), 0.125) for run in plan.runs]
    table = tmp_path / TABLE
    table.write_text(lines([header(plan, metrics), *(row.cells for row in rows)]))
    head, *others = csv.reader(table.read_text().splitlines())
    assert head[5] == "'=own.py:gap"
    assert [cells[2] for cells in others] == ["'=1+1", "'-1+1", "-1.5"]
    found_metrics, found = read_table(tmp_path, plan)
    assert found_metrics == metrics
    assert list(found.values()) == rows


def test_a_row_names_run_variant_values_and_seed(tmp_path: Path) -> None:
    columns = ("run", "variant", "x.law", "seed", "gap", "time", "bits", "rules", "wall")
    assert header(PLAN, METRICS) == columns
    assert row(3, 1.0, 2.0).plain() == {
        "run": "law=1.5_s0002", "variant": "law=1.5", "x.law": 1.5, "seed": 2,
        "gap": 1.0, "time": 2.0, "bits": "", "rules": "", "wall": 0.125,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        (b"gap,", b"", 2),
        (b"gap,time", b"gap,gap", 1),
        (b"run,variant", b"name,variant", 1),
        (b",4,", b",5,", 2),
        (b"_s0004", b"_s0009", 2),
        (b",1.0,", b",one,", 2),
        (b",1.0,", b",inf,", 2),
        (b",1.0,", b",1.0,3.0,", 2),
        (b",1.0,", b",\xff,", 2),
        (b",1.0,", b',"1.0,', 2),
        (b",0.125", b",", 2),
    ],
)
def test_damage_is_one_line(tmp_path: Path, old: bytes, new: bytes, line: int) -> None:
    path = written(tmp_path, row(0, 1.0, 2.0))
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    with pytest.raises(ConfigError, match=rf"runs\.csv:{line}:") as caught:
        read_table(tmp_path, PLAN)
    assert "\n" not in str(caught.value)


def test_a_repeated_run_is_damage(tmp_path: Path) -> None:
    written(tmp_path, row(0, 1.0, 2.0), row(0, 1.0, 2.0))
    with pytest.raises(ConfigError, match=r"runs\.csv:3:"):
        read_table(tmp_path, PLAN)


@pytest.mark.parametrize("text", [None, "", "\n", "run"])
def test_a_table_without_columns_is_damage(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / TABLE).write_text(text)
    with pytest.raises(ConfigError, match=r"runs\.csv:"):
        read_table(tmp_path, PLAN)
