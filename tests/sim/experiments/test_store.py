"""An experiment's folder is whole at every instant, and nobody else's is touched."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.experiments.manifest import Manifest, manifest_of
from swarmd.sim.experiments.simulate import plan_of
from swarmd.sim.experiments.store import open_store, read_failures, read_table

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


def test_each_row_is_on_the_disk_at_once_and_all_are_in_order_in_the_end(
    folder: Path, manifest: Manifest
) -> None:
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


def test_goes_on_where_it_was(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[1], VALUES, 0.25)
    with open_store(folder, manifest, METRICS) as store:
        assert [run.id for run in store.missing] == ["s0000", "s0002"]
        assert store.rows["s0001"].metrics == VALUES


def test_goes_on_after_an_end_at_any_point(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[1], VALUES, 0.25)
    whole = (folder / "runs.csv").read_bytes()
    (folder / "runs.csv").write_bytes(whole + b"s0000,,0,1.")
    (folder / "traces" / ".s0000.npz.partial").write_bytes(b"PK")
    with open_store(folder, manifest, METRICS) as store:
        assert list(store.rows) == ["s0001"]
        assert names(folder / "traces") == []
        store.add(store.missing[0], VALUES, 0.25)
        assert list(read_table(folder, store.plan)[1]) == ["s0000", "s0001"]


@pytest.mark.parametrize("left", [[], [".manifest.json.partial"]])
def test_begins_in_a_folder_where_nothing_was_begun(
    folder: Path, manifest: Manifest, left: list[str]
) -> None:
    folder.mkdir(parents=True)
    for name in left:
        (folder / name).touch()
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3


def test_begins_its_table_if_it_was_killed_before(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS):
        pass
    (folder / "runs.csv").unlink()
    (folder / "traces").rmdir()
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3
        assert names(folder) == ["manifest.json", "runs.csv", "traces"]


@pytest.mark.parametrize("name", ["notes.txt", "runs.csv", "traces", ".hidden"])
def test_a_folder_that_is_something_else_is_left_alone(
    folder: Path, manifest: Manifest, name: str
) -> None:
    folder.mkdir(parents=True)
    (folder / name).write_text("mine")
    with (
        pytest.raises(ConfigError, match=f"is no experiment's folder: it holds {name}"),
        open_store(folder, manifest, METRICS),
    ):
        pass
    assert names(folder) == [name]
    assert (folder / name).read_text() == "mine"


def test_a_file_in_the_place_of_the_folder_is_one_line(tmp_path: Path, manifest: Manifest) -> None:
    (tmp_path / "file").write_text("mine")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ConfigError, match="is a file"), open_store(place, manifest, METRICS):
            pass


def test_a_folder_that_cannot_be_made_is_not_told_of_as_full(manifest: Manifest) -> None:
    place = Path("/proc/nowhere")
    with (
        pytest.raises(SwarmError, match="No such file or directory; name another folder"),
        open_store(place, manifest, METRICS),
    ):
        pass


def test_another_experiment_is_refused(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS):
        pass
    other = msgspec.structs.replace(manifest, seeds=[0])
    with (
        pytest.raises(ConfigError, match="holds another experiment: the seeds were 0-2, now 0"),
        open_store(folder, other, METRICS),
    ):
        pass
    with (
        pytest.raises(ConfigError, match="holds other metrics"),
        open_store(folder, manifest, ("gap",)),
    ):
        pass


def test_two_at_a_time_are_refused(folder: Path, manifest: Manifest) -> None:
    with (
        open_store(folder, manifest, METRICS),
        pytest.raises(ConfigError, match="another swarmctl is at work in it"),
        open_store(folder, manifest, METRICS),
    ):
        pass
    with open_store(folder, manifest, METRICS) as store:
        assert len(store.missing) == 3


def test_a_full_disk_is_one_line_and_costs_no_row(folder: Path, manifest: Manifest) -> None:
    with open_store(folder, manifest, METRICS) as store:
        store.add(store.missing[0], VALUES, 0.25)
        kept = (folder / "runs.csv").read_bytes()
        (folder / "runs.csv").unlink()
        (folder / "runs.csv").symlink_to("/dev/full")
        with pytest.raises(SwarmError, match="No space left on device; what was finished is kept"):
            store.add(store.missing[0], VALUES, 0.25)
        assert [run.id for run in store.missing] == ["s0001", "s0002"]
        (folder / "runs.csv").unlink()
        (folder / "runs.csv").write_bytes(kept)
        (folder / ".runs.csv.partial").symlink_to("/dev/full")
        with pytest.raises(SwarmError, match="No space left on device"):
            store.close({})
    assert (folder / "runs.csv").read_bytes() == kept


def test_failures_are_kept_in_order_and_tried_again(folder: Path, manifest: Manifest) -> None:
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
    with pytest.raises(ConfigError, match=r"failures\.json: damaged"):
        read_failures(tmp_path)
