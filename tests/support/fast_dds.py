"""A ROS 2 node on Fast DDS, for tests: `fast_dds_node.cpp`, which each test run compiles.

Fast DDS is what `rmw_fastrtps_cpp` stands on; Debian has its version 2.9. No ROS is needed for it.
"""

from __future__ import annotations

import queue
import shutil
import struct
import subprocess
import threading
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from cyclonedds.core import Qos

from tests.support import ros2_types as dds
from tests.support.dds_node import action_ends, node_info
from tests.support.processes import CAP

SOURCE = Path(__file__).with_name("fast_dds_node.cpp")
HEADERS = ("include/fastdds/dds/domain/DomainParticipant.hpp", "include/fastcdr/Cdr.h")
PREFIXES = ("/usr", "/usr/local")
HEAD = struct.Struct("=II")
EMPTY_CALL = b"\0\1\0\0\0"
"""A call of a std_srvs/Trigger as rmw_fastrtps writes it: no header of a request is in it."""
_SENSORS = (dds.LaserScan,)


@cache
def why_no_fast_dds() -> str:
    """What a test that needs Fast DDS lacks here; empty if nothing."""
    lacks = []
    if shutil.which("g++") is None:
        lacks.append("g++")
    if not any(all((Path(at) / one).exists() for one in HEADERS) for at in PREFIXES):
        lacks.append("libfastrtps-dev")
    return f"no Fast DDS here; apt-get install {' '.join(lacks)}" if lacks else ""


def compile_node(folder: Path) -> Path:
    """The program of the node, made in `folder`; some 3 s of CPU."""
    program = folder / SOURCE.stem
    flags = ("-std=c++17", "-Wall", "-Wextra", "-Werror", "-o", str(program))
    command = ["g++", *flags, str(SOURCE), "-lfastrtps", "-lfastcdr"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return program


class FastDdsNode:
    """Publishes and subscribes as `DdsNode` does, in a process `program` on loopback.

    `clients`: services of type std_srvs/Trigger that it calls.
    """

    def __init__(
        self,
        program: Path,
        domain: int,
        name: str,
        published: Mapping[str, Any] | None = None,
        subscribed: Mapping[str, Any] | None = None,
        *,
        qos: Mapping[str, Qos] | None = None,
        actions: Sequence[str] = (),
        clients: Sequence[str] = (),
    ) -> None:
        assert not qos, "only the usual qualities of service"
        self._types: list[Any] = []
        self._words: list[str] = []
        about = self._add("KEPT_WRITER", "ros_discovery_info", dds.ParticipantEntitiesInfo)
        self._writers = {
            topic: self._add(_quality(kind, "WRITER"), f"rt{topic}", kind)
            for topic, kind in (published or {}).items()
        }
        self._readers = {
            topic: self._add(_quality(kind, "READER"), f"rt{topic}", kind)
            for topic, kind in (subscribed or {}).items()
        }
        for action in actions:
            status = f"{action}/_action/status"
            self._writers[status] = self._add("KEPT_WRITER", f"rt{status}", dds.GoalStatusArray)
            for topic, kind, is_writer in action_ends(action):
                self._add("WRITER" if is_writer else "READER", topic, kind)
        for service in clients:
            call, answer = f"rq{service}Request", f"rr{service}Reply"
            self._writers[service] = self._add("WRITER", call, dds.TriggerCall)
            self._readers[service] = self._add("READER", answer, dds.TriggerResponse)
        self._received: list[queue.SimpleQueue[bytes]] = [queue.SimpleQueue() for _ in self._types]
        self._guids: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._writing = threading.Lock()
        self._process = subprocess.Popen(
            ["setpriv", "--pdeathsig", "KILL", str(program), str(domain), *self._words],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        try:
            *ends, own = [self._guids.get(timeout=CAP) for _ in range(len(self._types) + 1)]
        except queue.Empty:
            self.close()
            raise
        kinds = self._words[::3]
        readers = [guid for guid, kind in zip(ends, kinds, strict=True) if "READER" in kind]
        writers = [guid for guid, kind in zip(ends, kinds, strict=True) if "WRITER" in kind]
        self._write(about, node_info(own, name, "/", readers, writers[1:]).serialize())

    def publish(self, topic: str, message: Any) -> None:
        self._write(self._writers[topic], message.serialize())

    def goals(self, action: str, *states: int) -> None:
        """Publish the states of all goals that an action has."""
        listed = [dds.GoalStatus(status=state) for state in states]
        self.publish(f"{action}/_action/status", dds.GoalStatusArray(listed))

    def call(self, service: str) -> None:
        """Call a service."""
        self._write(self._writers[service], EMPTY_CALL)

    def take(self, topic: str) -> Sequence[Any]:
        """The messages, or answers of a service, since the last call, oldest first."""
        number = self._readers[topic]
        kind, received = self._types[number], self._received[number]
        return [kind.deserialize(received.get()) for _ in range(received.qsize())]

    def close(self) -> None:
        """End in order, so that others are told."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(CAP)
        finally:
            self._process.kill()
            self._process.wait()
            self._thread.join()
            assert self._process.stdout is not None
            self._process.stdout.close()

    def _add(self, kind: str, topic: str, typed: Any) -> int:
        """The number of a new end."""
        self._words += [kind, topic, typed.__idl__.idl_transformed_typename]
        self._types.append(typed)
        return len(self._types) - 1

    def _write(self, number: int, message: bytes) -> None:
        assert self._process.stdin is not None
        with self._writing:
            self._process.stdin.write(HEAD.pack(number, len(message)) + message)
            self._process.stdin.flush()

    def _read(self) -> None:
        """Take what the process writes, until its end."""
        assert self._process.stdout is not None
        while len(head := self._process.stdout.read(HEAD.size)) == HEAD.size:
            number, length = HEAD.unpack(head)
            message = self._process.stdout.read(length)
            is_guid = number >= len(self._types)
            (self._guids if is_guid else self._received[number]).put(message)


def _quality(typed: Any, end: str) -> str:
    return f"LOSSY_{end}" if typed in _SENSORS else end
