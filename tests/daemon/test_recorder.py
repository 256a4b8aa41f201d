"""The recorder: a process of its own that writes what a daemon hands it, and never delays it."""

from __future__ import annotations

import asyncio
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.events import MessageInput, OdometryInput, ScanInput
from swarmd.core.messages import Code, LimitingObstacle, Reply
from swarmd.core.refusal import Refusal
from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.core.verbs import Nothing, RecordingsReply, RecordRequest
from swarmd.daemon.recorder import Recorder
from swarmd.daemon.recording import frames, messages, process
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.daemon.recording.ring import Ring
from swarmd.daemon.recording_service import RecordingService
from swarmd.robot.protection.decision import Decision
from swarmd.robot.setup import RobotIdentity, RobotSetup
from swarmd.settings.file_limits import FileLimits
from swarmd.settings.platforms import load_platform
from swarmd.settings.swarmfile import RecordingSection
from tests.support.recorded_stories import Story

pytestmark = pytest.mark.integration

WAIT = 60.0
BEARINGS = np.linspace(-3.0, 3.0, 180)


def scan(seq: int) -> Scan:
    ranges = np.full(180, math.inf)
    ranges[seq % 180] = np.float32(0.5)
    return Scan(seq, 0.1 * seq, ranges, BEARINGS, 0.12, 3.5)


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(WAIT):
        while not condition():
            await asyncio.sleep(0.01)


def files_in(folder: Path) -> list[RecordedFile]:
    return [read_file(path) for path in sorted(folder.glob("*.mcap"))]


def test_each_entry_is_in_the_file_with_its_time_and_order(tmp_path: Path) -> None:
    events: list[str] = []

    async def run() -> None:
        recorder = Recorder(asyncio.get_running_loop(), events.append)
        recorder.start(tmp_path, "tb3-01", {"robot": "tb3-01"}, FileLimits())
        for seq in range(50):
            recorder.input(ScanInput(scan(seq)), 0.0)
            reading = Odometry(0.1 * seq, Pose(seq, 0.0, 0.0), Twist(0.1))
            recorder.input(OdometryInput(reading), 0.0)
            row = LimitingObstacle(0.1, 0.2, 0.3)
            decision = Decision(
                "barrier", Twist(0.2), Twist(0.1), None, True, (row,), 0.2, 0.01, seq
            )
            recorder.add(frames.DecisionEntry(0.1 * seq, "scan", "running", "", decision))
            recorder.process.flush()
        recorder.add(frames.EventEntry(5.0, "a line"))
        recorder.input(MessageInput("tb3-02", "vote/opinion", {"value": [1, None]}), 5.0)
        recorder.process.close(WAIT)

    asyncio.run(run())
    assert events == []
    (found,) = files_in(tmp_path)
    assert found.fault == ""
    assert found.about["robot"] == "tb3-01"
    by_topic: dict[str, list[object]] = {}
    for one in found.messages:
        by_topic.setdefault(one.topic, []).append(messages.deserialize(one.kind, one.payload))
    assert {topic: len(each) for topic, each in by_topic.items()} == {
        "/input": 101,
        "/scan/geometry": 1,
        "/scan": 50,
        "/odometry": 50,
        "/decision": 50,
        "/event": 1,
        "/message/received": 1,
    }
    (geometry,) = by_topic["/scan/geometry"]
    for seq, message in enumerate(by_topic["/scan"]):
        back = messages.scan_of(message, seq, geometry)
        assert back.ranges.tobytes() == scan(seq).ranges.tobytes()
        assert back.bearings.tobytes() == BEARINGS.tobytes()
    decision = by_topic["/decision"][7]
    assert (decision.scan_seq, decision.cause, list(decision.gaps)) == (7, "scan", [0.2])  # type: ignore[attr-defined]
    assert by_topic["/message/received"][0].json == (  # type: ignore[attr-defined]
        '{"sender":"tb3-02","channel":"vote/opinion","value":{"value":[1,null]}}'
    )


