"""A simulated world and its daemons as child processes, started and ended together.

The children end with this process, even if this process is killed. Each child asks the kernel for a
signal at the death of its parent (`--die-with-parent`). The parent of the world is this process.
The parent of a daemon is the fork server, whose parent is this process. The kernel sends the signal
when the *thread* that started the child ends, so start a fleet from the main thread.

Each child has its own session: a Ctrl-C in the terminal reaches only this process, which then ends
the children in order.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import msgspec
from msgspec import Struct, structs

from swarmd.core.errors import NetworkError, SwarmError
from swarmd.core.files import as_text, cache_folder, user_path, whole_file
from swarmd.core.fork_server import ForkedProcess, fork_main, start_server
from swarmd.core.processes import how_it_ended
from swarmd.core.values import Platform
from swarmd.settings.platforms import load_platform
from swarmd.settings.yamlfile import text_of
from swarmd.sim.live.live_scenario import SCENARIO_FILE, LiveScenario
from swarmd.sim.live.state import WorldOptions
from swarmd.sim.scenarios.preflight import WHOLE_BODIES
from swarmd.sim.world.detector import DETECTIONS
from swarmd.sim.world.radio import RadioSettings

Process: TypeAlias = subprocess.Popen[bytes] | ForkedProcess
WORLD = "world"
FORKED_DAEMON = "swarmd.sim.live.forked_daemon"
DAEMON_MODULES = (
    *(FORKED_DAEMON, "swarmd.daemon.daemon", "swarmd.drivers.simulated"),
    *("swarmd.pattern_host.worker", "zenoh"),
)
KILL_DELAY = 2.0  # s between TERM and KILL
WORLD_TIMEOUT = 30.0  # s; MuJoCo's first import from a cold disk is slow


class FleetSpec(WorldOptions, Struct, frozen=True, kw_only=True):
    """The options of a fleet: those of its simulated world, and of a daemon for each robot.

    With a scenario (`live`), the scenario describes the world and the daemons. `arena`, `layout`,
    `realism`, `lidar_visibility` and `radio_range` then have no effect.

    - `folder`: for configuration, logs and latches.
    - `absent`: robots without a daemon at the start.
    """

    folder: Path
    realism: Literal["ideal", "realistic"] = "realistic"
    plugin_dir: Path | None = None
    live: LiveScenario | None = None
    absent: frozenset[str] = frozenset()

    @property
    def all_hear_all(self) -> bool:
        """True if the radio reaches each robot from everywhere."""
        radio = RadioSettings() if self.live is None else self.live.scenario.radio
        is_far = self.radio_range is None and radio.neighborhood == "all"
        return is_far and not radio.line_of_sight

    def platforms(self) -> Mapping[str, Platform]:
        """The platform of each robot."""
        if self.live is not None:
            return self.live.scenario.robots
        kinds = {name: load_platform(name) for name in set(self.robots.values())}
        return {robot: kinds[name] for robot, name in self.robots.items()}


class Ready(Struct, frozen=True):
    """The ready line of a world: the endpoint for viewers, and the driver for daemons."""

    endpoint: str
    driver: str
    driver_options: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Child:
    """A child process and the file of its standard error."""

    name: str
    process: Process
    log: Path

    def how_it_ended(self) -> str:
        """A text about the end of the process, with the last line and the path of its log.

        The last line is left out if a signal ended the process: a killed process writes no line
        about its end.
        """
        code = self.process.poll()
        line = "" if code is not None and code < 0 else f": {_last_line(self.log)}"
        is_killed = code == -signal.SIGKILL
        hint = "; the kernel does so where memory ends, see dmesg" if is_killed else ""
        return f"{self.name} {how_it_ended(code)}{line} (log: {self.log}){hint}"


class Fleet:
    """A running world with its daemons, a context manager that leaves no process behind."""

    def __init__(self, spec: FleetSpec) -> None:
        self.spec = spec
        self.endpoint = ""
        self.ready = Ready("", "", {})
        self._children: list[Child] = []  # the world first

    def __enter__(self) -> Fleet:
        try:
            self._start()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()

    @property
    def pids(self) -> Mapping[str, int]:
        """Process ids by name; the world's is `WORLD`."""
        return {child.name: child.process.pid for child in self._children}

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that have a daemon now."""
        return tuple(child.name for child in self._children[1:])

    def start_daemon(self, robot: str) -> None:
        """Start the daemon of a robot that has none."""
        words = ("--config", str(self.spec.folder / f"{robot}.yaml"))
        log = self.spec.folder / f"{robot}.log"
        daemon = fork_main(
            f"{robot}@{self.spec.swarm}",  # for `pkill -x`: another swarm may have a robot so named
            FORKED_DAEMON,
            words,
            stdout=None,
            stderr=log,
        )
        self._children.append(Child(robot, daemon, log))
        self._note()

    def end_daemon(self, robot: str, *, in_order: bool) -> None:
        """End the daemon of a robot, by SIGTERM (`in_order`) or SIGKILL.

        `ended` and `check` no longer report this daemon.
        """
        child = next(child for child in self._children[1:] if child.name == robot)
        self._children.remove(child)
        if in_order:
            child.process.terminate()
        else:
            child.process.kill()
        end_processes([child.process])
        self._note()

    def halt_daemon(self, robot: str, *, is_on: bool) -> None:
        """Halt the daemon of a robot (SIGSTOP), or let it continue; nothing without a daemon."""
        for child in self._children[1:]:
            if child.name == robot:
                child.process.send_signal(signal.SIGSTOP if is_on else signal.SIGCONT)

    def ended(self) -> Mapping[str, str]:
        """A text about the end of each child that has ended, by name."""
        return {
            child.name: child.how_it_ended()
            for child in self._children
            if child.process.poll() is not None
        }

    def check(self, *names: str) -> None:
        """SwarmError if a child of `names`, or any child, has ended."""
        for name, line in self.ended().items():
            if not names or name in names:
                raise SwarmError(line)

    def stop(self) -> None:
        """End every child: TERM, after 2 s KILL. The world ends last, to record the stops."""
        processes = [child.process for child in self._children]
        end_processes(processes[1:])
        end_processes(processes[:1])
        self._children = []
        with contextlib.suppress(OSError, RuntimeError):  # without a home there is no file
            running_file(self.spec.swarm).unlink(missing_ok=True)

    def _note(self) -> None:
        """Write where the world and its daemons are, for other processes of this user."""
        with contextlib.suppress(OSError, RuntimeError):  # a fleet runs without a home, too
            path = running_file(self.spec.swarm)
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            with whole_file(path) as partial:
                partial.write_bytes(msgspec.json.encode(Running(self.endpoint, dict(self.pids))))

    def _start(self) -> None:
        spec = self.spec
        as_text(spec.folder.absolute())  # ConfigError for a path that is not UTF-8
        spec.folder.mkdir(parents=True, exist_ok=True)
        start_server(DAEMON_MODULES)
        if spec.live is not None:
            spec.live.write(spec.folder)
        options = msgspec.json.encode(world_options(spec)).decode()
        command = ["swarmd.sim.live.server", options]
        world = _start_world(command, spec.folder)
        self._children.append(world)
        self.ready = ready = _await_ready(world)
        self.endpoint = ready.endpoint
        for robot in spec.robots:
            config = spec.folder / f"{robot}.yaml"
            config.write_text(text_of(daemon_config(spec, robot, ready)), "utf-8")
        for robot in spec.robots:
            if robot not in spec.absent:
                self.start_daemon(robot)


def end_processes(processes: Sequence[Process], delay: float = KILL_DELAY) -> None:
    """End child processes by SIGTERM, and by SIGKILL those that are left after `delay` s."""
    for process in processes:
        process.terminate()
    deadline = time.monotonic() + delay
    for process in processes:
        try:
            process.wait(timeout=max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


class Running(Struct, frozen=True):
    """The viewers' endpoint of a running world, and the processes by name."""

    endpoint: str
    pids: dict[str, int]


