"""Processor time and memory of a process."""

from __future__ import annotations

import os
import time

from swarmd.daemon.health import UsageMeter


def test_usage_is_the_share_of_a_core_since_the_last_call() -> None:
    meter = UsageMeter()
    meter.measure(os.getpid(), 100.0)
    assert meter.usage is None
    began = time.process_time()
    while time.process_time() - began < 0.1:
        pass
    meter.measure(os.getpid(), 101.0)
    assert meter.usage is not None
    assert 0.08 <= meter.usage.cpu <= 1.0
    assert 10_000_000 < meter.usage.memory < 10_000_000_000


def test_another_process_begins_anew_and_one_that_ended_has_no_usage() -> None:
    meter = UsageMeter()
    meter.measure(os.getpid(), 100.0)
    meter.measure(1, 101.0)
    assert meter.usage is None
    meter.measure(None, 102.0)
    meter.measure(2**22 + 1, 103.0)
    assert meter.usage is None
