"""A burst takes real-time priority on one processor, and gives both back."""

from __future__ import annotations

import gc
import os
import resource
from typing import Any

import pytest

from benchmarks import bursts


class Scheduler:
    """Stands for the kernel: the policy of this process, and whether it may be real-time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, permits: bool = True) -> None:
        self.permits = permits
        self.policies: list[int] = []
        monkeypatch.setattr(os, "sched_setscheduler", self.set)

    def set(self, pid: int, policy: int, param: Any) -> None:
        if policy == os.SCHED_FIFO and not self.permits:
            raise PermissionError
        self.policies.append(policy)


def state() -> tuple[set[int], tuple[int, int], bool]:
    return os.sched_getaffinity(0), resource.getrlimit(resource.RLIMIT_RTTIME), gc.isenabled()


def test_a_burst_runs_with_priority_on_one_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduler, before, seen = Scheduler(monkeypatch), state(), []
    processor = max(os.sched_getaffinity(0))
    taken, switches = bursts.burst(lambda: seen.append((state(), *scheduler.policies)), processor)
    assert seen == [(({processor}, (3_000_000, before[1][1]), False), os.SCHED_FIFO)]
    assert taken > 0.0
    assert switches >= 0
    assert (state(), scheduler.policies) == (before, [os.SCHED_FIFO, os.SCHED_OTHER])


def test_a_burst_that_fails_gives_all_back(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduler, before = Scheduler(monkeypatch), state()
    with pytest.raises(ZeroDivisionError):
        bursts.burst(lambda: 1 / 0, min(os.sched_getaffinity(0)))
    assert (state(), scheduler.policies) == (before, [os.SCHED_FIFO, os.SCHED_OTHER])


def test_without_permission_nothing_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    scheduler, before = Scheduler(monkeypatch, permits=False), state()
    with pytest.raises(SystemExit, match="real-time priority 5; run as root"):
        bursts.burst(lambda: pytest.fail("it runs"), min(os.sched_getaffinity(0)))
    assert (state(), scheduler.policies) == (before, [os.SCHED_OTHER])


def test_a_row_says_in_how_many_bursts_another_process_took_part() -> None:
    row = bursts.row("a", 0.4, [(0.1, 0), (0.2, 3), (0.4, 1)], ">= 2 x")
    assert row.samples == [4.0, 2.0, 1.0]
    assert row.note == "another process took part in 2 of 3"
