"""Recordings as files: what is written is read again, also from cut and damaged files."""

from __future__ import annotations

import errno
import json
import math
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import zstandard
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from msgspec import structs
from msgspec.structs import replace

from swarmd.core.avoided import Avoided
from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    CodeInput,
    DriverInput,
    DuplicateInput,
    HostInput,
    Input,
    MessageInput,
    NeighborsInput,
    OdometryInput,
    PoseInput,
    ReadingsInput,
    RosterInput,
    ScanInput,
)
from swarmd.core.host_messages import Stepped
from swarmd.core.messages import LimitingObstacle
from swarmd.core.values import Neighbor, Odometry, Outputs, Pose, Scan, SharedPose, Twist
from swarmd.daemon.recording import frames, messages
from swarmd.daemon.recording.cdr import CdrWriter, Message
from swarmd.daemon.recording.process import Converter
from swarmd.daemon.recording.reader import RecordedMessage, read_file
from swarmd.daemon.recording.writer import CHUNK_TIME, RecordingWriter
from swarmd.robot.protection.decision import Decision
from swarmd.settings.file_limits import FileLimits

BEGIN = 1_700_000_000_000_000_000
STAMP = "geometry_msgs/msg/TwistStamped"


def command(speed: float) -> Message:
    return CdrWriter().header(0.0, "").doubles(speed, *(0.0,) * 5).as_message(STAMP)


def recorded(folder: Path, seconds: int = 20) -> Path:
    """A file of ten commands a second, with a chunk every CHUNK_TIME."""
    writer = RecordingWriter(folder, "tb3-01", {"robot": "tb3-01"})
    for k in range(10 * seconds):
        writer.add("/command/safe", command(k), BEGIN + k * 10**8, k)
    writer.close()
    assert writer.path is not None
    return writer.path


def speeds(found: list[RecordedMessage]) -> list[float]:
    return [messages.deserialize(one.kind, one.payload).twist.linear.x for one in found]


def test_the_library_and_a_ros_decoder_read_what_is_written(tmp_path: Path) -> None:
    path = recorded(tmp_path)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [
            (c.topic, m.log_time, d.twist.linear.x) for _, c, m, d in reader.iter_decoded_messages()
        ]
    assert found == [("/command/safe", BEGIN + k * 10**8, k) for k in range(200)]
    whole = read_file(path)
    assert whole.fault == ""
    assert whole.about["robot"] == "tb3-01"
    assert speeds(whole.messages) == list(range(200))
    index = json.loads(path.with_suffix(".index.json").read_text())
    assert index["messages"] == {"/command/safe": 200}
    assert (index["begin_ns"], index["end_ns"]) == (BEGIN, BEGIN + 199 * 10**8)
    assert index["bytes"] == path.stat().st_size


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.evidence)])
def test_a_file_that_is_cut_anywhere_keeps_each_chunk_before_the_cut(
    tmp_path: Path, step: int
) -> None:
    path = recorded(tmp_path, seconds=8)
    data, cut = path.read_bytes(), tmp_path / "cut.mcap"
    whole = read_file(path).messages
    before = 0
    for size in range(0, len(data), step):
        cut.write_bytes(data[:size])
        found = read_file(cut)
        assert found.fault
        kept = found.messages
        assert kept == whole[: len(kept)]
        assert len(kept) >= before, "a longer file holds no less"
        before = len(kept)
    assert before == len(whole) == 80


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.evidence)])
def test_a_wrong_byte_loses_at_most_its_chunk_and_gives_no_false_message(
    tmp_path: Path, step: int
) -> None:
    path = recorded(tmp_path, seconds=8)
    data, damaged = path.read_bytes(), tmp_path / "damaged.mcap"
    whole = read_file(path).messages
    known = set(whole)
    per_chunk = round(CHUNK_TIME * 10) + 1
    for place in range(len(messages_magic()), len(data), step):
        wrong = bytearray(data)
        wrong[place] ^= 0x55
        damaged.write_bytes(wrong)
        found = read_file(damaged)
        assert known.issuperset(found.messages)
        assert len(found.messages) >= len(whole) - per_chunk or found.fault


def test_a_chunk_that_states_a_huge_size_takes_no_memory(tmp_path: Path) -> None:
    path = recorded(tmp_path, seconds=8)
    data, packed = path.read_bytes(), zstandard.compress(b"x" * 999)
    body = data.index(b"\x28\xb5\x2f\xfd")  # of the first chunk
    head = packed[:4] + bytes([0xE0]) + (2**46).to_bytes(8, "little")  # RFC 8878, 3.1.1.1
    path.write_bytes(data[:body] + head + data[body + len(head) :])
    found = read_file(path)
    assert found.fault
    assert len(found.messages) == 80 - round(CHUNK_TIME * 10) - 1


def messages_magic() -> bytes:
    return b"\x89MCAP0\r\n"


