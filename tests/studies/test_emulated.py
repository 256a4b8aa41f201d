"""Kept runs on an emulated processor, where there is qemu-user."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from studies.night import kept_runs
from studies.night.emulated import EMULATOR, check_on, python_on
from studies.night.jobs import Job
from studies.night.kept_runs import KeptRun, Made, write
from swarmd.core.errors import SwarmError

PROCESSOR = "SandyBridge"  # of 2011: no AVX2; MuJoCo needs AVX
needs_emulator = pytest.mark.skipif(
    shutil.which(EMULATOR) is None, reason=f"no {EMULATOR} on the PATH"
)
AVX = "import numpy; print('X86_V3' in numpy.show_config('dicts')['SIMD Extensions']['not found'])"
CHILD = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {AVX!r}], check=True)"


def test_without_an_emulator_the_remedy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(SwarmError, match="apt install qemu-user"), python_on(PROCESSOR):
        pass


@needs_emulator
@pytest.mark.integration
def test_what_an_emulated_python_starts_is_emulated() -> None:
    # What else chooses among functions would be for this processor.
    chosen = ("NPY_", "OPENBLAS_")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(chosen)}
    with python_on(PROCESSOR) as python:
        words = [python, "-c", CHILD]
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        prefix = subprocess.check_output([python, "-c", "import sys; print(sys.prefix)"], text=True)
    assert done.stdout.strip() == "True"
    assert prefix.strip() == sys.prefix
    assert not Path(python).exists()


@needs_emulator
@pytest.mark.integration
def test_an_unknown_processor_is_refused() -> None:
    with pytest.raises(SwarmError, match=r"no emulated Nehalm: .*Nehalm"), python_on("Nehalm"):
        pass


@needs_emulator
@pytest.mark.integration
@pytest.mark.timeout(900)
def test_a_run_is_equal_and_one_that_fails_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kept_runs, "ROOT", tmp_path)
    good = KeptRun(scenario="voter_model", set={"duration": 1.0}, seed=1, bits="of another code")
    bad = KeptRun(scenario="no_such_scenario", bits="x")
    write(Made(table="good"), [good])
    write(Made(table="bad"), [bad])
    jobs = [Job(name, ("-m", "studies.paper"), 1.0) for name in ("good", "bad")]
    assert check_on(PROCESSOR, jobs) == 1
    printed = capsys.readouterr().out
    assert f"good: 1 of 1 runs are equal on {PROCESSOR}" in printed
    assert f"bad: 0 of 1 runs are equal on {PROCESSOR}" in printed
    assert printed.endswith("1 of 2 runs are equal\n")
