"""Inputs of a driver are recorded and replayed: in order, at their pace, and unchanged."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest
from mcap.writer import Writer
from msgspec.structs import astuple

from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    DetectionsInput,
    DriverInput,
    HazardsInput,
    Input,
    NeighborsInput,
    OdometryInput,
    PoseInput,
    RangesInput,
    ReadingsInput,
    ScanInput,
    SensorInput,
    tag_of,
)
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.messages import Reason
from swarmd.core.values import (
    Array,
    Detection,
    Neighbor,
    Odometry,
    Pose,
    Scan,
    SharedPose,
    Twist,
    Value,
)
from swarmd.daemon.recording import messages
from swarmd.daemon.recording.frames import Begin, InputEntry, input_entry, without_geometry
from swarmd.daemon.recording.head import head_of
from swarmd.daemon.recording.process import Converter
from swarmd.daemon.recording.reader import read_file
from swarmd.driver_api.driver import Driver, NullSink
from swarmd.drivers.replay import ReplayDriver
from swarmd.settings.file_limits import FileLimits
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink, DriverContract, running_driver
from tests.support import hand_clock as handclock
from tests.support.range_ring import ring_scan

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


def record(
    folder: Path,
    times: Sequence[float],
    *,
    lost_at: float | None = None,
    more: Sequence[SensorInput] = (),
) -> Path:
    """A recording with a scan, an odometry and `more` at each of these times, in s."""
    converter = Converter(Begin(0.0, str(folder), "a", HEAD, 1e9, FileLimits()))

    def add(input: Input, at: float) -> None:
        converter.add(input_entry(input, at))

    if not times:
        add(DriverInput(True, ""), 0.0)
    for seq, time in enumerate(times):
        add(ScanInput(scan(seq)), time)
        if lost_at is not None and seq == 1:
            add(DriverInput(False, "unplugged"), lost_at)
        add(OdometryInput(odometry(seq)), time)
        for input in more:
            add(input, time)
    converter.writer.close()
    assert converter.writer.path is not None
    return converter.writer.path


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


@pytest.mark.long
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


def test_the_scans_of_a_ring_are_played_apart_from_those_of_the_lidar(tmp_path: Path) -> None:
    converter = Converter(Begin(0.0, str(tmp_path), "a", HEAD, 1e9, FileLimits()))
    for seq in range(3):
        near = ring_scan(seq, 0.2 * seq, {0.0: 0.25, 30.0: 0.5 + 0.125 * seq})
        for taken in (ScanInput(scan(3 * seq)), RangesInput(near), OdometryInput(odometry(seq))):
            converter.add(input_entry(taken, 0.05 * seq))
    converter.writer.close()
    assert converter.writer.path is not None
    found = played(converter.writer.path, 3)
    assert [len(one.ranges) for one in found.scans] == [360] * 3
    assert [one.seq for one in found.rings] == [0, 1, 2]
    for seq, one in enumerate(found.rings):
        wanted = ring_scan(seq, 0.2 * seq, {0.0: 0.25, 30.0: 0.5 + 0.125 * seq})
        assert one.ranges.tolist() == wanted.ranges.tolist()
        assert one.bearings.tolist() == wanted.bearings.tolist()
        assert one.stamp == pytest.approx(wanted.stamp)
        assert (one.range_min, one.range_max) == (wanted.range_min, wanted.range_max)
    (line,) = [
        finding
        for finding in asyncio.run(make(converter.writer.path).check(1.0))
        if finding.subject == "ranges"
    ]
    assert line.is_well
    assert line.text.startswith("3 at")


@pytest.mark.parametrize("name", ["", "~unknown-user/x.rec", "x\0.rec", "/"])
def test_an_impossible_file_is_refused_before_the_start(name: str) -> None:
    with pytest.raises(ConfigError, match=r"^driver replay: file is .*expected a recording"):
        make(Path("x"), file=name)


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

    def take(self, input: SensorInput) -> None:
        super().take(input)
        if isinstance(input, ScanInput):
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
    replayed = played(record(tmp_path / "a", at), 5, speed=speed)
    assert all(same(scan(i), one) for i, one in enumerate(replayed.scans))
    assert replayed.odometries == [odometry(i) for i in range(5)]
    assert replayed.order[:3] == ["lost", "up", "scan"]
    assert replayed.times == pytest.approx([time / speed for time in at])


def test_in_a_loop_stamps_and_sequences_continue(tmp_path: Path) -> None:
    pose = PoseInput(SharedPose(400.0, Pose(0.0, 0.0, 0.0), 0.1, 0.1, "map"))
    replayed = played(record(tmp_path / "a", [0.0, 0.1], more=[pose]), 4, loop=True)
    assert [one.seq for one in replayed.scans][:4] == [0, 1, 2, 3]
    stamps = [one.stamp for one in replayed.scans]
    assert stamps == sorted(set(stamps))
    first, again, later, *_ = (shared.stamp for shared in replayed.taken["pose"])
    assert first == again < later, "a pose of a later round is newer"
    assert [state for state, _ in replayed.states][:4] == [False, True, False, True]


def test_commands_are_taken_and_counted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")

    async def run() -> None:
        async with running_driver(Deck(tmp_path / "a")) as harness:
            await harness.connect()
            for _ in range(3):
                harness.driver.send(Twist(0.1), 0, 0)

    asyncio.run(run())
    assert "took 4 commands, 2 to move" in caplog.text  # the first and the last are zero


def test_a_recording_that_is_cut_off_is_played_up_to_there(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = record(tmp_path / "a", [0.0, 0.1, 2.2, 2.3])
    data = whole.read_bytes()
    whole.write_bytes(data[: len(data) // 2])
    replayed = played(whole, 2)
    assert len(replayed.scans) == 2  # of the chunk that was written when it was 2 s old
    (line,) = (r.getMessage() for r in caplog.records if r.levelname == "WARNING")
    assert "cut off at byte" in line
    assert "cut off at byte" in asyncio.run(make(whole).check(1.0))[0].text


def test_scans_whose_exact_directions_are_damaged_have_rounded_ones(tmp_path: Path) -> None:
    converter = Converter(Begin(0.0, str(tmp_path), "a", HEAD, 1e9, FileLimits()))
    for turn in range(4):
        seen = scan(3 * turn)
        taken = ScanInput(without_geometry(seen) if turn else seen)
        converter.add(input_entry(taken, 2.2 * turn))
    converter.writer.close()
    whole = converter.writer.path
    assert whole is not None
    data = bytearray(whole.read_bytes())
    data[len(data) // 8] ^= 0xFF  # in the first chunk, which has the directions
    whole.write_bytes(data)
    replayed = played(whole, 1)
    assert "damaged" in asyncio.run(make(whole).check(1.0))[0].text
    assert [one.seq for one in replayed.scans] == [3, 6, 9]
    assert all(np.allclose(one.bearings, scan(0).bearings, atol=1e-4) for one in replayed.scans)


@pytest.mark.parametrize("space", ["", "/tb3_01"])
def test_a_recording_of_ros_is_played(tmp_path: Path, space: str) -> None:
    """Scans and odometry as rosbag2 leaves them: without numbers, and without texts of swarmd."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="libmcap 1.3.0")
        topics = {messages.LASER_SCAN: f"{space}/scan", messages.ODOMETRY: f"{space}/odom"}
        channels = {
            kind: writer.register_channel(
                topic, "cdr", writer.register_schema(kind, "ros2msg", messages.definition(kind))
            )
            for kind, topic in topics.items()
        }
        for seq in range(3):
            for kind, payload in (
                messages.scan_message(scan(seq)),
                messages.odometry_message(odometry(seq)),
            ):
                writer.add_message(channels[kind], 200_000_000 * seq, payload, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    replayed = played(path, 3)
    assert [one.stamp for one in replayed.scans] == pytest.approx([0.0, 0.2, 0.4])
    assert all(
        np.array_equal(one.ranges, scan(i).ranges, equal_nan=True)
        for i, one in enumerate(replayed.scans)
    )
    numbers = [one.seq for one in replayed.scans]
    assert numbers == sorted(set(numbers))
    assert [one.pose.x for one in replayed.odometries] == pytest.approx([0.0, 0.1, 0.2])
    assert all(finding.is_well for finding in asyncio.run(make(path).check(1.0)))
    about = read_file(path).about
    with pytest.raises(ConfigError, match="not a recording of swarmd"):
        head_of(about, str(path))


def test_a_file_without_inputs_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for data, fault in ((b"", "no inputs"), (b"PK\x03\x04", "not a recording; expected")):
        path.write_bytes(data)
        with pytest.raises(ConfigError, match=fault) as caught:
            make(path)
        assert str(caught.value).startswith(f"{path}: ")
        assert "\n" not in str(caught.value)


def test_the_base_is_lost_and_back_as_recorded(tmp_path: Path) -> None:
    replayed = played(record(tmp_path / "a", [0.0, 0.1, 0.2], lost_at=0.15), 2)
    assert replayed.states[1:3] == [
        (True, f"plays {next(tmp_path.glob('a/*.mcap'))}"), (False, "as recorded: unplugged")
    ]  # fmt: skip
    assert replayed.gets_zero  # no base moves


def test_members_are_no_measured_neighbors(tmp_path: Path) -> None:
    for number, (distance, count) in enumerate(((None, 0), (1.0, 1))):
        neighbors = (Neighbor("b", 0.0, distance),)
        path = record(tmp_path / str(number), [0.0], more=[NeighborsInput(neighbors)])
        assert len(played(path, 1).taken["neighbors"]) == count


@pytest.mark.parametrize(
    ("options", "fault"),
    [
        ({"speed": 0}, "driver replay: speed is 0; expected a number of at least 0.05"),
        ({"sped": 2.0}, "driver replay: no key 'sped'; did you mean 'speed'?"),
        ({"file": 1}, "driver replay: file is 1; expected text"),
        (
            {"file": "nowhere.mcap"},
            "nowhere.mcap: cannot be read: No such file or directory; expected",
        ),
    ],
)
def test_refuses_options(tmp_path: Path, options: Mapping[str, Value], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        make(record(tmp_path / "a", [0.0]), **options)
    assert str(caught.value).startswith(fault)


def test_a_replay_that_is_behind_leaves_the_loop_to_others(tmp_path: Path) -> None:
    path = record(tmp_path / "a", [0.0] * 100)
    turns: list[int] = []
    before: list[int] = []

    class Busy(NullSink):
        def take(self, input: SensorInput) -> None:
            if isinstance(input, ScanInput):
                before.append(len(turns))
                asyncio.get_running_loop().call_soon(turns.append, input.scan.seq)

    async def story() -> None:
        task = asyncio.create_task(make(path).run(Busy()))
        while len(turns) < 100:
            await asyncio.sleep(0.1)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)

    handclock.run(story())
    assert before[-1] > 50, "other tasks ran in between"


@pytest.mark.parametrize(
    "input",
    [
        HazardsInput((Hazard(HazardKind.BUMP, "front left"), Hazard(HazardKind.LIFTED))),
        DetectionsInput((Detection("box", 0.5, None, "b"),)),
        DetectionsInput(None),
        ReadingsInput({"light": 0.25}),
        NeighborsInput((Neighbor("b", 0.5, 1.0, 0.2, None, False),)),
        PoseInput(SharedPose(4.0, Pose(1.0, 2.0, 0.5), 0.1, 0.1, "map")),
    ],
)
def test_every_other_input_is_played_as_recorded(tmp_path: Path, input: SensorInput) -> None:
    path = record(tmp_path / "a", [0.0, 0.2], more=[input])
    (value,) = astuple(input)
    assert played(path, 2).taken[tag_of(input)] == [value] * 2


def test_malformed_hazards_are_refused_before_the_start(tmp_path: Path) -> None:
    converter = Converter(Begin(0.0, str(tmp_path), "a", HEAD, 1e9, FileLimits()))
    converter.add(InputEntry(0.0, msgspec.msgpack.encode(("hazards", (("boom",),)))))
    converter.writer.close()
    assert converter.writer.path is not None
    with pytest.raises(ConfigError, match="/input"):
        make(converter.writer.path)
