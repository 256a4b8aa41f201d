"""What runs on macOS and Windows, as far as Linux can tell: without what those systems lack.

A child process finds none of the modules and functions below, and neither do its own children:
`sitecustomize` takes them away before any other code runs.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
# What macOS lacks, by module; "" means whole modules.
MACOS = {
    "": "spwd",
    "os": "pidfd_open memfd_create eventfd sched_getaffinity sched_setaffinity sched_setscheduler"
    " MFD_CLOEXEC O_PATH O_TMPFILE",
    "signal": "pidfd_send_signal SIGPWR SIGPOLL SIGRTMIN SIGRTMAX",
    "socket": "AF_NETLINK AF_PACKET SO_BINDTODEVICE SO_PEERCRED",
    "select": "epoll",
}
# Windows lacks these, too; os.uname stays, since the numpy of Linux needs it.
WINDOWS = {
    "": f"{MACOS['']} fcntl resource pwd grp termios tty pty syslog readline curses crypt",
    "os": f"{MACOS['os']} fork forkpty setsid killpg getuid geteuid getpgid nice chown fchmod"
    " O_DIRECTORY O_NOFOLLOW O_NONBLOCK register_at_fork mkfifo sysconf getloadavg",
    "signal": f"{MACOS['signal']} SIGKILL SIGHUP SIGQUIT SIGUSR1 SIGUSR2 SIGALRM SIGVTALRM SIGCHLD"
    " SIGPIPE ITIMER_VIRTUAL ITIMER_REAL setitimer pthread_sigmask pthread_kill",
    "socket": f"{MACOS['socket']} AF_UNIX SOCK_SEQPACKET SCM_RIGHTS CMSG_LEN send_fds recv_fds",
    "select": f"{MACOS['select']} poll",
}
BLOCK = """
import builtins, ctypes, importlib, io, sys

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name in {absent!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

class Library(ctypes.CDLL):
    def __getattr__(self, name):
        if name == "prctl":
            raise AttributeError(name)
        return super().__getattr__(name)

def refuse(event, arguments):
    if event == "open" and isinstance(arguments[0], str) and arguments[0].startswith("/proc/"):
        raise FileNotFoundError(2, "No such file or directory", arguments[0])

sys.meta_path.insert(0, Absent())
for name in {absent!r}:
    sys.modules.pop(name, None)
for name, words in {lacking!r}.items():
    module = importlib.import_module(name)
    for word in words.split():
        if hasattr(module, word):
            delattr(module, word)
ctypes.CDLL = Library
sys.addaudithook(refuse)
"""
# Two robots for 2 s, by themselves and as a finished experiment; the page and `swarmctl` load.
LOCKSTEP = """
import sys
from pathlib import Path

import swarmd.api
import swarmd.operator.cli.swarmctl
import swarmd.operator.cli.web
import swarmd.sim.cli.exp
import swarmd.sim.experiments.simulate
import swarmd.testing
import swarmd.operator.view.server
from swarmd.sim.experiments.results import load_results
from swarmd.sim.lockstep.lockstep import simulate_run
from swarmd.sim.metrics.catalog import measure
from swarmd.sim.scenarios.scenariofile import load_scenario
from swarmd.sim.view.trace_source import source_of

trace = simulate_run(load_scenario(Path("duo.yaml")), 1)
assert trace.ids == ("r-01", "r-02"), trace.ids
print(measure(trace, ("minimum_gap",))["minimum_gap"] > 0.0)
"""
RESULTS = """
from pathlib import Path
from swarmd.sim.cli.exp import exp
from swarmd.sim.experiments.results import load_results
from swarmd.sim.view.trace_source import source_of

assert len(load_results(Path("runs")).rows) == 2
assert source_of(Path("runs"))
exp(["report", "runs", "--metrics", "minimum_gap"])
"""
SCENARIO = """\
description: "Two Burgers"
duration: 2
arena: {size: [4, 4]}
groups: {r: {platform: burger, count: 2, pattern: attraction}}
"""
EXPERIMENT = """
from swarmd.sim.cli.exp import exp
exp(["run", "duo.yaml", "--seeds", "2", "--out", "runs", "-j", "2"])
"""


def run(folder: Path, system: dict[str, str], code: str) -> str:
    """What a Python prints that lacks what the system lacks."""
    lacking = {name: words for name, words in system.items() if name}
    blocked = folder / "without"
    blocked.mkdir(exist_ok=True)
    text = BLOCK.format(absent=set(system[""].split()), lacking=lacking)
    (blocked / "sitecustomize.py").write_text(text)
    (folder / "duo.yaml").write_text(SCENARIO)
    inherited = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**inherited, "PYTHONPATH": f"{blocked}:{ROOT}"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.integration
@pytest.mark.long
def test_runs_and_reports_are_made_without_what_another_system_lacks(tmp_path: Path) -> None:
    """A run by itself on both; an experiment on macOS, and its report on Windows."""
    pytest.importorskip("matplotlib")
    assert run(tmp_path, MACOS, LOCKSTEP + EXPERIMENT).startswith("True\n")
    assert run(tmp_path, WINDOWS, LOCKSTEP + RESULTS).startswith("True\n")
    assert (tmp_path / "runs" / "report.html").is_file()


@pytest.mark.integration
@pytest.mark.long
def test_a_module_that_linux_alone_has_is_found(tmp_path: Path) -> None:
    """The block blocks: else the tests above could not fail."""
    code = (
        "try:\n    import swarmd.operator.cli.daemon\n"
        "except ModuleNotFoundError as error: print(error.name)"
    )
    assert run(tmp_path, WINDOWS, code) == "resource\n"
