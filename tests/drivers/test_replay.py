"""Inputs of a driver are recorded and replayed: in order, at their pace, and unchanged."""

from __future__ import annotations

import asyncio
import errno
import io
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, DriverError
from swarmd.core.messages import Reason
from swarmd.core.values import Array, Odometry, Pose, Scan, Twist, Value
from swarmd.daemon.driver_factory import make_driver
from swarmd.driver_api.driver import Driver, NullSink
from swarmd.driver_api.hw_codec import MAX_RAYS, decode_command, encode_odometry, encode_scan
from swarmd.driver_api.recording import (
    MAGIC,
    RecordedDriver,
    Recorder,
    RecordingSink,
    read_recording,
)
from swarmd.drivers.replay import ReplayDriver
from swarmd.settings.platforms import load_platform
from swarmd.settings.settings import load_daemon_settings
from swarmd.testing.driver_contract import CollectingSink, DriverContract, running_driver
from tests.support import hand_clock as handclock
from tests.support.wire import Good, Wire

PLATFORM = load_platform("burger")
SPEC = PLATFORM.scan
HEAD = {"robot": "r", "platform": "burger", "driver": "test"}


def scan(seq: int) -> Scan:
    """One scan with ages of its rays, one with those of sectors, one without, in turn."""
    ranges = np.linspace(0.5, 3.0, 360 + seq % 3).astype(np.float32).astype(np.float64)
    ranges[:3] = (np.inf, -np.inf, np.nan)
    rays = np.arange(len(ranges), dtype=np.float64)
    ages = (0.2 - 0.0005 * rays, (1.0 - rays // 90 / 4) / 4, None)[seq % 3]
    return Scan(seq, 0.2 * seq, ranges, 0.01 * rays, SPEC.range_min, SPEC.range_max, ages)


def odometry(seq: int) -> Odometry:
    return Odometry(0.2 * seq, Pose(0.1 * seq, 0.0, 0.5), Twist(0.1))


def record(path: Path, times: Sequence[float]) -> Path:
    """A recording with a scan and an odometry at each of these times, in s, without waiting."""
    recorder = Recorder(path, HEAD)
    for seq, time in enumerate(times):
        recorder.add("scan", encode_scan(scan(seq)), time)
        recorder.add("odometry", encode_odometry(odometry(seq)), time)
    recorder.close()
    return path


def make(path: Path, **options: Value) -> ReplayDriver:
    options = {"file": str(path), **options}
    return ReplayDriver(swarm="s", robot="r", platform=PLATFORM, options=options)


class Deck:
    """A recording that loops, for the contract: its base is silent between two rounds."""

    platform = PLATFORM

    def __init__(self, path: Path) -> None:
        self._path = record(path, [0.05 * i for i in range(16)])
        self._drivers: list[ReplayDriver] = []

    def make(self, options: Mapping[str, Value]) -> Driver:
        self._drivers.append(make(self._path, loop=True, **options))
        return self._drivers[-1]

    def publish(self) -> None:
        """The recording plays by itself."""

    def commands(self) -> Sequence[Twist]:
        taken = [twist for driver in self._drivers for twist in driver.taken]
        for driver in self._drivers:
            driver.taken.clear()
        return taken

    def close(self) -> None:
        """There is nothing to end."""


class TestContract(DriverContract):
    @pytest.fixture(autouse=True)
    def _folder(self, tmp_path: Path) -> None:
        self._tmp = tmp_path
        self._count = itertools.count()

    def rig(self) -> Deck:
        return Deck(self._tmp / f"{next(self._count)}.rec")

    def test_check_of_a_silent_base_names_the_remedy(self) -> None:
        empty = record(self._tmp / "empty.rec", [])
        findings = asyncio.run(make(empty).check(0.5))
        unwell = [finding for finding in findings if not finding.is_well]
        assert [finding.subject for finding in unwell] == ["scan", "odometry"]
        assert all("record a robot that has it" in finding.text for finding in unwell)


@pytest.mark.parametrize("name", ["", "~unknown-user/x.rec", "x\0.rec", "/"])
def test_an_impossible_file_is_refused_before_the_start(tmp_path: Path, name: str) -> None:
    for driver, option in (("replay", "file"), ("simulated", "record")):
        options: dict[str, Value] = {option: name}
        values: dict[str, Value] = {
            "id": "r",
            "driver": driver,
            "driver_options": options,
            "state_dir": str(tmp_path),
        }
        with pytest.raises(ConfigError, match=f"^driver {driver}: {option} is .*expected a file"):
            make_driver(load_daemon_settings(None, values))


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "taken").touch()
    for path in (tmp_path / f"{'x' * 255}.rec", tmp_path / "taken" / "x.rec"):
        with pytest.raises(DriverError, match=r"^record: .* cannot be written: "):
            Recorder(path, HEAD)


class Timed(CollectingSink):
    """A sink that also remembers when each scan came, in s since the base was found."""

    def __init__(self) -> None:
        super().__init__()
        self.times: list[float] = []
        self._up = 0.0

    def state(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        super().state(is_up, text, hold=hold, gets_zero=gets_zero)
        if is_up:
            self._up = asyncio.get_running_loop().time()

    def scan(self, scan: Scan) -> None:
        super().scan(scan)
        self.times.append(asyncio.get_running_loop().time() - self._up)


def played(path: Path, scans: int, **options: Value) -> Timed:
    """A sink that has received this many scans, at the end of a round."""
    replayed = Timed()

    async def story() -> None:
        task = asyncio.create_task(make(path, **options).run(replayed))
        while len(replayed.scans) < scans or "ended" not in replayed.states[-1][1]:
            await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    handclock.run(story())
    return replayed


def same(one: Scan, other: Scan) -> bool:
    return (one.seq, one.stamp, one.range_min, one.range_max) == (
        other.seq, other.stamp, other.range_min, other.range_max,
    ) and np.array_equal(one.ranges, other.ranges, equal_nan=True) and np.allclose(
        one.bearings, other.bearings, rtol=0.0, atol=1e-12
    ) and same_ages(one.ages, other.ages)  # fmt: skip


def same_ages(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.allclose(one, other, rtol=0.0, atol=1e-7)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_the_same_scans_in_order_and_at_their_pace(tmp_path: Path, speed: float) -> None:
    at = [0.0, 0.1, 0.4, 0.5, 1.0]
    replayed = played(record(tmp_path / "a.rec", at), 5, speed=speed)
    assert all(same(scan(i), one) for i, one in enumerate(replayed.scans))
    assert replayed.odometries == [odometry(i) for i in range(5)]
    assert replayed.order[:3] == ["lost", "up", "scan"]
    assert replayed.times == pytest.approx([time / speed for time in at])


def test_in_a_loop_stamps_and_sequences_continue(tmp_path: Path) -> None:
    replayed = played(record(tmp_path / "a.rec", [0.0, 0.1]), 4, loop=True)
    assert [one.seq for one in replayed.scans][:4] == [0, 1, 2, 3]
    stamps = [one.stamp for one in replayed.scans]
    assert stamps == sorted(set(stamps))
    assert [state for state, _ in replayed.states][:4] == [False, True, False, True]


def test_a_recording_holds_what_the_driver_delivered(tmp_path: Path) -> None:
    path, delivered = tmp_path / "body.rec", CollectingSink()

    class Body(Wire):
        def make(self, options: Mapping[str, Value]) -> Driver:
            return RecordedDriver(super().make(options), path, HEAD)

    async def run() -> None:
        async with running_driver(Body(Good)) as harness:
            await harness.until(lambda: len(harness.sink.scans) >= 8, publishing=True)
            harness.driver.send(Twist(0.1), 3, 2)
            harness.driver.send(Twist(0.2), 4, 3)
            await harness.end()
            delivered.scans, delivered.states = harness.sink.scans, harness.sink.states

    asyncio.run(run())
    recording = read_recording(path)
    assert (recording.header.robot, recording.cut) == ("r", "")
    commands = [decode_command(e.payload) for e in recording.entries if e.kind == "command"]
    assert [(c.linear, c.scan_seq, c.requested_scan_seq) for c in commands] == [
        (0.1, 3, 2),
        (0.2, 4, 3),
    ]
    replayed = played(path, len(delivered.scans))
    assert len(replayed.scans) == len(delivered.scans)
    assert all(same(one, other) for one, other in zip(delivered.scans, replayed.scans, strict=True))
    assert [is_up for is_up, _ in replayed.states] == [False, False, True, False]


def test_commands_are_taken_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")

    async def run() -> None:
        async with running_driver(Deck(tmp_path / "a.rec")) as harness:
            await harness.connect()
            for _ in range(3):
                harness.driver.send(Twist(0.1), 0, 0)

    asyncio.run(run())
    assert "took 4 commands, 2 to move" in caplog.text  # the first and the last are zero


def test_a_recording_that_is_cut_off_is_played_up_to_there(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = record(tmp_path / "a.rec", [0.0, 0.1, 0.2])
    data = whole.read_bytes()
    whole.write_bytes(data[:-40])
    replayed = played(whole, 3)
    assert (len(replayed.scans), len(replayed.odometries)) == (3, 2)
    (line,) = (r.getMessage() for r in caplog.records if r.levelname == "WARNING")
    assert f"cut off at byte {read_at(data)} of {len(data) - 40}, 0.2 s after it began" in line
    findings = asyncio.run(make(whole).check(1.0))
    assert "cut off at byte" in findings[0].text


def read_at(data: bytes) -> int:
    """Where the last frame of a whole recording begins."""
    at = last = len(MAGIC)
    while at < len(data):
        last, at = at, at + 4 + int.from_bytes(data[at : at + 4], "little")
    return last


@pytest.mark.parametrize(
    ("data", "fault"),
    [
        (b"", "not a recording; expected a file that option record wrote"),
        (b"PK\x03\x04 a trace of a world", "not a recording; expected"),
        (MAGIC, "cut off before its first frame; record it again"),
        (MAGIC + b"\x05\x00\x00\x00\x01", "cut off before its first frame"),
        (MAGIC + b"\xff\xff\xff\x7f" + b"x" * 9, "damaged at byte 19: a frame of 2147483647 byt"),
        (MAGIC + b"\x03\x00\x00\x00\x01zz", "damaged at byte 19: "),
    ],
)
def test_a_file_that_is_no_recording_is_one_clear_line(
    tmp_path: Path, data: bytes, fault: str
) -> None:
    path = tmp_path / "a.rec"
    path.write_bytes(data)
    with pytest.raises(ConfigError) as caught:
        make(path)
    assert str(caught.value).startswith(f"{path}: {fault}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("entries", "fault"),
    [
        ([(0.0, b"\x01 no scan")], "damaged 0.0 s after it began: "),
        ([(0.2, encode_scan(scan(1))), (0.1, encode_scan(scan(2)))], "times that go back"),
    ],
)
def test_damage_in_the_middle_is_found_before_it_begins(
    tmp_path: Path, entries: list[tuple[float, bytes]], fault: str
) -> None:
    recorder = Recorder(tmp_path / "a.rec", HEAD)
    for time, payload in entries:
        recorder.add("scan", payload, time)
    recorder.close()
    with pytest.raises(ConfigError, match=f"{fault}.*; record it again"):
        make(tmp_path / "a.rec")


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"speed": 0}, "driver replay: speed is 0; expected a number of at least 0.05"),
        ({"sped": 2.0}, "driver replay: no key 'sped'; did you mean 'speed'?"),
        ({"file": 1}, "driver replay: file is 1; expected text"),
        (
            {"file": "nowhere.rec"},
            "nowhere.rec: cannot be read: No such file or directory; expected",
        ),
    ],
)
def test_refuses_options(tmp_path: Path, options: Mapping[str, Value], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(record(tmp_path / "a.rec", [0.0]), **options)
    assert str(caught.value).startswith(fault)


def test_an_earlier_recording_is_kept(tmp_path: Path) -> None:
    first = record(tmp_path / "a.rec", [0.0]).read_bytes()
    record(tmp_path / "a.rec", [0.0, 0.1, 0.2])
    assert (tmp_path / "a.rec").read_bytes() == first
    assert len(read_recording(tmp_path / "a-2.rec").entries) == 6


def test_option_record_is_for_every_driver(tmp_path: Path) -> None:
    values: dict[str, object] = {
        "id": "r",
        "state_dir": str(tmp_path),
        "driver_options": {"record": str(tmp_path / "x.rec")},
    }
    assert isinstance(make_driver(load_daemon_settings(None, values)), RecordedDriver)


def test_a_disk_that_is_full_ends_the_recording_and_nothing_else(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    class Full(io.BytesIO):
        def write(self, data: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    recorder, full = Recorder(tmp_path / "a.rec", HEAD), Full()
    recorder.close()
    recorder._file = full
    for time in (0.0, 0.1):
        recorder.add("scan", encode_scan(scan(1)), time)
    assert full.closed
    assert "ends here: No space left on device" in caplog.text
    assert caplog.text.count("ends here") == 1


NOW = 1_767_225_600.25
"""A stamp of ROS: s since 1970."""


def real_scan(seq: int, rays: int = 360) -> Scan:
    bearings = np.sin(np.arange(rays, dtype=np.float64))
    return Scan(seq, NOW + seq, np.full(rays, 1.5), bearings, SPEC.range_min, SPEC.range_max)


def real_odometry(x: float = 0.0, speed: float = 0.1) -> Odometry:
    return Odometry(NOW, Pose(x, 0.0, 0.5), Twist(speed))


def test_a_recording_with_wall_clock_stamps_and_map_coordinates_plays(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.rec", {})
    sink = RecordingSink(NullSink(), recorder)
    sink.scan(real_scan(1))
    sink.odometry(real_odometry(x=5_400_000.0))  # in UTM
    recorder.close()
    replayed = played(tmp_path / "a.rec", 1)
    assert [one.stamp for one in replayed.scans] == [NOW + 1]
    assert replayed.odometries == [real_odometry(x=5_400_000.0)]


def test_values_that_cannot_be_decoded_are_left_out_and_counted(tmp_path: Path) -> None:
    recorder, counted = Recorder(tmp_path / "a.rec", {}), CollectingSink()
    sink = RecordingSink(counted, recorder)
    sink.scan(real_scan(1, rays=MAX_RAYS))
    sink.odometry(real_odometry(speed=1e30))
    sink.readings({"battery_voltage": 1e38})
    sink.scan(real_scan(2))
    sink.odometry(real_odometry())
    sink.readings({"battery_voltage": 12.0})
    recorder.close()
    assert counted.lost == ["record/scan", "record/odometry", "record/readings"]
    replayed = played(tmp_path / "a.rec", 1)
    assert [one.seq for one in replayed.scans] == [2]
    assert replayed.odometries == [real_odometry()]
    assert replayed.values == [{"battery_voltage": 12.0}]


def test_a_replay_that_is_behind_leaves_the_loop_to_others(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "a.rec", {})
    for seq in range(100):
        recorder.add("scan", encode_scan(real_scan(seq)), 0.0)
    recorder.close()
    turns: list[int] = []
    before: list[int] = []

    class Busy(NullSink):
        def scan(self, scan: Scan) -> None:
            before.append(len(turns))
            asyncio.get_running_loop().call_soon(turns.append, scan.seq)

    async def story() -> None:
        task = asyncio.create_task(make(tmp_path / "a.rec").run(Busy()))
        while len(turns) < 100:
            await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    handclock.run(story())
    assert before[-1] > 50, "other tasks ran in between"


def test_a_recorded_driver_is_told_that_its_robot_must_stand(tmp_path: Path) -> None:
    marks: list[bool] = []

    class Marked:
        is_simulated = True

        def send(self, *command: object, is_stopped: bool = False) -> None:
            marks.append(is_stopped)

    driver = RecordedDriver(cast("Driver", Marked()), tmp_path / "r.rec", HEAD)
    driver.send(Twist(), 1, 1, is_stopped=True)
    driver.send(Twist(), 1, 1)
    assert marks == [True, False]


def test_a_recorded_state_is_passed_on_whole(tmp_path: Path) -> None:
    sink = CollectingSink()
    recorder = Recorder(tmp_path / "r.rec", HEAD)
    RecordingSink(sink, recorder).state(
        False, "someone else drives", hold=Reason.SCAN_CONFLICT, gets_zero=True
    )
    recorder.close()
    assert (sink.states, sink.hold, sink.gets_zero) == (
        [(False, "someone else drives")],
        Reason.SCAN_CONFLICT,
        True,
    )
