"""The worker in which `simulate` does its runs: pinned, kept for the next call, and ended."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.pin import is_pinned
from swarmd.sim.experiments.manifest import read_manifest
from swarmd.sim.experiments.pool import _kept_workers, worker_functions
from swarmd.sim.experiments.results import Results
from swarmd.sim.experiments.simulate import simulate
from swarmd.testing.driver_contract import is_running
from tests.support.processes import children, wait_until

pytestmark = pytest.mark.integration

# Drives at the speed that a variable names, beside a file that a folder has.
LED = '''
import os
from pathlib import Path

from swarmd.api import Inputs, MovementPattern, Params, Twist


class Led(MovementPattern[Params]):
    """Drives as its surroundings say."""

    def drive(self, inputs: Inputs) -> Twist:
        return Twist(linear=float(os.environ["LED"]) + 0.01 * Path("here").exists())
'''


def small(duo: Path, **more: Any) -> Results:
    return simulate(duo, **{"seeds": 1, "set": {"duration": 0.3}, **more})


def kept() -> int | None:
    """The process id of the kept worker."""
    worker = _kept_workers()._worker
    return None if worker is None else worker._process.pid


def made(results: Results) -> tuple[str, str]:
    """Whether a manifest and a trace say that they were made by a pinned process."""
    return (
        read_manifest(results.folder).made_with["pinned"],
        results.traces[0].meta["made"]["pinned"],
    )


def test_calls_share_a_pinned_worker_and_a_debugger_gets_this_process(duo: Path) -> None:
    in_worker = small(duo)
    first = kept()
    two = small(duo, jobs=2, seeds=2)
    assert first is not None
    assert kept() == first
    assert made(in_worker) == ("yes", "yes") == made(two)
    assert read_manifest(in_worker.folder).made_with["functions"] == worker_functions()["functions"]
    here = "yes" if is_pinned() else "no"
    assert made(small(duo, in_process=True)) == (here, here)


def test_a_run_sees_the_present_folder_and_environment(
    duo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (duo.parent / "plugins" / "led.py").write_text(LED)
    places = [tmp_path / "one", tmp_path / "two"]
    for place in places:
        place.mkdir()
    (places[1] / "here").touch()
    speeds = []
    workers = []
    for place, led in zip((*places, places[0]), ("0.05", "0.05", "0.08"), strict=True):
        monkeypatch.chdir(place)
        monkeypatch.setenv("LED", led)
        found = small(duo, set={"duration": 0.5, "groups.all.pattern": "led"})
        requested = found.traces[0].requested
        assert requested is not None
        speeds.append(round(float(requested[-1, 0, 0]), 6))
        workers.append(kept())
    assert speeds == [0.05, 0.06, 0.08]
    assert len(set(workers)) == 1


def test_a_variable_that_acts_at_the_start_takes_a_new_worker_and_a_dead_one_is_replaced(
    duo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small(duo)
    first = kept()
    monkeypatch.setenv("OMP_SCHEDULE", "static")
    small(duo)
    second = kept()
    assert second != first
    assert first is not None
    assert not is_running(first)
    assert second is not None
    os.kill(second, 9)
    os.waitpid(second, 0)
    assert len(small(duo).rows) == 1
    assert kept() not in (None, second)


def test_threads_that_end_leave_their_worker_to_the_next_call(duo: Path) -> None:
    """As those of an executor's worker, or of a server."""
    _kept_workers().end()
    found: list[tuple[int, int | None]] = []

    def call() -> None:
        found.append((len(small(duo).rows), kept()))

    for _ in range(2):
        thread = threading.Thread(target=call)
        thread.start()
        thread.join()
    assert len(small(duo).rows) == 1
    worker = kept()
    assert worker is not None
    assert is_running(worker)
    assert found == [(1, worker), (1, worker)]


SCRIPT = """
import os
from swarmd.sim.experiments.pool import _kept_workers
from swarmd.sim.experiments.simulate import simulate
for _ in range(2):
    simulate({duo!r}, 1, set={{'duration': 0.3}})
worker = _kept_workers()._worker._process.pid
if os.fork() == 0:  # a fork has no part in the worker
    assert _kept_workers()._worker is None
    raise SystemExit(0)
os.wait()
os.kill(worker, 0)
print(worker)
"""


def test_a_script_leaves_no_process_behind(duo: Path, tmp_path: Path) -> None:
    before = set(children(os.getpid()))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(duo=str(duo))],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert (done.returncode, done.stderr) == (0, "")
    wait_until(lambda: not is_running(int(done.stdout)), "the end of the worker", 60.0)
    assert set(children(os.getpid())) <= before
