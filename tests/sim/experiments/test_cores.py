"""The cores that a program may use: its affinity, within the quotas of its control groups."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from swarmd.sim.experiments import cores, lessons
from swarmd.sim.experiments.cores import cores_of_a_run, usable_cores

V1 = {"cpu.cfs_quota_us": "250000", "cpu.cfs_period_us": "100000"}


@pytest.mark.parametrize(
    ("groups", "folder", "files", "cores"),
    [
        ("0::/job/step", "job", {"cpu.max": "150000 100000"}, 2),  # of a group around it
        ("0::/job/step", "job/step", {"cpu.max": "50000 100000"}, 1),
        ("0::/job", "job", {"cpu.max": "max 100000"}, 64),
        ("0::/job", "job", {"cpu.max": "nonsense"}, 64),
        ("4:cpu,cpuacct:/job\n0::/", "cpu,cpuacct/job", V1, 3),
        ("4:cpu:/outside/job\n0::/", "cpu", V1, 3),  # in a container
        ("4:cpu:/job", "cpu/job", {**V1, "cpu.cfs_quota_us": "-1"}, 64),
        ("4:memory:/job", "memory/job", V1, 64),
    ],
)
def test_a_quota_limits_the_cores(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    groups: str,
    folder: str,
    files: dict[str, str],
    cores: int,
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(64)))
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/cgroup").write_text(groups + "\n")
    place = tmp_path / "sys/fs/cgroup" / folder
    place.mkdir(parents=True)
    for name, text in files.items():
        (place / name).write_text(text + "\n")
    assert usable_cores(tmp_path) == cores


def test_the_affinity_limits_the_cores_of_a_machine_without_groups(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3})
    assert usable_cores(tmp_path) == 1
    assert usable_cores() == 1


@pytest.mark.parametrize(
    ("cores", "runs", "robots", "share"),
    [
        (8, 1, 100, 8),
        (8, 1, 99, 1),
        (8, 3, 500, 2),
        (2, 2, 1000, 1),
        (1, 1, 1000, 1),
        (2, 20, 99, 1),
    ],
)
def test_a_large_run_takes_the_cores_that_no_other_run_uses(
    cores: int, runs: int, robots: int, share: int
) -> None:
    assert cores_of_a_run(cores, runs, robots) == share


@pytest.mark.parametrize(
    ("load", "share"), [(0.0, 1.0), (2.0, 1.0), (8.0, 0.25), (60.0, 0.05), (1000.0, 0.05)]
)
def test_seconds_count_by_the_share_of_a_core(
    monkeypatch: pytest.MonkeyPatch, load: float, share: float
) -> None:
    """At load 60 on two cores a second counts as a twentieth (docs/experiments.md)."""
    monkeypatch.setattr(cores, "usable_cores", lambda: 2)
    monkeypatch.setattr("os.getloadavg", lambda: (load, 0.0, 0.0))
    assert cores.core_share() == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize(("share", "seconds"), [(1.0, 10), (0.25, 40)])
def test_a_pupil_has_more_time_on_an_overloaded_machine(
    monkeypatch: pytest.MonkeyPatch, share: float, seconds: int
) -> None:
    now = 0.0

    def endless(*_: object) -> Iterator[dict[str, float]]:
        nonlocal now
        while True:
            now += 1.0
            yield {}

    monkeypatch.setattr(lessons, "run_jobs", lambda *_, **__: endless())
    monkeypatch.setattr(lessons, "core_share", lambda: share)
    monkeypatch.setattr(lessons, "time", SimpleNamespace(monotonic=lambda: now))
    assert [*lessons._bounded([], 1, 10.0, None)] == []
    assert now == seconds + 1
