"""Recordings of a swarm: started, stopped, listed and fetched by swarmctl from living daemons."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from swarmd.core.clock import boottime
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.testing.driver_contract import is_running
from tests.support.processes import children, wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def topics(found: RecordedFile) -> dict[str, int]:
    counts: dict[str, int] = {}
    for one in found.messages:
        counts[one.topic] = counts.get(one.topic, 0) + 1
    return counts


def test_a_run_is_recorded_listed_and_fetched(swarm: Swarm, tmp_path: Path) -> None:
    body = swarm.body("tb3-01")
    swarm.start("tb3-01", body)
    nothing = swarm.ctl("record", "fetch", "--all", "-d", str(tmp_path / "none"))
    assert (nothing.code, nothing.out) == (4, "")
    assert "tb3-01" in nothing.err
    assert swarm.ctl("record", "fetch", "--all", "-o", "json").json["exit_code"] == 4
    started = swarm.ctl("record", "start", "--all")
    assert started.outcome == (0, "1 targeted, 1 applied"), started.err
    assert "records to" in started.out
    assert "records already" in swarm.ctl("record", "start", "--all").out

    swarm.run_drive("tb3-01")
    body.wait_moving()
    folder = swarm.folder / "state" / swarm.name / "tb3-01" / "recordings"
    wait_until(
        lambda: any("/scan" in topics(read_file(one)) for one in folder.glob("*.mcap")),
        "scans on the disk",
    )
    listed = swarm.ctl("record", "list", "-o", "json").json["robots"]["tb3-01"]
    assert [one["is_open"] for one in listed] == [True]

    here = tmp_path / "here"
    first = swarm.ctl("record", "fetch", "--all", "-d", str(here))
    assert first.code == 0
    assert "so far" in first.out
    partial = here / "tb3-01" / "tb3-01-00001.mcap.partial"
    assert topics(read_file(partial))["/scan"] > 0

    swarm.ctl("stop", "--all")
    assert swarm.ctl("record", "stop", "--all").code == 0
    wait_until(lambda: bool(list(folder.glob("*.index.json"))), "finished")
    second = swarm.ctl("record", "fetch", "--all", "-d", str(here))
    assert "whole" in second.out
    assert not partial.exists()
    copy = here / "tb3-01" / "tb3-01-00001.mcap"
    assert copy.read_bytes() == (folder / copy.name).read_bytes()

    found = read_file(copy)
    assert found.fault == ""
    assert found.about["robot"] == "tb3-01"
    counts = topics(found)
    assert {
        "/scan",
        "/odometry",
        "/decision",
        "/command/requested",
        "/request",
        "/status",
    } <= counts.keys()
    decisions = [
        messages.deserialize(one.kind, one.payload)
        for one in found.messages
        if one.topic == "/decision"
    ]
    assert {one.state for one in decisions} >= {"idle", "running", "stopped"}
    assert max(one.safe.linear.x for one in decisions) > 0.0
    texts = [one for one in found.messages if one.topic == "/request"]
    requests = [json.loads(messages.deserialize(one.kind, one.payload).json) for one in texts]
    assert list({one["id"]: one["verb"] for one in requests}.values()) == ["run", "stop"]
    listed = swarm.ctl("record", "list", "--all", "-o", "json").json["robots"]["tb3-01"]
    assert [one["is_open"] for one in listed] == [False]
    assert listed[0]["end"] > listed[0]["begin"]


def test_no_recorder_outlives_a_daemon_that_is_killed(swarm: Swarm) -> None:
    daemon = swarm.start("tb3-01", options={"recording": {"from_start": True}})
    status = swarm.await_status("tb3-01", "recording", lambda status: bool(status.recording))
    assert status.recording is not None
    folder = swarm.folder / "state" / swarm.name / "tb3-01" / "recordings"
    found: list[int] = []

    def has_recorder() -> bool:
        found[:] = (pid for pid in children(daemon.process.pid) if is_recorder(pid))
        return len(found) == 1

    wait_until(has_recorder, "the recorder is there")
    (recorder,) = found
    daemon.kill()
    wait_until(lambda: not is_running(recorder), "the recorder has ended")
    (path,) = folder.glob("*.mcap")
    assert read_file(path).fault == "", "it finished its file"
    assert path.with_suffix(".index.json").exists()


def is_recorder(pid: int) -> bool:
    with contextlib.suppress(OSError):  # another child has ended meanwhile
        return b"swarmd.daemon.recording.process" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False


def test_robots_without_an_answer_are_named(swarm: Swarm, tmp_path: Path) -> None:
    swarm.start("tb3-01")
    lost = swarm.start("tb3-02")
    lost.freeze()
    fetched = swarm.ctl(
        "record", "fetch", "tb3-01", "tb3-02", "--timeout", "4s", "-d", str(tmp_path)
    )
    assert fetched.code == 3
    assert "tb3-02 does not answer" in fetched.err
    lost.thaw()


@pytest.mark.smoke
def test_a_replay_repeats_the_commands_of_pattern_and_protection(swarm: Swarm) -> None:
    body = swarm.body("tb3-01")
    swarm.start("tb3-01", body)
    for pattern in ("drive", "random_walk"):
        assert swarm.ctl("run", pattern, "--all").code == 0
        first = body.wait_stepped(boottime())
        body.wait(lambda one: one.requested_scan_seq > first.requested_scan_seq + 10)  # noqa: B023
        swarm.ctl("stop", "--all")
        swarm.ctl("record", "start", "--all")  # after the robot has learned from a run
    assert swarm.ctl("record", "stop", "--all").code == 0
    folder = swarm.folder / "state" / swarm.name / "tb3-01" / "recordings"
    wait_until(lambda: bool(list(folder.glob("*.index.json"))), "finished")

    same = swarm.ctl("replay", str(folder), "-o", "json")
    assert same.code == 0, same.out + same.err
    (robot,) = same.json["robots"]
    assert robot["safe"]["count"] > 20
    assert robot["safe"]["largest"] == 0.0
    assert robot["requested"]["count"] > 2
    assert robot["requested"]["largest"] == 0.0
    assert robot["notes"] == []
    assert same.json["first_difference"] is None

    other = swarm.ctl("replay", str(folder), "--platform", "burger", "-o", "json")
    assert other.code == 1
    assert other.json["robots"][0]["safe"]["first"] is not None
