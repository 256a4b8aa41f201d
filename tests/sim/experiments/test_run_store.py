"""The store of runs: what is kept is given back, and what cannot be used counts as not there."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments import run_store as stores
from swarmd.sim.experiments.run_store import (
    BOUND,
    OFF,
    SIZE_VARIABLE,
    VARIABLE,
    RunStore,
    run_store,
)

KEY, OTHER = "a" * 64, "b" * 64
METRICS = {"path_length": 0.1 + 0.2, "gather_time": None, "turn": -0.0}
TRACE = bytes(range(256)) * 40


@pytest.fixture
def store(tmp_path: Path) -> RunStore:
    return RunStore(tmp_path / "store", free=0)


@pytest.fixture
def trace(tmp_path: Path) -> Path:
    path = tmp_path / "s0000.npz"
    path.write_bytes(TRACE)
    return path


def kept(store: RunStore, trace: Path | None, key: str = KEY) -> None:
    store.keep(key, METRICS, trace, "2026-11-29")


def taken(store: RunStore, target: Path | None, key: str = KEY) -> dict[str, float | None] | None:
    """The metrics of a run of which the trace has been handed out; None without one."""
    entry = store.find(key, has_trace=target is not None)
    return entry.metrics if entry is not None and store.hand_out(entry, target) else None


def files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def test_a_run_is_given_back_to_the_bit(store: RunStore, trace: Path, tmp_path: Path) -> None:
    kept(store, trace)
    target = tmp_path / "again.npz"
    metrics = taken(store, target)
    assert repr(metrics) == repr(METRICS)  # in their order, -0.0 included
    assert target.read_bytes() == TRACE
    entry = store.find(KEY, has_trace=True)
    assert entry is not None
    assert (entry.made, entry.size) == ("2026-11-29", len(TRACE))
    assert entry.trace == hashlib.sha256(TRACE).hexdigest()
    assert files(store.folder) == {KEY, f"{KEY}/result", f"{KEY}/trace.npz"}
    assert store.folder.stat().st_mode & 0o777 == 0o700


def test_files_are_copies(store: RunStore, trace: Path, tmp_path: Path) -> None:
    kept(store, trace)
    trace.write_bytes(b"changed by its user")
    target = tmp_path / "again.npz"
    assert taken(store, target) is not None
    target.write_bytes(b"changed, too")
    assert taken(store, tmp_path / "third.npz") is not None
    assert (tmp_path / "third.npz").read_bytes() == TRACE
    assert {path.stat().st_nlink for path in (trace, target)} == {1}


def test_without_a_trace_an_entry_has_none_to_give(
    store: RunStore, trace: Path, tmp_path: Path
) -> None:
    assert taken(store, None) is None
    kept(store, None)
    assert taken(store, None) == METRICS
    assert store.find(KEY, has_trace=True) is None
    kept(store, trace)  # it takes the place of the entry without one
    assert taken(store, tmp_path / "again.npz") == METRICS
    kept(store, None)  # and keeps it
    assert store.find(KEY, has_trace=True) is not None
    assert files(store.folder) == {KEY, f"{KEY}/result", f"{KEY}/trace.npz"}


def test_a_number_that_json_lacks_is_not_kept(store: RunStore) -> None:
    store.keep(KEY, {"gap": float("nan")}, None, "2026-11-29")
    assert files(store.folder) == set()


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def grow(path: Path) -> None:
    os.truncate(path, 1 << 36)  # 64 GB, of which the disk has nothing


def to_link(path: Path) -> None:
    """A link to a file outside that has the right content."""
    outside = path.parents[2] / f"outside_{path.name}"
    path.rename(outside)
    path.symlink_to(outside)


def to_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def to_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()
    (path / "x").write_text("")


DAMAGE: tuple[Callable[[Path], None], ...] = (
    *(cut, flip, empty, grow, to_link, to_pipe, to_folder),
    Path.unlink,
)


@pytest.mark.parametrize("name", ["result", "trace.npz"])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_entry_counts_as_not_there_and_goes(
    store: RunStore, trace: Path, tmp_path: Path, damage: Callable[[Path], None], name: str
) -> None:
    kept(store, trace)
    damage(store.folder / KEY / name)
    target = tmp_path / "again.npz"
    assert taken(store, target) is None
    assert not target.exists()
    assert files(store.folder) == set()
    assert not list(tmp_path.glob(".*"))
    kept(store, trace)  # and the run can be kept again
    assert taken(store, target) == METRICS


def as_file(path: Path) -> None:
    path.write_text("no folder")


def as_link(path: Path) -> None:
    outside = path.parents[1] / "outside"
    outside.mkdir()
    (outside / "mine.txt").write_text("of the user")
    path.symlink_to(outside)


def as_empty_folder(path: Path) -> None:
    path.mkdir()


@pytest.mark.parametrize("make", [as_file, as_link, as_empty_folder, os.mkfifo])
def test_what_is_no_entry_is_replaced(
    store: RunStore, trace: Path, tmp_path: Path, make: Callable[[Path], None]
) -> None:
    kept(store, trace, OTHER)
    make(store.folder / KEY)
    assert taken(store, None) is None
    make_again = store.folder / KEY
    if not os.path.lexists(make_again):  # it is gone: put it there once more, before the write
        (tmp_path / "outside" / "mine.txt").unlink(missing_ok=True)
        if (tmp_path / "outside").is_dir():
            (tmp_path / "outside").rmdir()
        make(make_again)
    kept(store, trace)
    assert taken(store, tmp_path / "again.npz") == METRICS
    assert not (store.folder / KEY).is_symlink()
    if (tmp_path / "outside").exists():
        assert (tmp_path / "outside" / "mine.txt").read_text() == "of the user"


def test_an_entry_under_another_key_is_none(store: RunStore, trace: Path) -> None:
    kept(store, trace)
    (store.folder / KEY).rename(store.folder / OTHER)
    assert store.find(OTHER, has_trace=False) is None
    assert files(store.folder) == set()


def test_a_store_of_another_user_is_none(store: RunStore, trace: Path, tmp_path: Path) -> None:
    kept(store, trace)
    before = files(store.folder)
    others = RunStore(store.folder, free=0, user=os.geteuid() + 1)
    assert others.find(KEY, has_trace=False) is None
    kept(others, trace, OTHER)
    others.shrink()
    assert files(store.folder) == before
    assert taken(store, tmp_path / "again.npz") == METRICS


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777])
def test_a_store_that_others_can_write_is_none(store: RunStore, trace: Path, mode: int) -> None:
    kept(store, trace)
    store.folder.chmod(mode)
    assert store.find(KEY, has_trace=False) is None
    kept(store, trace, OTHER)
    assert not (store.folder / OTHER).exists()


def test_a_file_in_place_of_the_store_stays(trace: Path, tmp_path: Path) -> None:
    (tmp_path / "store").write_text("of the user")
    store = RunStore(tmp_path / "store", free=0)
    kept(store, trace)
    assert taken(store, None) is None
    store.shrink()
    assert (tmp_path / "store").read_text() == "of the user"


@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EIO, errno.EDQUOT])
@pytest.mark.parametrize("call", ["mkdtemp", "_copy", "write_bytes", "rename"])
def test_a_disk_that_takes_nothing_is_no_error(
    store: RunStore, trace: Path, monkeypatch: pytest.MonkeyPatch, code: int, call: str
) -> None:
    kept(store, trace, OTHER)
    before = files(store.folder)

    def fail(*words: object, **more: object) -> None:
        raise OSError(code, os.strerror(code))

    owner = {"mkdtemp": tempfile, "_copy": stores}.get(call, Path)
    with monkeypatch.context() as here:
        here.setattr(owner, call, fail)
        kept(store, trace)
    assert files(store.folder) == before


def test_a_copy_that_cannot_be_written_leaves_the_entry(
    store: RunStore, trace: Path, tmp_path: Path
) -> None:
    kept(store, trace)
    assert taken(store, tmp_path / "gone" / "again.npz") is None
    assert taken(store, tmp_path / "again.npz") == METRICS


def test_space_stays_free(trace: Path, tmp_path: Path) -> None:
    store = RunStore(tmp_path / "store", free=1 << 60)
    kept(store, trace)
    assert files(store.folder) == set()


def test_an_entry_that_is_too_large_is_not_kept(trace: Path, tmp_path: Path) -> None:
    store = RunStore(tmp_path / "store", free=0, bound=8 * len(TRACE) - 8)
    kept(store, trace)
    assert files(store.folder) == set()
    kept(store, None)
    assert taken(store, None) == METRICS


def test_the_oldest_use_goes_first(trace: Path, tmp_path: Path) -> None:
    store = RunStore(tmp_path / "store", free=0)
    keys = [str(number) * 64 for number in range(8)]
    for number, key in enumerate(keys):
        kept(store, trace, key)
        os.utime(store.folder / key / "result", (number, number))
    assert taken(store, None, keys[0]) is not None  # its last use is now
    # Each entry takes 10,240 bytes of trace and some 300 of metrics: five fit into 0.9 of 60 kB.
    RunStore(store.folder, free=0, bound=60_000).shrink()
    assert [key[0] for key in keys if (store.folder / key).exists()] == list("04567")


def test_a_store_that_is_written_keeps_its_bound(trace: Path, tmp_path: Path) -> None:
    store = RunStore(tmp_path / "store", free=0, bound=100_000)
    for number in range(40):
        kept(store, trace, f"{number:064}")
    assert sum(path.stat().st_size for path in store.folder.rglob("*")) < 130_000
    assert taken(store, None, f"{39:064}") == METRICS


def test_what_a_killed_process_left_goes_after_an_hour(store: RunStore, trace: Path) -> None:
    kept(store, trace)
    left = store.folder / ".partial-1"
    left.mkdir()
    (left / "trace.npz").write_bytes(TRACE)
    begun = left.stat().st_mtime
    store.shrink(begun + 3500.0)
    assert left.exists()  # of a process that may be writing it
    store.shrink(begun + 3700.0)
    assert files(store.folder) == {KEY, f"{KEY}/result", f"{KEY}/trace.npz"}


class KilledError(BaseException):
    """In place of SIGKILL: nothing that comes after it is carried out."""


@pytest.mark.parametrize("call", ["_copy", "write_bytes", "rename"])
def test_a_process_that_is_killed_as_it_writes_leaves_no_entry(
    store: RunStore, trace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    def die(*words: object, **more: object) -> None:
        raise KilledError

    with monkeypatch.context() as here:
        here.setattr(stores if call == "_copy" else Path, call, die)
        here.setattr(shutil, "rmtree", lambda *words, **more: None)
        with pytest.raises(KilledError):
            kept(store, trace)
    assert len(list(store.folder.glob(".partial-*"))) == 1
    assert taken(store, None) is None
    kept(store, trace)
    assert taken(store, tmp_path / "again.npz") == METRICS


BUSY = """
import sys
import tempfile
from pathlib import Path
from swarmd.sim.experiments.run_store import RunStore
folder, trace, target = map(Path, sys.argv[1:])
store = RunStore(folder, free=0, bound=90_000)
metrics = {"x": 1.5}
content = trace.read_bytes()
input()
found = 0
for number in range(150):
    key = f"{number % 6:064}"
    store.keep(key, metrics, trace, "2026-11-29")
    entry = store.find(key, has_trace=True)
    if entry is not None and store.hand_out(entry, target):
        found += 1
        assert entry.metrics == metrics
        assert target.read_bytes() == content
    if number % 3 == 0:
        store.remove(f"{(number + 3) % 6:064}")
    store.shrink()
