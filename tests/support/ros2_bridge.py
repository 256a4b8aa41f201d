"""A real ros2dds bridge for tests and benchmarks, where there is one, on loopback alone.

It is zenoh-bridge-ros2dds on the PATH, or the Zenoh router with the same plugin that `make
ros2-router` builds.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import socket
import subprocess
from pathlib import Path

from tests.support.processes import CAP, free_endpoint, stop_process, wait_until

NAME = "zenoh-bridge-ros2dds"
_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
ROUTER = _CACHE / "swarmd/ros2_router/ros2-router"
LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers>"
    '<Peer address="127.0.0.1"/></Peers><ParticipantIndex>auto</ParticipantIndex>'
    "<MaxAutoParticipantIndex>31</MaxAutoParticipantIndex></Discovery></Domain></CycloneDDS>"
)
_DOMAINS = range(1, 100)  # their ports lie below those that a system gives away
_PARTICIPANTS = 32  # the first one may have ended while others live


def bridge_program() -> str | None:
    """The program of the bridge; None without one."""
    return shutil.which(NAME) or (str(ROUTER) if ROUTER.exists() else None)


def why_no_bridge() -> str:
    """What a test that needs the bridge lacks here; empty if nothing."""
    if bridge_program() is None:
        return f"no {NAME} on PATH, and no router with its plugin: run make ros2-router"
    return ""


def free_domain() -> int:
    """A DDS domain in which nobody on this machine is."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        ports = (7400 + 250 * domain + 10 + 2 * index for index in range(_PARTICIPANTS))
        if all(map(_is_free, ports)):
            return domain
    raise AssertionError("no free DDS domain")


def _is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def _config(endpoint: str, domain: int, namespace: str) -> dict[str, object]:
    """What the bridge's own command line sets, and where it listens."""
    return {
        "mode": "router",
        "listen": {"endpoints": [endpoint]},
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
        "adminspace": {"enabled": True},
        "plugins_loading": {"enabled": True},
        "plugins": {"ros2dds": {"domain": domain, "namespace": namespace}},
    }


class Bridge:
    """The bridge between a DDS domain and `endpoint`; a context manager.

    Its log is in `folder`. `distro` is the robot's. Its end is that of whoever started it. Others
    start it by `command` with `environ`.
    """

    def __init__(
        self, folder: Path, domain: int, *, namespace: str = "/", distro: str = "jazzy"
    ) -> None:
        self.endpoint = free_endpoint()
        self.log = folder / "bridge.log"
        self.domain, self._namespace = domain, namespace
        program, self._config = bridge_program(), folder / "bridge.json5"
        assert program is not None, why_no_bridge()
        self.command = [program, "-c", str(self._config)]
        self.environ = {
            **{name: value for name, value in os.environ.items() if not name.startswith("ROS_")},
            "CYCLONEDDS_URI": LOOPBACK,
            "ROS_DISTRO": distro,
        }
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Bridge:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> Bridge:
        """Start it in `domain`, also again at the same endpoint, and wait until it listens."""
        self.configure()
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", *self.command],
                env=self.environ,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )
        wait_until(self._listens, f"{NAME} listens at {self.endpoint}")
        return self

    def configure(self) -> None:
        """Write the file that `command` reads."""
        settings = _config(self.endpoint, self.domain, self._namespace)
        self._config.write_text(json.dumps(settings))

    def kill(self) -> None:
        """SIGKILL, unless it has ended."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(CAP)
            self._process = None

    def freeze(self) -> None:
        assert self._process is not None
        stop_process(self._process.pid)

    def thaw(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def _listens(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, self.log.read_text()
        host, _, port = self.endpoint.removeprefix("tcp/").rpartition(":")
        with socket.socket() as probe:
            return probe.connect_ex((host, int(port))) == 0