def test_a_frozen_recorder_process_drops_entries_and_delays_nothing(tmp_path: Path) -> None:
    events: list[str] = []

    async def run() -> tuple[int, float]:
        recorder = Recorder(asyncio.get_running_loop(), events.append)
        recorder.start(tmp_path, "a", {}, FileLimits())
        recorder.input(OdometryInput(Odometry(0.0, Pose(), Twist())), boottime())
        recorder.process.flush()
        await until(lambda: recorder.process.report.path)
        assert recorder.process._open is not None
        process = recorder.process._open.process
        process.send_signal(signal.SIGSTOP)
        longest = 0.0
        seq = 0
        while recorder.process.dropped == 0:
            begin = time.thread_time()
            turned = replace(scan(seq), bearings=BEARINGS + 1e-9 * seq)
            recorder.input(ScanInput(turned), boottime())
            recorder.process.flush()
            longest = max(longest, time.thread_time() - begin)
            seq += 1
        dropped = recorder.process.dropped
        process.send_signal(signal.SIGCONT)
        await until(lambda: recorder.process.report.bytes > 10_000)
        recorder.input(ScanInput(scan(seq)), boottime())
        recorder.process.close(WAIT)
        return dropped, longest

    dropped, _ = asyncio.run(run())
    assert dropped >= 1
    assert events[0] == f"recording: {dropped} entries dropped: the disk is slow"
    (found,) = files_in(tmp_path)
    (gap,) = [one for one in found.messages if one.topic == "/dropped"]
    assert json.loads(messages.deserialize(gap.kind, gap.payload).json) == {"count": dropped}
    index = json.loads(found.path.with_suffix(".index.json").read_text())
    assert index["dropped"] == dropped
    scans = [one for one in found.messages if one.topic == "/scan"]
    last = [one for one in found.messages if one.topic == "/scan/geometry"][-1]
    geometry = messages.deserialize(last.kind, last.payload)
    assert geometry.bearings.tobytes() == BEARINGS.tobytes()
    assert found.messages.index(scans[-1]) == found.messages.index(last) + 2  # and its input


def test_a_fault_after_a_stop_ends_the_process_with_an_error(tmp_path: Path) -> None:
    """The daemon has closed its end, and reads no report."""
    (tmp_path / "folder").write_text("a file")
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    begin = frames.Begin(1.0, str(tmp_path / "folder"), "a", {}, 1.7e9, FileLimits())
    event = frames.EventEntry(1.0, "a line")
    with theirs:
        ours.send(frames.batch([frames.encode(begin), frames.encode(event)]))
        ours.close()
        with pytest.raises(FileExistsError):
            process.run(theirs)


def test_a_recorder_process_that_is_killed_is_reported_once(tmp_path: Path) -> None:
    events: list[str] = []

    async def run() -> None:
        recorder = Recorder(asyncio.get_running_loop(), events.append)
        recorder.start(tmp_path, "a", {}, FileLimits())
        assert recorder.process._open is not None
        recorder.process._open.process.kill()
        await until(lambda: events)
        assert not recorder.is_on
        recorder.input(ScanInput(scan(1)), 0.0)
        recorder.process.flush()
        recorder.start(tmp_path, "a", {}, FileLimits())
        recorder.input(ScanInput(scan(2)), 0.0)
        recorder.process.close(WAIT)

    asyncio.run(run())
    assert events == ["recording ends: its process was killed by SIGKILL"]
    found = [one for one in files_in(tmp_path) if one.messages]
    assert [m.topic for m in found[-1].messages] == ["/scan/geometry", "/input", "/scan"]