def running_file(swarm: str) -> Path:
    """The file of a running world, by the name of its swarm."""
    return cache_folder() / "worlds" / f"{swarm}.json"


def running(swarm: str) -> Running:
    """The running world of a swarm on this machine; SwarmError without one."""
    try:
        found = msgspec.json.decode(running_file(swarm).read_bytes(), type=Running)
        os.kill(found.pids[WORLD], 0)
    except (OSError, RuntimeError, KeyError, msgspec.DecodeError):
        text = f"no simulated world of swarm {swarm!r} runs on this machine"
        raise SwarmError(f"{text}; start it with swarmctl sim up") from None
    return found


def is_daemon(pid: int, robot: str, swarm: str) -> bool:
    """False if the daemon of a robot has ended, even if another process has its id now."""
    name = f"{robot}@{swarm}".encode()[:15]  # as `start_daemon` gives it and the kernel keeps it
    try:
        return Path(f"/proc/{pid}/comm").read_bytes() == name + b"\n"
    except OSError:
        return False


def robot_ids(platform: str, count: int) -> tuple[str, ...]:
    """Ids for `count` robots of a platform, such as tb3-01."""
    stem = {"burger": "tb3", "waffle_pi": "tb3"}.get(platform, platform.replace("_", "-"))
    return tuple(f"{stem}-{i:02d}" for i in range(1, count + 1))


