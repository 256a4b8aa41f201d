"""Fixtures of experiments: a scenario of two seconds, and swarmctl."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path

import pytest

import swarmd
from swarmd.operator.cli.swarmctl import cli, exit_code_of, run_cli
from swarmd.sim.experiments import manifest, provenance

DUO = """\
description: Two Burgers gather.
duration: 2
realism: ideal
plugin_dir: plugins
arena: {size: [5, 5]}
groups:
  all: {platform: burger, count: 2, prefix: r, pattern: moody, start: {layout: random}}
"""
# Drives, and ends in the way it is told: the way of some bug, of a full memory, of sys.exit.
MOODY = '''
import os
import signal
import time
from typing import Annotated

from msgspec import Meta

from swarmd.api import Inputs, MovementPattern, Params, Twist


class MoodyParams(Params, frozen=True, kw_only=True):
    speed: Annotated[float, Meta(description="how fast")] = 0.1
    end: Annotated[str, Meta(description="see drive")] = "none"


class Moody(MovementPattern[MoodyParams]):
    """Drives, or takes its process with it."""

    params_type = MoodyParams
    report_units = {"turns": "rounds"}

    def drive(self, inputs: Inputs) -> Twist:
        if inputs.now > 0.5:
            if self.params.end == "exit":
                print("moody has had enough", flush=True)
                os._exit(7)
            if self.params.end == "kill":
                os.kill(os.getpid(), signal.SIGKILL)
            if self.params.end == "slow":
                time.sleep(0.3)
            if self.params.end == "hang":
                while True:
                    pass
            if self.params.end == "freeze":
                os.kill(os.getpid(), signal.SIGSTOP)
            if self.params.end == "close":
                os.closerange(3, 100)
            if self.params.end == "fork" and "FORKED" not in os.environ:
                os.environ["FORKED"] = "yes"  # once; both then go on with the run
                os.fork()
            if self.params.end == "remember":
                os.environ["MOODY"] = "was here"
        elif "MOODY" in os.environ:
            return Twist(linear=-self.params.speed)
        return Twist(linear=self.params.speed)
'''

MAIN = "from swarmd.operator.cli.entry import swarmctl; swarmctl()"

Swarmctl = Callable[..., "subprocess.CompletedProcess[str]"]
Refusal = Callable[..., str]


def write_duo(folder: Path) -> Path:
    """The file of a scenario of two robots and two seconds, with a pattern beside it."""
    (folder / "duo" / "plugins").mkdir(parents=True)
    (folder / "duo" / "plugins" / "moody.py").write_text(MOODY)
    path = folder / "duo" / "duo.yaml"
    path.write_text(DUO)
    return path


def swarmctl_in(folder: Path) -> Swarmctl:
    """Runs swarmctl in a folder; words and further environment are given.

    In this process: a start of Python with what it imports takes 0.5 to 2 s of CPU. With further
    environment, which Python reads at its start, in a process of its own.
    """

    def run(*words: object, **environ: str) -> subprocess.CompletedProcess[str]:
        arguments = list(map(str, words))
        if not environ:
            out, errors = io.StringIO(), io.StringIO()
            with pytest.MonkeyPatch.context() as here:
                here.chdir(folder)
                here.setenv("HOME", str(folder))
                with redirect_stdout(out), redirect_stderr(errors):
                    code = run_cli(cli, arguments, "swarmctl", exit_code_of)
            return subprocess.CompletedProcess(arguments, code, out.getvalue(), errors.getvalue())
        return subprocess.run(
            [sys.executable, "-c", MAIN, *arguments],
            capture_output=True,
            text=True,
            cwd=folder,
            env={**os.environ, "HOME": str(folder), **environ},
            timeout=170,
            check=False,
        )

    return run


@pytest.fixture(autouse=True, scope="module")
def state(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A folder in which experiments keep the digests of code that has been run.

    Of a module: a fixture of a package would end with the session, and reach other folders.
    """
    with pytest.MonkeyPatch.context() as here:
        here.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


CODE = Path(swarmd.__file__).resolve().parent
_digest_of_code, _git_state = cache(provenance.digest_of_code), cache(provenance.git_state)


@pytest.fixture(autouse=True, scope="module")
def provenance_of_code() -> Iterator[None]:
    """The digest and the commit of swarmd's code are read once a session: 30 ms a manifest."""

    def git_state(folder: Path) -> provenance.GitState | None:
        return (_git_state if folder == CODE else provenance.git_state)(folder)

    with pytest.MonkeyPatch.context() as here:
        here.setattr(provenance, "digest_of_code", _digest_of_code)
        here.setattr(manifest, "git_state", git_state)
        yield


@pytest.fixture(autouse=True, scope="module")
def workers(forked_starts: None) -> None:
    """Workers of this process's experiments are forks."""


@pytest.fixture
def duo(tmp_path: Path) -> Path:
    """The scenario of `write_duo`."""
    return write_duo(tmp_path)


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a folder, but those that Python compiled."""
    return {str(p): p.read_bytes() for p in sorted(folder.rglob("*[!c]")) if p.is_file()}


@pytest.fixture
def refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Refusal:
    """The line with which swarmctl refuses words; it says and makes nothing else."""

    def refused(*words: object) -> str:
        monkeypatch.chdir(tmp_path)
        before = contents(tmp_path)
        assert run_cli(cli, list(map(str, words)), "swarmctl", exit_code_of) == 2
        captured = capsys.readouterr()
        assert (captured.out, captured.err.count("\n")) == ("", 1)
        assert contents(tmp_path) == before
        return captured.err

    return refused


@pytest.fixture
def swarmctl(tmp_path: Path) -> Swarmctl:
    """Runs swarmctl in the test's folder."""
    return swarmctl_in(tmp_path)
