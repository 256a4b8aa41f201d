"""The simulated driver against a body that the test controls, on loopback."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest

from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    DetectionsInput,
    NeighborsInput,
    OdometryInput,
    PoseInput,
    ReadingsInput,
)
from swarmd.core.finding import Finding
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
from swarmd.driver_api.driver import ZeroSenderSpec, gripper_of, message_carrier
from swarmd.driver_api.hw_codec import (
    KINDS,
    MessageWire,
    decode_command,
    encode_input,
    encode_odometry,
    encode_scan,
)
from swarmd.driver_api.watchdog_client import WatchedDriver
from swarmd.drivers import simulated
from swarmd.drivers.simulated import SimulatedDriver
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import WorldLink
from swarmd.testing.driver_contract import POLL_PERIOD, TIMEOUT, DriverContract, DriverHarness, Rig
from tests.support.processes import free_endpoint
from tests.support.range_ring import ring_spec, with_ring
from tests.support.stories import story

PLATFORM = load_platform("burger")
SPEC = PLATFORM.scan
DETECTED = (Detection("box", 0.5, 1.0, "b1"), Detection("lamp", -0.5))
POSE = SharedPose(2.0, Pose(1.0, -2.0, 3.0), error=0.01, yaw_error=0.02, frame="world")
NEVER = 1000.0
"""s, in place of SENSOR_TIMEOUT: after that time without a sample the driver looks into its socket
by itself, also if this process stood still."""
ODOMETRY = Odometry(1.0, Pose(0.1, 0.2, 0.3), Twist(0.1, 0.2))


class RecordingLink(WorldLink):
    """A world's link that keeps the received payloads."""

    def __init__(self, endpoint: str) -> None:
        self.payloads: list[bytes] = []
        super().__init__("s", ("r",), endpoint)

    def _on_command(self, robot: str, payload: bytes, arrival: float) -> None:
        self.payloads.append(payload)
        super()._on_command(robot, payload, arrival)


