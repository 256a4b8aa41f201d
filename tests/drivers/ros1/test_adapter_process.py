"""The adapter of driver `ros1` without ROS: with a rospy and a master that are none."""

from __future__ import annotations

import json
import select
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any
from xmlrpc.server import SimpleXMLRPCServer

import pytest

from swarmd.drivers.ros1.adapter_process import (
    ALIVE,
    COMMAND,
    COMMAND_HEAD,
    DATA,
    DATA_HEAD,
    EVENT,
    Adapter,
    KeptTopic,
)
from tests.support.processes import CAP, wait_until

CONFIG: dict[str, Any] = {
    "master": "http://127.0.0.1:9",
    "name": "r",
    "topics": ["/scan"],
    "types": ["sensor_msgs/LaserScan"],
    "md5sums": ["1"],
    "kept_topics": [],
    "command_topics": ["/cmd_vel", "/cmd_vel_joy"],
    "command_types": ["geometry_msgs/Twist"],
    "state_topic": "/swarmd/state",
    "definitions": {
        "geometry_msgs/Twist": ["0", ""],
        "geometry_msgs/TwistStamped": ["9", ""],
        "std_msgs/String": ["5", ""],
    },
    "frame_id": "",
    "is_check": False,
    "holds": False,
}
SCRIPT = Path(sys.modules[Adapter.__module__].__file__ or "")
ROSPY = '''
"""A rospy whose commands cannot be sent."""
import sys
from types import SimpleNamespace

class AnyMsg:
    pass

class Publisher:
    def __init__(self, *args, **kwargs):
        self.data_class = args[1]
        self.impl = SimpleNamespace(set_queue_size=lambda size: None)
    def get_num_connections(self):
        return 1
    def publish(self, message):
        raise OSError("its topics are closed")

def init_node(*args, **kwargs): pass
def Subscriber(*args, **kwargs): pass
def on_shutdown(call): pass
def signal_shutdown(why): pass
def is_shutdown(): return False
def get_name(): return "/r_1"

server = SimpleNamespace(inbound_handler=None)
impl = SimpleNamespace(tcpros_base=SimpleNamespace(
    start_tcpros_server=lambda: None, _tcpros_server=SimpleNamespace(tcp_ros_server=server)))
'''


@pytest.fixture
def ends() -> Iterator[tuple[Adapter, socket.socket]]:
    """An adapter that is not served, and the driver's end of its socket."""
    mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with mine, theirs:
        mine.setblocking(False)
        theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 8192)
        yield Adapter(CONFIG, theirs, SimpleNamespace(), SimpleNamespace()), mine


def message(md5sum: str = "1") -> Any:
    header = {"callerid": "/lidar", "type": "sensor_msgs/LaserScan", "md5sum": md5sum}
    return SimpleNamespace(_connection_header=header, _buff=b"\x00" * 1000)


def taken(sock: socket.socket) -> list[bytes]:
    """All waiting packets."""
    found = []
    while True:
        try:
            found.append(sock.recv(65536))
        except BlockingIOError:
            return found


def test_a_frozen_daemon_gets_the_state_when_it_reads_again(
    ends: tuple[Adapter, socket.socket],
) -> None:
    adapter, mine = ends
    for _ in range(100):
        adapter._on_message(message(), 0)
    state = {"event": "state", "master": True, "others": ["/teleop" * 200]}
    adapter._report(state)
    assert len(taken(mine)) < 100
    adapter._report(state)
    adapter._on_message(message(), 0)
    frames = taken(mine)
    events = [json.loads(frame[1:])["event"] for frame in frames if frame[:1] == EVENT]
    assert events == ["state"]
    assert frames[-1][:1] == DATA


@pytest.mark.parametrize(
    ("md5sum", "content"), [("5", bytes(4096)), ("7", b"")], ids=["a long text", "another type"]
)
def test_a_stop_of_megabytes_has_room_in_the_socket(
    ends: tuple[Adapter, socket.socket], md5sum: str, content: bytes
) -> None:
    adapter, mine = ends
    adapter._master.caller = "/r_1"
    header = {"callerid": "/rostopic", "type": "std_msgs/String", "md5sum": md5sum}
    adapter._on_other_command(SimpleNamespace(_connection_header=header, _buff=bytes(1 << 22)), 1)
    (frame,) = taken(mine)
    assert DATA_HEAD.unpack_from(frame)[:2] == (DATA, len(CONFIG["topics"]) + 1)
    assert frame[DATA_HEAD.size :] == content


def test_a_stop_that_finds_the_socket_full_is_sent_until_it_has_room(
    ends: tuple[Adapter, socket.socket],
) -> None:
    adapter, mine = ends
    adapter._master.caller = "/r_1"
    number = len(CONFIG["topics"]) + 1
    kept = adapter._kept[number] = KeptTopic(number, adapter)
    while adapter.send(ALIVE):
        pass
    header = {"callerid": "/rostopic", "type": "std_msgs/String", "md5sum": "5"}
    adapter._on_other_command(SimpleNamespace(_connection_header=header, _buff=b"smoke"), 1)
    kept.send_again()
    assert set(taken(mine)) == {ALIVE}
    for _ in range(2):
        kept.report_end()  # a stop holds without its publisher
        kept.send_again()
    (frame,) = taken(mine)
    assert DATA_HEAD.unpack_from(frame)[:2] == (DATA, number)
    assert frame[DATA_HEAD.size :] == b"smoke"