def test_a_new_file_begins_after_a_size_and_after_an_age(tmp_path: Path) -> None:
    writer = RecordingWriter(
        tmp_path,
        "a",
        {},
        limits=FileLimits(file_seconds=5.0),
        latched=frozenset({"/scan/geometry"}),
    )
    writer.add("/scan/geometry", command(-1.0), BEGIN)
    for k in range(120):
        writer.add("/command/safe", command(k), BEGIN + k * 10**8)
    writer.close()
    files = [read_file(path) for path in sorted(tmp_path.glob("*.mcap"))]
    assert [speeds(one.messages) for one in files] == [
        [-1.0, *range(50)],
        [-1.0, *range(50, 100)],
        [-1.0, *range(100, 120)],
    ]
    small = RecordingWriter(tmp_path / "b", "b", {}, limits=FileLimits(file_bytes=20_000))
    for k in range(2000):
        small.add("/command/safe", command(k), BEGIN + k)
    small.close()
    sizes = [path.stat().st_size for path in sorted((tmp_path / "b").glob("*.mcap"))]
    assert len(sizes) > 2


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    first, second = recorded(tmp_path, 1), recorded(tmp_path, 1)
    assert (first.name, second.name) == ("tb3-01-00001.mcap", "tb3-01-00002.mcap")
    assert len(read_file(first).messages) == 10