class Body:
    """A world with one body: the world's own end of the link."""

    platform = PLATFORM

    def __init__(self) -> None:
        self.endpoint = free_endpoint()  # which it has again after it has reconnected
        self.link = RecordingLink(self.endpoint)
        self._published_count = 0

    def make(self, options: Mapping[str, Value]) -> SimulatedDriver:
        return make(endpoint=self.endpoint, **options)

    def publish(self) -> None:
        self._published_count += 1
        self.send("scan", encode_scan(scan(self._published_count)))
        self.send(
            "odometry", encode_odometry(Odometry(0.1 * self._published_count, Pose(), Twist()))
        )

    def send(self, name: str, payload: bytes) -> None:
        self.link.receive()  # the driver may have connected meanwhile
        self.link.publish("r", name, payload)

    def publish_scan(self, scan: Scan) -> None:
        self.send("scan", encode_scan(scan))

    def publish_odometry(self) -> None:
        self._published_count += 1
        self.send(
            "odometry", encode_odometry(Odometry(0.1 * self._published_count, Pose(), Twist()))
        )

    def publish_garbage(self) -> None:
        whole = encode_scan(scan(1))
        for name in KINDS:
            for payload in (b"", b"\xff\x00garbage", whole[: len(whole) // 2], whole[:-1]):
                self.send(name, payload)

    def disconnect(self) -> None:
        self.link.close()

    def reconnect(self) -> None:
        self.link = RecordingLink(self.endpoint)

    def commands(self) -> Sequence[Twist]:
        return [command.twist for command in self.link.take_commands().values()]

    def close(self) -> None:
        self.link.close()


class TestContract(DriverContract):
    def rig(self) -> Body:
        return Body()


def scan(seq: int, noise: float = 0.001) -> Scan:
    ranges = np.full(360, 1.5) + noise * (seq % 100)
    ranges[:3] = (np.inf, -np.inf, np.nan)
    return Scan(seq, 0.2 * seq, ranges, SPEC.bearings, SPEC.range_min, SPEC.range_max)


def make(**options: Value) -> SimulatedDriver:
    return SimulatedDriver(swarm="s", robot="r", platform=PLATFORM, options=options)


@story(Body)
async def test_all_senses_arrive_as_they_were_sent(harness: DriverHarness, robot: Body) -> None:
    neighbors = (Neighbor("x", 0.0, 1.0, 0.5), Neighbor("y", 0.0))
    sink = harness.sink

    def have_arrived() -> bool:
        """Whether each sense has come; the link drops samples while its queue is full."""
        robot.send("scan", encode_scan(scan(77)))
        robot.send("odometry", encode_odometry(ODOMETRY))
        robot.send("neighbors", encode_input(NeighborsInput(neighbors)))
        robot.send("pose", encode_input(PoseInput(POSE)))
        robot.send("readings", encode_input(ReadingsInput({"light": 0.25})))
        robot.send("detections", encode_input(DetectionsInput(DETECTED)))
        is_last = sink.scans and sink.scans[-1].seq == 77 and sink.odometries[-1] == ODOMETRY
        others = (
            sink.taken["neighbors"],
            sink.taken["pose"],
            sink.taken["readings"],
            sink.taken["detections"],
        )
        return bool(is_last and all(others))

    await harness.until(have_arrived)
    np.testing.assert_allclose(sink.scans[-1].ranges, scan(77).ranges)
    np.testing.assert_allclose(sink.scans[-1].bearings, SPEC.bearings, atol=1e-9)
    assert sink.taken["neighbors"][0] == neighbors
    assert sink.taken["pose"][0] == POSE
    assert sink.taken["readings"][0] == {"light": 0.25}
    assert sink.taken["detections"][0] == DETECTED


@story(Body)
async def test_a_command_carries_the_scans_it_is_based_on(
    harness: DriverHarness, robot: Body
) -> None:
    harness.driver.send(Twist(0.2), 5, 4)

    def has_come() -> bool:
        robot.link.receive()
        return bool(robot.link.payloads)

    await harness.until(has_come)
    command = decode_command(robot.link.payloads[0])
    assert (command.scan_seq, command.requested_scan_seq) == (5, 4)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"endpont": "tcp/127.0.0.1:1"}, "did you mean 'endpoint'"),
        ({"endpoint": 7790}, "endpoint is 7790; expected"),
        ({"endpoint": "127.0.0.1:7790"}, "expected an endpoint such as tcp/"),
    ],
)
def test_unknown_options_are_refused(options: Mapping[str, Value], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        SimulatedDriver(swarm="s", robot="r", platform=PLATFORM, options=options)


def test_check_tells_what_scans_show_and_fails_for_a_frozen_sensor() -> None:
    def checked(noise: float) -> Finding:
        body = Body()

        async def run() -> tuple[Finding, ...]:
            checking = asyncio.create_task(body.make({}).check(TIMEOUT))
            for seq in itertools.count():
                body.publish_odometry()
                body.publish_scan(scan(seq, noise))
                await asyncio.sleep(POLL_PERIOD)
                if checking.done():
                    return checking.result()
            raise AssertionError

        found = {finding.subject: finding for finding in asyncio.run(run())}["scan"]
        body.close()
        return found

    differing = checked(0.001)
    assert differing.is_well
    assert "360 rays, 99 % with a return, the nearest at 1.5" in differing.text
    assert "scans differ" in differing.text
    frozen = checked(0.0)
    assert not frozen.is_well
    assert "frozen_scan" in frozen.text


class RingedBody(Body):
    """A body with a ring of range sensors."""

    platform = with_ring(PLATFORM)
    _rings = 0

    def make(self, options: Mapping[str, Value]) -> SimulatedDriver:
        given = {"endpoint": self.endpoint, **options}
        return SimulatedDriver(swarm="s", robot="r", platform=self.platform, options=given)

    def publish(self) -> None:
        super().publish()
        self.publish_ranges(np.full(len(ring_spec().bearings), 0.5))

    def publish_ranges(self, ranges: Array) -> None:
        spec = ring_spec()
        self._rings += 1
        scan = Scan(
            self._rings, 0.1 * self._rings, ranges, spec.bearings, spec.range_min, spec.range_max
        )
        self.send("ranges", encode_scan(scan))


@pytest.mark.long
class TestSimulatedDriverWithARing(DriverContract):
    """A ring is a second scan, with the geometry of the platform's section."""

    def rig(self) -> Rig:
        return RingedBody()


def test_a_check_misses_the_ring() -> None:
    body = RingedBody()

    async def check() -> Finding:
        found = await body.make({}).check(0.2)
        return next(one for one in found if one.subject == "ranges")

    assert not asyncio.run(check()).is_well
    body.close()


@story(Body)
async def test_a_ring_that_the_platform_lacks_is_dropped(
    harness: DriverHarness, robot: Body
) -> None:
    def has_come() -> bool:
        robot.send("ranges", encode_scan(scan(1)))
        return "hw/ranges" in harness.sink.lost

    await harness.until(has_come)
    assert harness.sink.rings == []


@story(Body)
async def test_the_gripper_of_the_world_gets_the_newest_command(
    harness: DriverHarness, robot: Body
) -> None:
    driver = harness.driver
    assert isinstance(driver, SimulatedDriver)
    assert gripper_of(WatchedDriver(driver, ZeroSenderSpec("none", {}), name="none")) is driver
    got: dict[str, bool] = {}

    def is_taken(is_closed: bool) -> bool:
        driver.grip(is_closed)
        robot.link.receive()
        got.update(robot.link.take_grips())
        return got == {"r": is_closed}

    await harness.until(lambda: is_taken(True))
    await harness.until(lambda: is_taken(False))
    assert got == {"r": False}


@story(Body, radio=True)
async def test_the_radio_of_the_world_carries_messages_in_their_order(
    harness: DriverHarness, robot: Body
) -> None:
    driver = harness.driver
    assert isinstance(driver, SimulatedDriver)
    watched = WatchedDriver(driver, ZeroSenderSpec("none", {}), name="none")
    assert message_carrier(watched) is driver
    sent: list[bytes] = []

    def exchange(*numbers: int) -> None:
        for number in numbers:
            driver.send_message("vote/opinion", bytes([number]))
        wires = [MessageWire("other", "vote/opinion", bytes([one])) for one in numbers]
        robot.link.messages("r", wires)

    def has_come(number: int) -> bool:
        robot.link.receive()
        sent.extend(wire.payload for wire in robot.link.take_messages())
        last = ("other", "vote/opinion", bytes([number]))
        return sent[-1:] == [bytes([number])] and harness.sink.messages[-1:] == [last]

    def is_linked() -> bool:
        exchange(99)
        return has_come(99)

    await harness.until(is_linked)
    many = 120  # more than fit into one packet
    exchange(*(number for number in range(many) if number != 99))
    await harness.until(lambda: has_come(many - 1))
    wanted = [bytes([number]) for number in range(many) if number != 99]
    assert [one for one in sent if one != bytes([99])] == wanted
    received = [payload for _, _, payload in harness.sink.messages]
    assert [one for one in received if one != bytes([99])] == wanted
    robot.send("received", b"garbage")
    await harness.until(lambda: "hw/received" in harness.sink.lost)
    assert message_carrier(make()) is None


@story(Body)
async def test_odometry_waits_in_the_socket_for_a_scan_or_a_decision(
    harness: DriverHarness, robot: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, sink, loop = harness.driver, harness.sink, asyncio.get_running_loop()
    assert isinstance(driver, SimulatedDriver)
    late: list[tuple[float, float]] = []  # stamps and times of arrival
    scans_before: list[int] = []  # the number of the last scan when odometry was taken

    def take_late(input: OdometryInput, age: float) -> None:
        late.append((input.odometry.stamp, loop.time() - age))
        scans_before.append(sink.scans[-1].seq)

    def publish_at(stamp: float) -> tuple[float, float]:
        """Publish odometry; the times before and after."""
        before = loop.time()
        robot.send("odometry", encode_odometry(Odometry(stamp, Pose(), Twist())))
        return before, loop.time()

    def has(stamp: float) -> bool:
        return bool(late) and late[-1][0] == stamp

    def is_in_time(stamp: float, sent: tuple[float, float], read: Callable[[], None]) -> bool:
        """`read` hands over the reading; False if it reached the socket after it was sent."""
        began = loop.time()
        read()
        inaccuracy = loop.time() - began + 0.005  # two clocks are read, one after the other
        assert has(stamp)
        assert sent[0] - inaccuracy <= late[-1][1]
        return late[-1][1] <= sent[1] + inaccuracy

    monkeypatch.setattr(simulated, "SENSOR_TIMEOUT", NEVER)
    driver.gather(take_late)  # once, before anything has arrived, as the daemon calls it
    async with asyncio.timeout(TIMEOUT):
        while not (sink.scans and sink.odometries):
            robot.publish()
            await asyncio.sleep(POLL_PERIOD)
        robot.publish_scan(scan(500))
        while sink.scans[-1].seq != 500:
            await asyncio.sleep(POLL_PERIOD)
        driver.read()
        late.clear()
        scans_before.clear()
        publish_at(1.0)
        sent = publish_at(1.05)
        await asyncio.sleep(0.1)
        assert not late
        was_in_time = is_in_time(1.05, sent, driver.read)  # as of a tick
        assert [stamp for stamp, _ in late] == [1.0, 1.05]
        assert late[0][1] <= late[1][1]  # the link knows the time of the last frame alone
        for tries in range(1, 20):  # on a busy machine a frame reaches the socket late
            if was_in_time:
                break
            sent = publish_at(1.05 + 0.001 * tries)
            await asyncio.sleep(0.1)
            was_in_time = is_in_time(1.05 + 0.001 * tries, sent, driver.read)
        assert was_in_time
        last_read = loop.time()
        publish_at(1.2)
        await asyncio.sleep(0.1)
        robot.publish_scan(scan(501))
        publish_at(1.21)
        while not (has(1.21) and sink.scans[-1].seq == 501):  # the scan wakes the loop
            await asyncio.sleep(POLL_PERIOD)
        # The decision on a scan uses the newest reading, which comes first.
        assert late[-2][0] == 1.2
        assert scans_before[-2:] == [500, 500]
        by_stamps = late[-3][1] + late[-2][0] - late[-3][0]
        assert min(by_stamps, last_read - 0.005) <= late[-2][1] <= max(by_stamps, last_read) + 0.005
        robot.send("neighbors", encode_input(NeighborsInput(())))
        robot.publish_scan(scan(502))
        while not sink.taken["neighbors"]:
            await asyncio.sleep(POLL_PERIOD)
        count = len(late)
        # Nothing waits from now on: the time of arrival of neighbours would be lost.
        publish_at(1.3)
        while not (sink.odometries and sink.odometries[-1].stamp == 1.3):
            await asyncio.sleep(POLL_PERIOD)
    assert len(late) == count
    assert not any("overtaken" in kind for kind in sink.lost)


@story(Body)
async def test_odometry_waits_again_in_the_socket_of_a_new_connection(
    harness: DriverHarness, robot: Body, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, sink = harness.driver, harness.sink
    assert isinstance(driver, SimulatedDriver)
    late: list[float] = []
    driver.gather(lambda input, age: late.append(input.odometry.stamp))

    async def publish_until_scans_grow() -> None:
        count = len(sink.scans)
        while len(sink.scans) < count + 3:
            robot.publish()
            await asyncio.sleep(POLL_PERIOD)

    async with asyncio.timeout(TIMEOUT):
        await publish_until_scans_grow()
        robot.disconnect()
        await harness.until(lambda: not sink.states[-1][0])
        robot.reconnect()
        monkeypatch.setattr(simulated, "SENSOR_TIMEOUT", NEVER)
        await publish_until_scans_grow()
        robot.publish_scan(scan(700))
        await harness.until(lambda: sink.scans[-1].seq == 700)
        driver.read()
        late.clear()
        robot.send("odometry", encode_odometry(Odometry(900.0, Pose(), Twist())))
        await asyncio.sleep(0.1)
        assert not late
        while not late:
            driver.read()
            await asyncio.sleep(POLL_PERIOD)
    assert late == [900.0]
