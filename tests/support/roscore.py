"""A real ROS 1 master for tests and benchmarks, where the system has one."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
import xmlrpc.client
from functools import cache
from pathlib import Path

from swarmd.testing.driver_contract import is_running
from tests.support.processes import CAP, children, end_process, free_port, wait_until

PYTHON = "/usr/bin/python3"
"""Debian's packages of ROS work with this interpreter alone."""


@cache
def why_no_ros1() -> str:
    """What a test that needs ROS 1 lacks here; empty if nothing."""
    if shutil.which("roscore") is None:
        return "no roscore here; apt-get install ros-core"
    script = "import rospy, sensor_msgs.msg, geometry_msgs.msg, nav_msgs.msg"
    done = subprocess.run([PYTHON, "-c", script], capture_output=True, text=True, check=False)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1:]
        return (
            f"{PYTHON}: {' '.join(last)}; apt-get install python3-rospy python3-sensor-msgs"
            " python3-geometry-msgs python3-nav-msgs"
        )
    return ""


class RosCore:
    """`roscore` on a free port of loopback, its files in `folder`; a context manager.

    `environ` is for nodes that use it. Nothing of it outlives `kill`. `is_whole` false: the master
    alone, the process that roscore starts first; it is there within a tenth of the time.
    """

    def __init__(self, folder: Path, *, is_whole: bool = True) -> None:
        self._is_whole = is_whole
        self.port = free_port()
        self.uri = f"http://127.0.0.1:{self.port}"
        self.environ = {
            **{name: value for name, value in os.environ.items() if name != "ROS_HOSTNAME"},
            "ROS_MASTER_URI": self.uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
        }
        self._process: subprocess.Popen[bytes] | None = None
        self._all: list[int] = []

    def __enter__(self) -> RosCore:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.kill()

    def start(self) -> RosCore:
        """Start it, also again on the same port, and wait until it answers."""
        command = ["roscore"] if self._is_whole else ["rosmaster", "--core"]
        self._process = subprocess.Popen(
            [*command, "-p", str(self.port)],
            env=self.environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            wait_until(self._answers, f"roscore at {self.uri} answers")
        except BaseException:
            self.kill()
            raise
        return self

    def kill(self) -> None:
        """SIGKILL to all of its processes."""
        if self._process is None:
            return
        found = [*children(self._process.pid), *self._all]
        self._process.kill()
        self._process.wait(CAP)
        self._process, self._all = None, []
        for pid in found:
            if is_running(pid):
                end_process(pid)
        deadline = time.monotonic() + CAP
        while any(is_running(pid) for pid in found) and time.monotonic() < deadline:
            time.sleep(0.01)

    def send(self, number: signal.Signals) -> None:
        """Send it a signal, such as SIGSTOP."""
        assert self._process is not None
        for pid in (self._process.pid, *self._all):
            os.kill(pid, number)

    def topics(self) -> dict[str, list[str]]:
        """The nodes that publish each topic, as the master knows."""
        with xmlrpc.client.ServerProxy(self.uri) as master:
            answer: object = master.getSystemState("/test")
        assert isinstance(answer, list)
        return dict(answer[2][0])

    def _answers(self) -> bool:
        """Whether the master answers and `rosout`, which comes last, is there."""
        assert self._process is not None
        self._all = children(self._process.pid)
        try:
            return "/rosout_agg" in self.topics() or not self._is_whole
        except (OSError, xmlrpc.client.Error):
            assert self._process.poll() is None, "roscore has ended"
            return False