def test_the_file_of_a_daemon_that_died_with_a_report_unread_is_whole(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    begin = frames.Begin(1.0, str(tmp_path), "a", {"robot": "a"}, 1.7e9, FileLimits())
    with theirs:
        ours.send(frames.batch([frames.encode(begin)]))
        writing = threading.Thread(target=process.run, args=(theirs,))
        writing.start()
        ours.recv(1, socket.MSG_PEEK)  # a report has come
        ours.send(frames.batch([frames.encode(frames.EventEntry(1.0, "the last line"))]))
        ours.close()
        writing.join(WAIT)
    (found,) = files_in(tmp_path)
    assert (found.fault, [one.topic for one in found.messages]) == ("", ["/event"])


def test_a_file_that_cannot_be_finished_after_a_stop_is_an_event(tmp_path: Path) -> None:
    events: list[str] = []

    async def run() -> None:
        recorder = Recorder(asyncio.get_running_loop(), events.append)
        recorder.start(tmp_path / "folder", "a", {}, FileLimits())
        recorder.add(frames.EventEntry(0.0, "a line"))
        recorder.process.flush()
        await until(lambda: list((tmp_path / "folder").glob("*.mcap")))
        shutil.rmtree(tmp_path / "folder")
        recorder.process.stop()
        await until(lambda: events)

    asyncio.run(run())
    assert events == ["recording ends: its file is not whole: its process ended with code 1"]


def test_the_daemon_and_fetch_do_without_the_libraries_of_recordings() -> None:
    code = (
        "import sys\n"
        "for name in ('mcap', 'rosbags', 'zstandard'): sys.modules[name] = None\n"
        "import swarmd.daemon.daemon, swarmd.daemon.recording.fetch\n"
        "import swarmd.operator.verbs.record.command\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_folder_that_cannot_be_written_is_an_event_and_stands_in_the_list(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("")
    events: list[str] = []

    async def run() -> RecordingsReply:
        section = RecordingSection(from_start=True, folder=str(tmp_path / "file" / "folder"))
        service = RecordingService("a", section, head, events.append)
        service.start_if_wanted()
        service.recorder.input(ScanInput(scan(1)), 0.0)
        service.recorder.process.flush()
        await until(lambda: events)
        service.close()
        return service.on_recordings(Nothing())()

    listed = asyncio.run(run())
    assert events == ["recording ends: no file: Not a directory"]
    assert (listed.files, listed.fault) == ((), "no file: Not a directory")


def test_a_start_is_not_applied_where_no_file_can_be_made(tmp_path: Path) -> None:
    """As on a disk without room or inodes."""
    (tmp_path / "file").write_text("")

    async def run() -> list[Reply]:
        replies: list[Reply] = []
        section = RecordingSection(folder=str(tmp_path / "file" / "folder"))
        service = RecordingService("a", section, head, lambda _: None)
        request = RecordRequest(id="r", operator="o", targets={"a": None}, action="start")
        service.on_record(request, lambda reply, **_: replies.append(reply))
        await until(lambda: replies)
        assert not service.recorder.is_on
        service.close()
        return replies

    (reply,) = asyncio.run(run())
    assert (reply.code, reply.refusal) == (Code.FAILED, Refusal.INVALID_REQUEST)
    assert str(tmp_path / "file" / "folder") in reply.text


def head() -> RecordingHead:
    return RecordingHead(
        swarm="s",
        clock="00ff",
        machine="",
        identity=RobotIdentity(
            robot="a",
            platform=load_platform("burger"),
            setup=RobotSetup(driver="d"),
            seed=1,
            instance="i",
        ),
    )


FULL = """
import asyncio, sys, time
from pathlib import Path
from tests.daemon.test_recorder import *
async def run():
    events = []
    recorder = Recorder(asyncio.get_running_loop(), events.append)
    recorder.start(Path(sys.argv[1]), "a", {}, FileLimits(file_bytes=100_000))
    recorder.add(frames.EventEntry(0.0, "a line"))
    recorder.process.flush()
    await until(lambda: recorder.process.report.path)  # else this loop takes its CPU as it starts
    rng = np.random.default_rng(1)
    ends = time.monotonic() + WAIT
    seq = 0
    while time.monotonic() < ends:
        seq += 1
        recorder.input(ScanInput(replace(scan(seq), ranges=rng.uniform(0.2, 3.0, 180))), 0.0)
        recorder.process.flush()
        await asyncio.sleep(0.001)  # for the process that writes, which else drops most entries
        if events and not recorder.is_on:
            break
    recorder.process.close(WAIT)
    print(*events, sep="\\n")
    files = files_in(Path(sys.argv[1]))
    print(sum(len(one.messages) for one in files) > 500)
asyncio.run(run())
"""


@pytest.mark.timeout(5.0 * WAIT)
@pytest.mark.skipif(os.getuid() != 0 or not shutil.which("unshare"), reason="needs root, unshare")
def test_a_full_disk_ends_the_recording_and_keeps_what_was_written(tmp_path: Path) -> None:
    script = tmp_path / "full.py"
    script.write_text(FULL)
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = (
        f"mount -t tmpfs -o size=600k swarmd-test {disk} && exec {sys.executable} {script} {disk}"
    )
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", mount],
        capture_output=True,
        text=True,
        timeout=4.0 * WAIT,  # to start, for the first report, to fill the disk, and to end
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    *events, has_kept = done.stdout.splitlines()
    assert done.returncode == 0, done.stderr
    assert events[-1].startswith("recording ends: ")
    assert events[-1].endswith(": No space left on device")
    assert has_kept == "True"


def test_a_segment_of_the_ring_has_the_wall_clock_of_its_begin(tmp_path: Path) -> None:
    story = Story(tmp_path)
    with closing(asyncio.new_event_loop()) as loop:
        recorder = Recorder(loop, print)
    recorder.black_box.ring = Ring(
        tmp_path / "r", {}, capacity=1 << 20, seconds=60.0, boot=1.0, wall=2.0
    )
    before = time.time() - boottime()  # set by NTP after the start of the daemon
    recorder.remember(story.robot.robot, 5.0, 1.0)
    left = recorder.black_box.ring.left()
    recorder.black_box.ring.close()
    assert left.frames
    assert left.wall - left.boot == pytest.approx(before, abs=60.0)
