"""Real daemons as child processes of a test: started, frozen, killed, and gone at the end."""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from unittest import mock

import yaml

from swarmd.core.fork_server import ForkedProcess, fork_main, start_server
from swarmd.core.values import Value
from swarmd.driver_api.watchdog import watchdog_name
from swarmd.pattern_host.worker import NICE
from swarmd.sim.live.fleet import DAEMON_MODULES
from swarmd.testing.driver_contract import is_running
from tests.support.forked_python import COMM

CAP = 60.0
DAEMON = ("swarmd.operator.cli.daemon",)
FORKED = "tests.support.forked"
MODULES = (
    *DAEMON_MODULES,
    *(
        "swarmd.operator.cli.swarmctl",
        "swarmd.operator.cli.send",
        "swarmd.operator.verbs.run.command",
        "swarmd.operator.verbs.members.command",
    ),
    "swarmd.operator.session.operator",
)
"""What the server of forks imports."""
_READ_AT_START = {"SWARMD_COMPILED", "PYTHONPATH", "LD_PRELOAD"}


def unique_swarm() -> str:
    """A swarm name that no other test uses."""
    return f"t{uuid.uuid4().hex[:12]}"


def run_command(
    name: str, *words: object, cwd: Path, **environ: str
) -> subprocess.CompletedProcess[str]:
    """Run `swarmctl` or `swarmd` to its end, in a swarm and with a home of its own."""
    return subprocess.run(
        [
            sys.executable,
            "-c",
            f"from swarmd.operator.cli.entry import {name}; {name}()",
            *map(str, words),
        ],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        cwd=cwd,
        env={**os.environ, "HOME": str(cwd), "SWARM": unique_swarm(), **environ},
        timeout=120,
        check=False,
    )


def free_endpoint() -> str:
    """A TCP endpoint on loopback at which nothing listens."""
    return f"tcp/127.0.0.1:{free_port()}"


def free_port() -> int:
    """A port of loopback that no socket has, by TCP or UDP.

    It is none of those that the kernel gives to sockets which ask for any: it stays free.
    """
    while True:
        port = 20000 + secrets.randbelow(_first_given_port() - 20000)
        with socket.socket() as stream, socket.socket(type=socket.SOCK_DGRAM) as datagram:
            try:
                stream.bind(("127.0.0.1", port))
                datagram.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port


@cache
def _first_given_port() -> int:
    return int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])


def wait_until(condition: Callable[[], bool], what: str, cap: float = CAP) -> None:
    """Return once the condition holds; AssertionError naming `what` after `cap` s."""
    deadline = time.monotonic() + cap
    pause = threading.Event()
    while not condition():
        assert time.monotonic() < deadline, f"after {cap:.0f} s still not: {what}"
        pause.wait(0.02)


def attempts(what: str) -> Iterator[None]:
    """Attempts until `what` holds, for CAP s: how many a busy machine needs is no property."""
    deadline = time.monotonic() + CAP
    while True:
        yield
        assert time.monotonic() < deadline, f"after {CAP:.0f} s still not: {what}"


def stop_process(pid: int) -> None:
    """Send SIGSTOP, and return once each thread of the process is stopped."""
    os.kill(pid, signal.SIGSTOP)
    threads = Path(f"/proc/{pid}/task")

    def is_stopped() -> bool:
        with contextlib.suppress(OSError):  # a thread has ended meanwhile
            files = threads.glob("*/stat")
            return {file.read_text().rpartition(")")[2].split()[0] for file in files} == {"T"}
        return False

    wait_until(is_stopped, f"process {pid} is stopped")


