"""What a real robot says can be recorded and played, whatever it says."""

from __future__ import annotations

import asyncio
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.values import Odometry, Pose, Scan, Twist
from swarmd.driver_api.driver import NullSink
from swarmd.driver_api.hw_codec import MAX_RAYS, encode_scan
from swarmd.driver_api.recording import Recorder, RecordingSink
from swarmd.drivers.replay import ReplayDriver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from tests.support import hand_clock as handclock

PLATFORM = load_platform("burger")
NOW = 1_767_225_600.25
"""A stamp of ROS: s since 1970."""


def scan(seq: int, rays: int = 360) -> Scan:
    spec, bearings = PLATFORM.scan, np.sin(np.arange(rays, dtype=np.float64))
    return Scan(seq, NOW + seq, np.full(rays, 1.5), bearings, spec.range_min, spec.range_max)


def odometry(x: float = 0.0, speed: float = 0.1) -> Odometry:
    return Odometry(NOW, Pose(x, 0.0, 0.5), Twist(speed))


class Counted(NullSink):
    """A sink that counts what it could not be given."""

    def __init__(self) -> None:
        self.left_out: list[str] = []

    def dropped(self, what: str) -> None:
        self.left_out.append(what)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a.rec"


def played(path: Path) -> CollectingSink:
    heard = CollectingSink()

    async def story() -> None:
        driver = ReplayDriver(swarm="s", robot="r", platform=PLATFORM, options={"file": str(path)})
        task = asyncio.create_task(driver.run(heard))
        while not heard.states or "has ended" not in heard.states[-1][1]:
            await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    handclock.run(story())
    return heard


def test_a_recording_with_wall_clock_stamps_and_map_coordinates_plays(path: Path) -> None:
    recorder = Recorder(path, {})
    sink = RecordingSink(NullSink(), recorder)
    sink.scan(scan(1))
    sink.odometry(odometry(x=5_400_000.0))  # as of UTM
    recorder.close()
    heard = played(path)
    assert [one.stamp for one in heard.scans] == [NOW + 1]
    assert heard.odometries == [odometry(x=5_400_000.0)]


def test_what_could_not_be_read_again_is_left_out_and_counted(path: Path) -> None:
    recorder, counted = Recorder(path, {}), Counted()
    sink = RecordingSink(counted, recorder)
    sink.scan(scan(1, rays=MAX_RAYS))
    sink.odometry(odometry(speed=1e30))
    sink.readings({"battery_voltage": 1e38})
    sink.scan(scan(2))
    sink.odometry(odometry())
    sink.readings({"battery_voltage": 12.0})
    recorder.close()
    assert counted.left_out == ["record/scan", "record/odometry", "record/readings"]
    heard = played(path)
    assert [one.seq for one in heard.scans] == [2]
    assert heard.odometries == [odometry()]
    assert heard.values == [{"battery_voltage": 12.0}]


def test_a_replay_that_is_behind_leaves_the_loop_to_others(path: Path) -> None:
    recorder = Recorder(path, {})
    for seq in range(100):
        recorder.add("scan", encode_scan(scan(seq)), 0.0)
    recorder.close()
    turns: list[int] = []
    before: list[int] = []

    class Busy(NullSink):
        def scan(self, scan: Scan) -> None:
            before.append(len(turns))
            asyncio.get_running_loop().call_soon(turns.append, scan.seq)

    async def story() -> None:
        options = {"file": str(path)}
        driver = ReplayDriver(swarm="s", robot="r", platform=PLATFORM, options=options)
        task = asyncio.create_task(driver.run(Busy()))
        while len(turns) < 100:
            await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    handclock.run(story())
    assert before[-1] > 50, "others have had their turns in between"