@pytest.mark.integration
def test_what_was_added_two_seconds_before_a_kill_is_kept(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from tests.daemon.recording.test_files import *\n"
        f"writer = RecordingWriter(Path({str(tmp_path)!r}), 'a', {{}})\n"
        "for k in range(95): writer.add('/command/safe', command(k), BEGIN + k * 10**8)\n"
        "print('written', flush=True); sys.stdin.read()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert child.stdout is not None
    assert child.stdout.readline() == b"written\n"
    child.send_signal(signal.SIGKILL)
    child.communicate()
    found = read_file(tmp_path / "a-00001.mcap")
    assert speeds(found.messages) == list(range(81))
    assert found.fault


def test_a_full_disk_is_an_oserror_and_leaves_what_was_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RecordingWriter(tmp_path, "a", {})
    for k in range(50):
        writer.add("/command/safe", command(k), BEGIN + k * 10**8)

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        writer.flush(BEGIN + 50 * 10**8)
    writer.abandon()
    assert len(read_file(tmp_path / "a-00001.mcap").messages) >= 40


@pytest.mark.parametrize("content", [b"", b"\x89MC", b"PK\x03\x04"])
def test_a_file_that_is_none_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    if content.startswith(b"PK"):
        with pytest.raises(ConfigError, match="not a recording"):
            read_file(path)
    else:
        assert read_file(path).fault.startswith("cut off at byte")
    with pytest.raises(ConfigError, match="cannot be read"):
        read_file(tmp_path / "missing.mcap")


def through(message: Message) -> Any:
    return messages.deserialize(*message)


def test_scans_are_exact_with_their_geometry() -> None:
    bearings = np.array([-0.1, 0.3, 0.35])
    ranges = np.array([np.float32(0.7), math.inf, -math.inf], np.float64)
    for ages in (None, np.array([0.2, 0.1, 0.0])):
        scan = Scan(7, 1_700_000_000.25, ranges, bearings, 0.12, 3.5, ages)
        geometry = through(messages.geometry_message(scan))
        back = messages.scan_of(through(messages.scan_message(scan)), 7, geometry)
        assert (back.seq, back.stamp, back.range_min, back.range_max) == (7, scan.stamp, 0.12, 3.5)
        assert back.ranges.tobytes() == ranges.tobytes()
        assert frames.has_geometry_of(back, scan)
    assert not frames.has_geometry_of(scan, replace(scan, range_max=8.0))
    rough = messages.scan_of(through(messages.scan_message(scan)), 7, None)
    assert rough.bearings[:2] == pytest.approx(bearings[:2], abs=1e-7)


def test_other_inputs_are_the_same_after_writing_and_reading() -> None:
    odometry = Odometry(12.5, Pose(1.0, -2.0, 3.0), Twist(0.1, 0.2, 0.3))
    back = messages.odometry_of(through(messages.odometry_message(odometry)))
    assert back.twist == odometry.twist
    assert (back.stamp, back.pose.x, back.pose.y) == (12.5, 1.0, -2.0)
    assert back.pose.yaw == pytest.approx(3.0, abs=1e-15)
    neighbors = (Neighbor("a", 0.0, 1.0, None, 0.5), Neighbor("b", 0.0, in_reach=False))
    assert messages.neighbors_of(through(messages.neighbors_message(neighbors, 1.0))) == neighbors
    shared = SharedPose(3.0, Pose(1.0, 2.0, 0.5), 0.1, 0.02, "hall")
    told = messages.pose_of(through(messages.pose_message(shared)))
    assert told.pose.yaw == pytest.approx(0.5, abs=1e-15)
    assert (told.stamp, told.error, told.yaw_error, told.frame) == (3.0, 0.1, 0.02, "hall")
    values = {"battery": 0.5, "light": -1.0}
    assert messages.readings_of(through(messages.readings_message(values, 1.0))) == values


def test_every_kind_of_entry_is_a_message_that_a_ros_decoder_reads(tmp_path: Path) -> None:
    row = LimitingObstacle(0.1, 0.2, 0.3)
    decision = Decision("barrier", Twist(0.2), Twist(0.1), None, True, (row,), 0.2, None, 3)
    decision = structs.replace(decision, avoided=Avoided(math.radians(-30.0), 0.8))
    scan = Scan(7, 2.0, np.array([0.7, math.inf]), np.array([-0.1, 0.3]), 0.12, 3.5)
    stepped = Stepped(1, Outputs(Twist(0.2)), 7)
    converter = Converter(frames.Begin(1.0, str(tmp_path), "a", {"robot": "a"}, 9e8, FileLimits()))
    entries: tuple[frames.Entry, ...] = (
        frames.MemoryEntry(2.0, b"lost", 0, 2),  # its second part was dropped
        frames.MemoryEntry(2.5, b"late", 1, 2),  # its first part was dropped
        frames.MemoryEntry(2.0, b"kno", 0, 2),
        frames.MemoryEntry(2.0, b"wn", 1, 2),
        frames.DecisionEntry(2.0, "scan", "running", "", decision),
        frames.SentEntry(2.0, "vote/opinion", 3),
        frames.TextEntry(2.0, "/status", b'{"state":"idle"}'),
        frames.EventEntry(2.0, "a line"),
        frames.ClockEntry(2.0, "b", "00ff", 1.0, 2.0, 3.0),
        frames.DroppedEntry(2.0, 4),
    )
    inputs: tuple[Input, ...] = (
        ScanInput(scan),
        OdometryInput(Odometry(2.0, Pose(1.0), Twist(0.1))),
        NeighborsInput((Neighbor("b", 0.0, 1.0, None, 0.5), Neighbor("cc", 0.0))),
        PoseInput(SharedPose(2.0, Pose(1.0, 2.0, 0.5), 0.1, 0.02, "hall")),
        ReadingsInput({"battery": 0.5}),
        ReadingsInput({}),
        DriverInput(True, "Grüße"),
        HostInput(stepped),
        MessageInput("b", "vote/opinion", {"value": [1, None]}),
        CodeInput(),
        DuplicateInput("instance 1"),
        RosterInput("2", True),
    )
    kinds = {type(one) for one in entries} | {frames.Begin, frames.InputEntry}
    assert kinds == set(get_args(frames.Entry))
    for entry in (*(frames.input_entry(one, 2.0) for one in inputs), *entries):
        (copy,) = frames.decode_batch(frames.batch([frames.encode(entry)]))
        converter.add(copy)
    converter.writer.close()
    assert converter.writer.path is not None
    with converter.writer.path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = {c.topic: (s, d) for s, c, _, d in reader.iter_decoded_messages()}
    assert {topic: one.name for topic, (one, _) in found.items() if one} == {
        "/scan/geometry": "swarmd_msgs/msg/ScanGeometry",
        "/scan": "sensor_msgs/msg/LaserScan",
        "/odometry": "nav_msgs/msg/Odometry",
        "/neighbors": "swarmd_msgs/msg/Neighbors",
        "/pose": "swarmd_msgs/msg/SharedPose",
        "/readings": "swarmd_msgs/msg/Readings",
        "/driver": "swarmd_msgs/msg/DriverState",
        "/memory": "swarmd_msgs/msg/Bytes",
        "/input": "swarmd_msgs/msg/Input",
        "/code": "swarmd_msgs/msg/Text",
        "/duplicate": "swarmd_msgs/msg/Text",
        "/roster": "swarmd_msgs/msg/Text",
        "/command/requested": "swarmd_msgs/msg/Requested",
        "/decision": "swarmd_msgs/msg/Decision",
        "/message/received": "swarmd_msgs/msg/Text",
        "/message/sent": "swarmd_msgs/msg/Text",
        "/status": "swarmd_msgs/msg/Text",
        "/event": "rcl_interfaces/msg/Log",
        "/clock/pair": "swarmd_msgs/msg/ClockPair",
        "/dropped": "swarmd_msgs/msg/Text",
    }
    assert list(found["/scan"][1].ranges) == [np.float32(0.7), math.inf]
    assert found["/odometry"][1].twist.twist.linear.x == 0.1
    assert list(found["/odometry"][1].pose.covariance) == [0.0] * 36
    assert list(found["/neighbors"][1].robots) == ["b", "cc"]
    assert found["/driver"][1].text == "Grüße"
    told = found["/decision"][1]
    assert (told.safe.linear.x, told.scan_seq, list(told.caps)) == (0.1, 3, [0.3])
    assert told.avoiding == "avoiding an object at -30 deg"
    assert (found["/event"][1].level, found["/event"][1].msg) == (20, "a line")
    assert (found["/clock/pair"][1].peer_clock, found["/clock/pair"][1].returned) == ("00ff", 3.0)


def test_a_number_of_another_script_in_a_name_does_not_end_the_recorder(tmp_path: Path) -> None:
    (tmp_path / "tb3-01-\N{SUPERSCRIPT TWO}.mcap").touch()
    assert recorded(tmp_path, 1).name == "tb3-01-00001.mcap"
