"""What the code of a hostile pattern can reach from its host, with and without the sandbox."""

from __future__ import annotations

import asyncio
import json
import os
import socket
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from swarmd.cli.plugin_check import describe_patterns
from swarmd.core.host_messages import (
    HostCommand,
    HostEvent,
    Load,
    Loaded,
    LoadRefused,
    StartTrial,
    Step,
    Stepped,
    TrialDone,
)
from swarmd.core.messages import Sandbox
from swarmd.core.values import Inputs
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.pattern_host.sandbox import FILES, NETWORK, PROCESSES
from swarmd.settings.settings import load_platform
from tests.support.processes import has_landlock

pytestmark = pytest.mark.integration

TRIES = """
import contextlib, ctypes, fcntl, json, os, resource, signal, socket, struct, sys

def reached(name, attempt):
    try:
        attempt()
        return name
    except OSError as error:
        assert isinstance(error, PermissionError), (name, error)
        return ""

def system_call(name, number, *arguments):
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.syscall(number, *arguments) < 0:
        raise OSError(ctypes.get_errno(), name)

def tries(place, parent):
    state, key, port, serial = place["state"], place["key"], place["port"], place["serial"]
    pid, own = ctypes.c_long(parent), os.getpid()
    is_pc = os.uname().machine == "x86_64"
    return {
        "read the key": lambda: open(key).read(),
        "write a latch": lambda: open(f"{state}/latches", "a").close(),
        "make a file in the state folder": lambda: open(f"{state}/new", "w").close(),
        "cut a latch": lambda: os.truncate(f"{state}/latches", 3),
        "remove a latch": lambda: os.rename(f"{state}/latches", f"{state}/gone"),
        "open the key to others": lambda: os.chmod(key, 0o644),
        "give the key away": lambda: os.chown(key, os.getuid(), os.getgid()),
        "make the key look older": lambda: os.utime(key, (1, 1)),
        "open a serial port": lambda: os.close(os.open(serial, os.O_RDWR | os.O_NOCTTY)),
        "connect": lambda: socket.create_connection(("127.0.0.1", port), 5).close(),
        "listen": lambda: socket.create_server(("127.0.0.1", 0)).close(),
        "send a datagram": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM).close(),
        "reach a local service": lambda: socket.socket(socket.AF_UNIX).close(),
        "signal the daemon": lambda: os.kill(parent, 0),
        "signal the group of the daemon": lambda: os.killpg(os.getpgid(parent), 0),
        "let a pipe signal the daemon": lambda: own_by(parent, 8, parent),
        "let a pipe signal a thread of the daemon": lambda: own_by(
            parent, 15, struct.pack("ii", 0, parent)
        ),
        "let a socket signal the daemon": lambda: own_socket_by(parent),
        "trace the daemon": lambda: trace(parent, is_pc),
        "read the daemon's memory": lambda: open(f"/proc/{parent}/mem", "rb").close(),
        "read the daemon's environment": lambda: open(f"/proc/{parent}/environ", "rb").close(),
        "take a file of the daemon": lambda: open_of(parent),
        "limit the daemon": lambda: resource.prlimit(parent, resource.RLIMIT_CPU),
        "slow the daemon": lambda: os.setpriority(os.PRIO_PROCESS, parent, 19),
        "leave the process group": lambda: os.setpgid(0, 0),
    }

def own_by(pid, command, owner):
    for end in os.pipe():
        fcntl.fcntl(end, command, owner)
        os.close(end)

def own_socket_by(pid):
    for end in socket.socketpair():
        with end:
            fcntl.ioctl(end, 0x8901, struct.pack("i", pid))

def trace(pid, is_pc):
    seize, detach = 0x4206, 17
    number = 101 if is_pc else 117
    system_call("ptrace", number, seize, ctypes.c_long(pid), None, None)
    interrupt = 0x4207
    system_call("ptrace", number, interrupt, ctypes.c_long(pid), None, None)
    os.waitpid(pid, 0x40000000)
    system_call("ptrace", number, detach, ctypes.c_long(pid), None, None)

def open_of(pid):
    file = os.pidfd_open(pid)
    try:
        system_call("pidfd_getfd", 438, file, 0, 0)
    finally:
        os.close(file)

def all_reached(place, parent):
    return ",".join(filter(None, (reached(*one) for one in tries(place, parent).items())))
"""
PLUGIN = """
class Hostile(Pattern[Params]):
    needs = frozenset()
    def step(self, inputs):
        return Outputs(report={"reached": all_reached(PLACE, os.getppid())})
"""


@dataclass(frozen=True, slots=True)
class Place:
    """A robot's key, state folder and device, a port that listens, and the pattern's folder."""

    plugins: Path
    state: Path
    key: Path
    port: int
    serial: str

    @property
    def told(self) -> dict[str, object]:
        """The fields of it that the hostile code gets."""
        return {
            "state": str(self.state),
            "key": str(self.key),
            "port": self.port,
            "serial": self.serial,
        }


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    for folder in ("plugins", "state", "plugins/keys"):
        (tmp_path / folder).mkdir()
    key = tmp_path / "plugins/keys/key.pem"  # below a folder that the pattern may read
    key.write_text("secret")
    key.chmod(0o600)
    (tmp_path / "state/latches").write_text("latched")
    ends = os.openpty()
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield Place(
            tmp_path / "plugins",
            tmp_path / "state",
            key,
            server.getsockname()[1],
            os.ttyname(ends[1]),
        )
    for end in ends:
        os.close(end)