def test_a_message_of_another_type_is_reported_by_its_publisher_only(
    ends: tuple[Adapter, socket.socket],
) -> None:
    adapter, mine = ends
    adapter._on_message(message("2"), 0)
    (frame,) = taken(mine)
    assert json.loads(frame[1:]) == {
        "event": "foreign",
        "topic": "/scan",
        "node": "/lidar",
        "type": "sensor_msgs/LaserScan",
        "md5sum": "2",
    }


@pytest.mark.parametrize(
    ("caller", "md5sum", "passed"),
    [
        ("/r_1", "0", None),
        ("/teleop", "0", b"\x00" * 1000),
        ("/teleop", "9", b"\x00" * 1000),
        ("/teleop", "7", b""),
    ],
    ids=["its own", "another's", "stamped", "of another type"],
)
@pytest.mark.parametrize("index", [0, 1])
def test_commands_of_other_nodes_are_passed_on(
    ends: tuple[Adapter, socket.socket], caller: str, md5sum: str, passed: bytes | None, index: int
) -> None:
    adapter, mine = ends
    adapter._master.caller = "/r_1"
    command = message(md5sum)
    command._connection_header["callerid"] = caller
    adapter._on_other_command(command, index)
    frames = [(*DATA_HEAD.unpack_from(frame)[:2], frame[DATA_HEAD.size :]) for frame in taken(mine)]
    number = len(CONFIG["topics"]) + index
    assert frames == ([] if passed is None else [(DATA, number, passed)])


def test_adapters_that_hear_commands_are_no_bases(ends: tuple[Adapter, socket.socket]) -> None:
    adapter, _ = ends
    ends_of = [
        SimpleNamespace(endpoint_id=name) for name in ("/base", "/swarmd_r_1_2", "/swarmd_r")
    ]
    impl = SimpleNamespace(connections=ends_of)
    adapter._publisher = SimpleNamespace(impl=impl, get_num_connections=lambda: len(ends_of))
    assert adapter._bases() == 1


@pytest.mark.parametrize(("linear", "arms"), [(0.0, False), (-0.0, False), (0.1, True)])
def test_zero_of_either_sign_does_not_move_a_base(
    ends: tuple[Adapter, socket.socket], linear: float, arms: bool
) -> None:
    adapter, _ = ends
    adapter._pass_on(struct.pack("<6d", linear, 0.0, 0.0, 0.0, 0.0, 0.0), time.monotonic())
    assert adapter._is_armed is arms


@pytest.fixture
def master() -> Iterator[str]:
    """The address of a master without nodes."""
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as server:
        known = {
            "getUri": "",
            "getSystemState": [[], [["/scan", ["/r_1"]]], []],
            "getTopicTypes": [],
        }
        for name, value in known.items():
            server.register_function(lambda caller, value=value: [1, "", value], name)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join(CAP)


@pytest.mark.integration
def test_an_adapter_whose_stderr_is_not_read_still_leaves(tmp_path: Path, master: str) -> None:
    (tmp_path / "rospy.py").write_text(ROSPY)
    mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with mine, theirs:
        process = subprocess.Popen(
            [sys.executable, str(SCRIPT), json.dumps({**CONFIG, "master": master})],
            stdin=theirs.fileno(),
            stderr=subprocess.PIPE,
            env={"PYTHONPATH": str(tmp_path)},
        )
        assert process.stderr is not None
        moving = struct.pack("<6d", 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)
        line = b""
        while b"its topics are closed" not in line:
            mine.send(COMMAND_HEAD.pack(COMMAND, time.monotonic()) + moving)
            mine.recv(65536)
            line = process.stderr.readline() if _waits(process.stderr) else b""
        process.stderr.close()
    try:
        wait_until(lambda: process.poll() is not None, "it has left")
    finally:
        process.kill()
        process.wait(CAP)
    assert process.returncode == 0


@pytest.mark.integration
def test_an_adapter_that_joins_only_in_part_ends_with_the_reason(
    tmp_path: Path, master: str
) -> None:
    half = ROSPY + '\ndef Subscriber(*args, **kwargs): raise ConnectionRefusedError("gone")\n'
    (tmp_path / "rospy.py").write_text(half)
    mine, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with mine, theirs:
        subprocess.run(
            [sys.executable, str(SCRIPT), json.dumps({**CONFIG, "master": master})],
            stdin=theirs.fileno(),
            stderr=subprocess.DEVNULL,
            env={"PYTHONPATH": str(tmp_path)},
            timeout=CAP,
            check=False,
        )
        mine.setblocking(False)
        frames = taken(mine)
    (event,) = (json.loads(frame[1:]) for frame in frames if frame[:1] == EVENT)
    assert "it could not join the master: gone" in event["text"]


def _waits(pipe: IO[bytes]) -> bool:
    return bool(select.select([pipe], [], [], 0.0)[0])
