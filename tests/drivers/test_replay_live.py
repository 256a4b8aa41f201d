"""A daemon is recorded while it drives a body; another daemon runs on the recording alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.values import Value
from swarmd.core.verbs import RecordRequest
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.reader import read_file
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.settings import load_platform
from tests.support.drive_daemon import ROBOT, drive, is_running
from tests.support.fake_body import Body
from tests.support.processes import DaemonProcess, unique_swarm, wait_until
from tests.support.swarmctl import await_applied

pytestmark = pytest.mark.integration


def test_the_recording_of_a_daemon_drives_another(tmp_path: Path) -> None:
    swarm, folder = unique_swarm(), tmp_path / "recordings"
    platform = load_platform("waffle_pi")
    with Body(platform, swarm=swarm, robot=ROBOT) as body:
        recording: dict[str, Value] = {"from_start": True, "folder": str(folder)}
        with (
            DaemonProcess(
                tmp_path / "first",
                swarm=swarm,
                robot=ROBOT,
                endpoint=body.endpoint,
                options={"recording": recording},
            ) as daemon,
            Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
        ):
            daemon.wait_ready()
            drive(operator)
            moving = body.wait_stepped()
            body.wait(lambda one: one.at > moving.at + 2.0)
            await_applied(
                lambda: operator.request(
                    RecordRequest, operator.members().epochs((ROBOT,)), action="stop"
                ),
                "the recording ends",
            )
            wait_until(lambda: any(folder.glob("*.mcap")), "the writer has begun the file")
            (file,) = folder.glob("*.mcap")
            wait_until(lambda: not read_file(file).fault, "the file has its summary")
            assert daemon.terminate() == 0
    recorded = read_file(file)
    assert recorded.about["robot"] == ROBOT
    decisions = [
        messages.deserialize(one.kind, one.payload)
        for one in recorded.messages
        if one.topic == "/decision"
    ]
    assert any(one.safe.linear.x > 0.0 for one in decisions)

    replay: dict[str, Value] = {"file": str(file), "loop": True}
    with (
        DaemonProcess(
            tmp_path / "second",
            swarm=swarm,
            robot=ROBOT,
            endpoint="",
            options={"driver": "replay", "driver_options": replay},
        ) as daemon,
        Operator(NetworkSettings(swarm=swarm), name="zoe@test") as operator,
    ):
        daemon.wait_ready()
        drive(operator)
        wait_until(lambda: is_running(operator), "it runs on recorded scans")
        assert daemon.terminate() == 0
        assert "took " in daemon.text()