def in_host(place: Place, code: str, *, is_trial: bool = False) -> tuple[HostEvent, Sandbox | None]:
    """The last event of a host that loads and steps `code`, and the sandbox that it told."""
    (place.plugins / "hostile.py").write_text(code)

    async def run() -> tuple[HostEvent, Sandbox | None]:
        woken = asyncio.Event()
        runner = ProcessRunner(
            asyncio.get_running_loop(),
            place.plugins,
            woken.set,
            secret=[place.state, place.key.parent],
        )

        async def answer(command: HostCommand) -> HostEvent:
            runner.send(command)
            async with asyncio.timeout(60.0):
                while not (found := list(runner.events())):
                    woken.clear()
                    await woken.wait()
            return found[0]

        try:
            load = Load(1, "hostile", (), "r1", load_platform("burger"), 1)
            event = await answer(StartTrial(load) if is_trial else load)
            if isinstance(event, Loaded):
                event = await answer(Step(1, Inputs(now=1.0, dt=0.0)))
            return event, runner.sandbox
        finally:
            runner.close()

    return asyncio.run(run())


def code_of(place: Place) -> str:
    head = "from swarmd.api import Outputs, Params, Pattern\n"
    return f"{head}{TRIES}\nPLACE = {json.dumps(place.told)}\n{PLUGIN}"


def test_a_free_process_of_this_user_reaches_all_that_the_host_is_denied(place: Place) -> None:
    code = f"{TRIES}\nprint(all_reached(json.loads(sys.argv[1]), os.getppid()))"
    command = [sys.executable, "-c", code, json.dumps(place.told)]
    # As the child of a process that may be traced, which this one need not be.
    launcher = "import subprocess, sys; subprocess.run(sys.argv[1:], check=True)"
    done = subprocess.run(
        [sys.executable, "-c", launcher, *command], capture_output=True, text=True, check=True
    )
    names = done.stdout.strip().split(",")
    assert {"read the key", "write a latch", "connect", "signal the daemon"} <= set(names)
    assert {"trace the daemon", "read the daemon's memory", "open a serial port"} <= set(names)
    assert len(names) == TRIES.count('": lambda')


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_a_pattern_reaches_nothing_of_its_robot(place: Place) -> None:
    stepped, sandbox = in_host(place, code_of(place))
    assert sandbox == Sandbox(denied=(FILES, NETWORK, PROCESSES))
    assert isinstance(stepped, Stepped)
    assert stepped.outputs.report == {"reached": ""}
    assert place.key.read_text() == "secret"
    assert [path.name for path in place.state.iterdir()] == ["latches"]


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
def test_code_is_confined_before_it_is_imported(place: Place) -> None:
    refused, _ = in_host(place, f"open({str(place.key)!r})")
    assert isinstance(refused, LoadRefused)
    assert "PermissionError" in refused.text
    result, _ = in_host(place, f"open({str(place.key)!r})", is_trial=True)
    assert isinstance(result, TrialDone)
    assert "PermissionError" in result.text


@pytest.mark.skipif(not has_landlock(), reason="this kernel has no Landlock")
@pytest.mark.parametrize("name", ["state/latches", "home/.config/swarmd/identities/key.pem"])
def test_tools_inspect_code_in_the_same_sandbox(
    place: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    home = tmp_path / "home"
    (home / ".config/swarmd/identities").mkdir(parents=True)
    (home / ".config/swarmd/identities/key.pem").write_text("secret")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    (home / "hostile.py").write_text(f"open({str(tmp_path / name)!r})")
    (row,) = describe_patterns(["hostile"], home, "burger")
    assert "PermissionError" in row["error"]


def test_a_pattern_reads_what_lies_beside_it_and_what_python_imports(
    place: Place, tmp_path: Path
) -> None:
    (place.plugins / "weights").mkdir()
    (place.plugins / "weights/w.txt").write_text("1.5")
    elsewhere = tmp_path / "elsewhere.txt"
    elsewhere.write_text("2.5")
    (place.plugins / "linked.txt").symlink_to(elsewhere)
    code = """
    import os, random, threading, time, numpy, asyncio, json, statistics, zoneinfo
    from pathlib import Path
    from swarmd.api import Outputs, Params, Pattern
    import swarmd.patterns.attraction
    HERE = Path(__file__).parent
    class Reader(Pattern[Params]):
        needs = frozenset()
        def step(self, inputs):
            texts = [(HERE / name).read_text() for name in ("weights/w.txt", "linked.txt")]
            time.localtime()
            os.urandom(4)
            asyncio.run(asyncio.sleep(0))
            numpy.linalg.inv(numpy.eye(64))
            thread = threading.Thread(target=Path("/dev/null").write_text, args=("x",))
            thread.start()
            thread.join()
            return Outputs(report={"sum": sum(map(float, texts))})
    """
    stepped, _ = in_host(place, textwrap.dedent(code))
    assert isinstance(stepped, Stepped)
    assert stepped.outputs.report == {"sum": 4.0}