def world_options(spec: FleetSpec) -> WorldOptions:
    """The options of the world process."""
    names = WorldOptions.__struct_fields__
    options = WorldOptions(**{name: getattr(spec, name) for name in names})
    if spec.live is None:
        return options
    path = str(spec.folder / SCENARIO_FILE)
    rate = spec.live.scenario.trace_rate
    return structs.replace(options, scenario=path, trace_rate=rate)


def daemon_config(spec: FleetSpec, robot: str, ready: Ready) -> dict[str, object]:
    """The content of a daemon's configuration file."""
    platform = spec.robots[robot]
    if platform.endswith(".yaml"):
        platform = str(user_path(platform).absolute())
    config: dict[str, object] = {
        "id": robot,
        "swarm": spec.swarm,
        "profile": "dev",
        "insecure": True,  # the user may have keys for a swarm of this name: an operator's
        "platform": platform,
        "driver": ready.driver,
        "driver_options": {**ready.driver_options, **_detections(spec, robot)},
        "state_dir": str((spec.folder / "state").absolute()),
        "blackbox": {"folder": str((spec.folder / "blackbox").absolute())},
    }
    if spec.live is not None:
        config |= spec.live.daemon_config(robot, spec.folder)
    elif spec.lidar_visibility == "body":
        names = {Path(name).stem for name in spec.robots.values()}
        config["accepts_unseen"] = dict.fromkeys(sorted(names), WHOLE_BODIES)
    if spec.plugin_dir is not None:
        config["plugin_dir"] = str(spec.plugin_dir.absolute())
    return config


def _detections(spec: FleetSpec, robot: str) -> dict[str, bool]:
    """{DETECTIONS: True} for a robot of driver `simulated` with a detector, else {}."""
    if spec.emulator is not None:
        return {}
    name = spec.robots[robot]
    live = spec.live
    platform = load_platform(name) if live is None else live.scenario.robots[robot]
    return {DETECTIONS: True} if DETECTIONS in platform.sensors else {}


def _start_world(arguments: Iterable[str], folder: Path) -> Child:
    log = folder / f"{WORLD}.log"
    # -P: a random.py where this is called is not to shadow a module.
    command = [sys.executable, "-P", "-m", *arguments, "--die-with-parent", str(os.getpid())]
    with log.open("ab") as sink:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=sink,
            start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    return Child(WORLD, process, log)


def _await_ready(world: Child) -> Ready:
    """The ready line of the world; SwarmError if the world ends, NetworkError if it is late."""
    assert world.process.stdout is not None
    is_ready, _, _ = select.select([world.process.stdout], [], [], WORLD_TIMEOUT)
    line = world.process.stdout.readline() if is_ready else b""  # a world writes it at once
    if line:
        with contextlib.suppress(msgspec.DecodeError):  # no ready line
            return msgspec.json.decode(line, type=Ready)
    if world.process.poll() is None and not line:
        # If the output has ended, the process ends soon.
        with contextlib.suppress(subprocess.TimeoutExpired):
            world.process.wait(timeout=0.5)
    if world.process.poll() is not None:
        raise SwarmError(world.how_it_ended())
    raise NetworkError(f"the world was not ready after {WORLD_TIMEOUT:.0f} s (log: {world.log})")


def _last_line(log: Path) -> str:
    lines = log.read_text(errors="replace").strip().splitlines() if log.exists() else []
    return lines[-1].strip() if lines else "its log is empty"