print(found)
"""


@pytest.mark.integration
def test_two_processes_may_use_a_store_at_once(trace: Path, tmp_path: Path) -> None:
    """Both keep the same runs, hand them out, and remove some, as fast as they can."""
    folder = tmp_path / "store"
    busy = [
        subprocess.Popen(
            [sys.executable, "-c", BUSY, folder, trace, tmp_path / f"{name}.npz"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for name in ("one", "other")
    ]
    for process in busy:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    told = [process.communicate(timeout=120)[0] for process in busy]
    assert [process.returncode for process in busy] == [0, 0]
    assert all(int(text) > 0 for text in told)
    assert not list(folder.glob(".partial-*"))


def test_what_was_taken_since_a_time_is_counted(store: RunStore, trace: Path) -> None:
    for number in range(4):
        kept(store, trace, f"{number:064}")
        used = 1000.0 + number
        os.utime(store.folder / f"{number:064}" / "result", (used, used))
        os.utime(store.folder / f"{number:064}", (500.0, 500.0))
    new = store.folder / f"{3:064}"
    os.utime(new, (1003.0, 1003.0))  # made and used since
    assert [store.taken_since(begin) for begin in (999.0, 1002.0, 1002.5, 1004.0)] == [3, 1, 0, 0]
    assert RunStore(store.folder / "none").taken_since(0.0) == 0


def test_what_is_put_aside_is_in_no_use(store: RunStore, trace: Path) -> None:
    kept(store, trace)
    folder = store.put_aside(KEY)
    assert (folder / "trace.npz").read_bytes() == TRACE
    assert store.find(KEY, has_trace=False) is None
    kept(store, trace)
    assert store.put_aside(KEY) == folder
    assert store.put_aside(KEY) == store.folder / KEY  # nothing is there any more


def test_the_environment_names_the_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    usual = run_store({})
    assert usual is not None
    assert (usual.folder, usual._bound) == (tmp_path / "swarmd" / "runs", BOUND)
    assert run_store({VARIABLE: OFF}) is None
    monkeypatch.setenv("HOME", str(tmp_path))
    named = run_store({VARIABLE: "~/mine", SIZE_VARIABLE: "0.5"})
    assert named is not None
    assert (named.folder, named._bound) == (tmp_path / "mine", 1 << 29)


@pytest.mark.parametrize("text", ["0", "-1", "much", "nan", "inf"])
def test_a_size_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=SIZE_VARIABLE):
        run_store({SIZE_VARIABLE: text})


def test_tests_have_no_store() -> None:
    assert run_store(os.environ) is None