class DaemonProcess:
    """One `swarmd` in a process of its own, forked where it can be; a context manager.

    `folder` keeps its configuration, state, `log` (standard error) and `out`, so that a second
    one can be a restart; `environ` is added to this process's environment. `namespace` is the
    network namespace in which it runs, `prefix` a command that becomes the daemon in the same
    process, such as `env`; `module` is what Python runs, with its own arguments; `is_forked` False
    starts it from nothing, as for a measurement.
    """

    def __init__(
        self,
        folder: Path,
        *,
        swarm: str,
        robot: str,
        endpoint: str,
        platform: str = "waffle_pi",
        plugin_dir: Path | None = None,
        options: Mapping[str, Value] | None = None,
        environ: Mapping[str, str] | None = None,
        namespace: str = "",
        prefix: Sequence[str] = (),
        module: Sequence[str] = DAEMON,
        is_forked: bool = True,
    ) -> None:
        self.robot = robot
        self.swarm = swarm
        folder.mkdir(parents=True, exist_ok=True)
        config = folder / f"{robot}.yaml"
        settings: dict[str, object] = {
            "id": robot,
            "swarm": swarm,
            "platform": platform,
            "driver": "simulated",
            "driver_options": {"endpoint": endpoint},
            "state_dir": str(folder / "state"),
            **(options or {}),
        }
        black_box = Path(str(settings["state_dir"])).parent / "blackbox"
        settings.setdefault("blackbox", {"folder": str(black_box)})  # it goes with the test
        if plugin_dir is not None:
            settings["plugin_dir"] = str(plugin_dir)
        config.write_text(yaml.safe_dump(settings))
        self.log = folder / f"{robot}.log"
        self._begin = self.log.stat().st_size if self.log.exists() else 0
        self.out = folder / f"{robot}.out"
        self.process: subprocess.Popen[bytes] | ForkedProcess
        words: tuple[str, ...] = ("--config", str(config))
        given = environ or {}
        is_cold = "SWARMD_COMPILED" in os.environ or _READ_AT_START & given.keys()
        if is_forked and not is_cold and module == DAEMON and not prefix:
            start_server(MODULES)
            words = ("daemon", namespace, *words)
            with mock.patch.dict(os.environ, given):
                self.process = fork_main(robot, FORKED, words, stdout=self.out, stderr=self.log)
            return
        entering = ("ip", "netns", "exec", namespace) if namespace else ()
        command = [*entering, *prefix, sys.executable, "-m", *module, *words]
        command += ["--die-with-parent", str(os.getpid())]
        with self.log.open("ab") as log, self.out.open("ab") as out:
            self.process = subprocess.Popen(
                command, stdout=out, stderr=log, env={**os.environ, **given}
            )

    def __enter__(self) -> DaemonProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()
        for pid in watchdogs(self.swarm, self.robot):
            end_process(pid)

    def wait_ready(self) -> DaemonProcess:
        """Return once it says that it is ready; AssertionError with its log if it ends before."""
        wait_until(self._is_ready_or_ended, f"{self.robot} ready; log: {self.text()[-2000:]}")
        assert self.process.poll() is None, self.text()
        return self

    def text(self) -> str:
        """Its log so far, without that of an earlier life."""
        with self.log.open("rb") as log:
            log.seek(self._begin)
            return log.read().decode(errors="replace")

    def send(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def freeze(self) -> None:
        self.send(signal.SIGSTOP)

    def thaw(self) -> None:
        self.send(signal.SIGCONT)

    def terminate(self) -> int:
        self.send(signal.SIGTERM)
        return self.process.wait(CAP)

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(CAP)

    def host_pid(self) -> int:
        """The process id of its pattern host; AssertionError if there is none within the cap."""
        found: list[int] = []

        def look() -> bool:
            found[:] = children(self.process.pid)
            return bool(found)

        wait_until(look, f"{self.robot} has a pattern host")
        return found[-1]

    def _is_ready_or_ended(self) -> bool:
        return "ready in swarm" in self.text() or self.process.poll() is not None


def children(pid: int) -> list[int]:
    """The process ids of a process's living children, oldest first, without a server of forks."""
    found: list[int] = []
    with contextlib.suppress(OSError):  # the process has ended meanwhile
        for task in Path(f"/proc/{pid}/task").glob("*/children"):
            with contextlib.suppress(OSError):  # this thread has ended meanwhile
                found += [int(child) for child in task.read_text().split()]
    return sorted(child for child in found if not _is_server(child))


def _is_server(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/comm").read_text() == f"{COMM}\n"
    except OSError:  # it has ended meanwhile
        return False


def assert_keeps_nothing_of_its_daemon(daemon: int) -> None:
    """Assert that the only child of a daemon is a forked, confined pattern host.

    The host has the descriptors of a host alone, its own session, and a lower priority.
    """
    (host,) = children(daemon)
    own = Path(f"/proc/{host}")
    wait_until(lambda: "Seccomp:\t2\n" in (own / "status").read_text(), "the host is confined")
    assert (own / "comm").read_text() == "swarmd-host\n"
    kinds = sorted(os.readlink(one).split(":")[0] for one in (own / "fd").iterdir())
    assert kinds == ["/dev/null", "pipe", "pipe", "socket"]
    assert os.getsid(host) == os.getpgid(host) == host
    status = dict(line.split(":\t", 1) for line in (own / "status").read_text().splitlines())
    assert (status["Seccomp"], status["Threads"]) == ("2", "1")
    nice = os.getpriority(os.PRIO_PROCESS, daemon) + NICE
    assert os.getpriority(os.PRIO_PROCESS, host) == min(nice, 19)


def end_process(pid: int) -> None:
    """SIGKILL to a process that may have ended."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def watchdogs(swarm: str, robot: str) -> list[int]:
    """The process ids of the watchdogs of a robot, also of one whose daemon has ended."""
    name, found = watchdog_name(swarm, robot).encode(), []
    for cmdline in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if name in cmdline.read_bytes().split(b"\0"):
                found.append(int(cmdline.parent.name))
        except OSError:  # it has ended meanwhile
            continue
    return sorted(pid for pid in found if is_running(pid))


@cache
def has_landlock() -> bool:
    """Whether the kernel can confine a process to files."""
    done = subprocess.run(
        [sys.executable, "-c", "import ctypes; print(ctypes.CDLL(None).syscall(444, None, 0, 1))"],
        capture_output=True,
        text=True,
        check=True,
    )
    return int(done.stdout) > 0
