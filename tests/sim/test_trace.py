"""Traces are saved atomically and load unchanged."""

from __future__ import annotations

import tracemalloc
import zipfile
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings.platforms import load_platform
from swarmd.sim import trace as module
from swarmd.sim.trace import ARENA, VERSION, Trace, TraceBuilder, load_trace

IDS = ("a", "b")


def recorded() -> Trace:
    platforms = [load_platform("burger"), load_platform("jackal")]
    recorder = TraceBuilder(IDS, platforms, {"arena": "6x6", "seed": 3})
    for k in range(10):
        recorder.add(0.1 * k, np.full((2, 3), float(k)), np.full((2, 3), -float(k)))
    recorder.add_contact(0.25, "a", "b", 0.1, 0.2)
    recorder.add_contact(0.35, "b", "wall/east", 0.3, 0.0)
    return recorder.trace(seconds=1.0)


def test_comes_back_from_the_disk_as_it_was(tmp_path: Path) -> None:
    trace = recorded()
    path = tmp_path / "deep" / "run.npz"
    trace.save(path)
    bare = load_trace(path)
    assert (bare.requested, bare.active) == (None, None)
    assert [file.name for file in path.parent.iterdir()] == ["run.npz"]
    whole = replace(
        trace, requested=trace.safe, state=np.full((10, 2), "running"),
        active=np.ones((10, 2), dtype=bool),
        gap=np.full((10, 2), 0.3), scan_age=np.full((10, 2), np.nan),
        bound=np.arange(60.0).reshape(10, 2, 3),
        recovering=np.ones((10, 2), dtype=bool),
        report={"opinion": np.arange(20.0).reshape(10, 2)}, words={"state": np.full((10, 2), "x")},
        movable_boxes=("crate",), box_pose=np.full((10, 1, 3), np.nan),
    )  # fmt: skip
    whole.save(path)
    again = load_trace(path)
    np.testing.assert_array_equal(trace.contact_pair, [[0, 1], [1, ARENA]])
    for field in fields(Trace):
        was, found = getattr(whole, field.name), getattr(again, field.name)
        if isinstance(was, np.ndarray):
            np.testing.assert_array_equal(found, was, err_msg=field.name)
    assert again.ids == IDS
    assert again.platforms == ("burger", "jackal")
    np.testing.assert_array_equal(again.footprint(1), load_platform("jackal").footprint)
    assert again.meta == {"arena": "6x6", "seed": 3, "seconds": 1.0}
    assert again.reason is None
    np.testing.assert_array_equal(again.report["opinion"], whole.report["opinion"])
    assert again.words["state"][4, 0] == "x"
    assert again.movable_boxes == ("crate",)


def test_clearing_restarts_the_trace() -> None:
    recorder = TraceBuilder(IDS, [load_platform("burger")] * 2, {})
    recorder.add(0.0, np.zeros((2, 3)), np.zeros((2, 3)))
    recorder.add_contact(0.0, "a", "b", 0.0, 0.0)
    recorder.clear()
    trace = recorder.trace()
    assert trace.pose.shape == (0, 2, 3)
    assert trace.contact_pair.shape == (0, 2)
    assert trace.duration == 0.0


def test_recorder_keeps_copies() -> None:
    recorder = TraceBuilder(("a",), [load_platform("burger")], {})
    pose = np.zeros((1, 3))
    recorder.add(0.0, pose, pose)
    pose[:] = 9.0
    np.testing.assert_array_equal(recorder.trace().pose, 0.0)


def test_a_trace_of_another_version_is_refused_by_its_version(tmp_path: Path) -> None:
    recorded().save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        whole = dict(file)
    whole["head"] = np.array(str(whole["head"]).replace(f'"version": {VERSION}', '"version": 2'))
    np.savez(tmp_path / "run.npz", **whole)
    with pytest.raises(ConfigError, match=f"version.*{VERSION}"):
        load_trace(tmp_path / "run.npz")


@pytest.mark.parametrize("content", [b"", b"rubbish", b"PK\x03\x04rubbish"])
def test_a_file_that_is_no_trace_is_one_clear_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.npz"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"run\.npz: not a trace"):
        load_trace(path)
    with pytest.raises(ConfigError, match=r"missing\.npz"):
        load_trace(tmp_path / "missing.npz")


def test_a_file_that_unpacks_to_more_than_its_size_allows_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(20):
            archive.writestr(f"report/{number}.npy", bytes(2**23))
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match=r"run\.npz: unpacks to 167772160 bytes; expected"):
            load_trace(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 2**23


def test_a_trace_in_which_nothing_changes_is_saved_as_it_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_SPARE", 0)
    recorder = TraceBuilder(IDS, [load_platform("burger")] * 2, {})
    for k in range(3000):
        recorder.add(0.1 * k, np.zeros((2, 3)), np.zeros((2, 3)))
    trace, path = recorder.trace(), tmp_path / "run.npz"
    state = np.full(trace.pose.shape[:2], "idle", dtype=module.WORD)
    replace(trace, state=state).save(path)
    assert load_trace(path).duration == trace.duration


def test_arrays_that_do_not_fit_together_are_one_clear_error(tmp_path: Path) -> None:
    path, n = tmp_path / "run.npz", len(IDS)
    recorded().save(path)
    with np.load(path) as file:
        whole = dict(file)
    t, pose = whole["t"], whole["pose"]
    bad: list[dict[str, Any]] = [
        {"pose": pose[:-1]},
        {"pose": pose.reshape(-1)},
        {"safe": pose.astype("U8")},
        {"requested": pose[:, :1]},
        {"active": np.zeros((0, n), dtype=bool)},
        {"bound": pose[:, :, 0]},
        {"gap": pose},
        {"recovering": pose[:, :, 0]},
        {"report/x": np.zeros(len(t))},
        {"words/x": np.zeros((len(t), n))},
        {"contact_pair": whole["contact_pair"].astype(float)},
        {"box_pose": np.zeros((len(t), 3, 3))},
        {"extra": t},
        {
            "head": np.array(
                str(whole["head"]).replace('"platforms": ["burger"', '"platforms": ["x"')
            )
        },
        {"head": np.array(str(whole["head"]).replace('"burger", "jackal"', '"burger"'))},
    ]
    assert len({str(change["head"]) for change in [whole, *bad[-2:]]}) == 3
    for change in bad:
        np.savez(path, **{**whole, **change})
        with pytest.raises(ConfigError, match="damaged"):
            load_trace(path)
    np.savez(path, **whole)
    assert load_trace(path).ids == IDS


def test_a_trace_of_which_bytes_have_changed_is_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "run.npz"
    recorded().save(path)
    whole, places, refused = path.read_bytes(), np.random.default_rng(1), 0
    for _ in range(100):
        data = bytearray(whole)
        for place in places.integers(len(data), size=4):
            data[place] ^= 0x5A
        path.write_bytes(data)
        try:  # a few bytes say nothing that matters
            assert load_trace(path).ids == IDS
        except ConfigError as error:
            refused += "damaged" in str(error)
    assert refused > 50
