"""A real zenoh-bridge-ros2dds for tests and benchmarks, where there is one, on loopback alone."""

from __future__ import annotations

import os
import random
import shutil
import signal
import socket
import subprocess
from pathlib import Path

from tests.support.processes import CAP, free_endpoint, wait_until

NAME = "zenoh-bridge-ros2dds"
LOOPBACK = (
    '<CycloneDDS><Domain Id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
    "<AllowMulticast>false</AllowMulticast></General><Discovery><Peers>"
    '<Peer address="127.0.0.1"/></Peers><ParticipantIndex>auto</ParticipantIndex></Discovery>'
    "</Domain></CycloneDDS>"
)
_DOMAINS = range(1, 100)  # their ports lie below those that a system gives away


def why_no_bridge() -> str:
    """What a test that needs the bridge lacks here; empty if nothing."""
    if shutil.which(NAME) is None:
        return f"no {NAME} on PATH; it is among the releases of eclipse-zenoh/zenoh-plugin-ros2dds"
    return ""


def free_domain() -> int:
    """A DDS domain in which nobody on this machine is."""
    for domain in random.sample(_DOMAINS, len(_DOMAINS)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("127.0.0.1", 7400 + 250 * domain + 10))
            except OSError:
                continue
            return domain
    raise AssertionError("no free DDS domain")


class Bridge:
    """The bridge between a DDS domain and `endpoint`; a context manager.

    Its log is in `folder`. `distro` is the robot's. Its end is that of whoever started it.
    """

    def __init__(
        self, folder: Path, domain: int, *, namespace: str = "/", distro: str = "jazzy"
    ) -> None:
        self.endpoint = free_endpoint()
        self.log = folder / "bridge.log"
        self._command = [
            *("setpriv", "--pdeathsig", "KILL", NAME, "-d", str(domain), "-n", namespace),
            *("-l", self.endpoint, "--no-multicast-scouting"),
        ]
        self._environ = {
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
        """Start it, also again at the same endpoint, and wait until it listens."""
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                self._command, env=self._environ, stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        wait_until(self._listens, f"{NAME} listens at {self.endpoint}")
        return self

    def kill(self) -> None:
        """SIGKILL, unless it has ended."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(CAP)
            self._process = None

    def freeze(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def _listens(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, self.log.read_text()
        host, _, port = self.endpoint.removeprefix("tcp/").rpartition(":")
        with socket.socket() as probe:
            return probe.connect_ex((host, int(port))) == 0
