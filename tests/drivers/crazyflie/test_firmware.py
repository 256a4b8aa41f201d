"""The emulated firmware: what a drone does when set-points end, and what it answers."""

from __future__ import annotations

import math
import struct

import pytest

from swarmd.core.values import ZERO, Pose, Twist
from swarmd.drivers.crazyflie.firmware import (
    LEVEL_TIMEOUT,
    OFF_TIMEOUT,
    Firmware,
)
from swarmd.drivers.crazyflie.link import CAN_FLY, IS_ARMED, IS_FLYING, IS_LOCKED

TICK = 0.02


def hover(vx: float = 0.1, height: float = 0.5) -> bytes:
    return bytes([0x7C, 10]) + struct.pack("<ffff", vx, 0.0, 90.0, height)


class Flown:
    """A drone that has flown at 0.5 m until `now`."""

    def __init__(self) -> None:
        self.firmware, self.now = Firmware(), 0.0
        for _ in range(100):
            self.firmware.receive(hover(), self.now)
            self.pass_time(TICK)

    def pass_time(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end - 1e-9:
            self.now += TICK
            self.firmware.tick(self.now)


def info(firmware: Firmware) -> int:
    (answer,) = firmware.receive(bytes([0x9C, 0x0C]), 0.0)
    assert answer[:2] == bytes([0x9C, 0x8C])
    return int.from_bytes(answer[2:], "little")


def test_without_setpoints_the_drone_levels_and_then_falls() -> None:
    drone = Flown()
    assert drone.firmware.height == pytest.approx(0.5)
    assert drone.firmware.twist.linear == pytest.approx(0.1)
    assert drone.firmware.twist.angular == pytest.approx(math.pi / 2.0)
    drone.pass_time(LEVEL_TIMEOUT - 2 * TICK)
    assert not drone.firmware.twist.is_zero
    drone.pass_time(3 * TICK)
    assert drone.firmware.twist == ZERO
    assert drone.firmware.height == pytest.approx(0.5)
    drone.pass_time(OFF_TIMEOUT - LEVEL_TIMEOUT - 4 * TICK)
    assert drone.firmware.has_motors_on
    drone.pass_time(4 * TICK)
    assert not drone.firmware.has_motors_on
    drone.pass_time(1.0)
    assert drone.firmware.height == 0.0


@pytest.mark.parametrize(
    "packet", [bytes([0x7C, 0]), bytes([0x3C]) + struct.pack("<fffH", 0.0, 0.0, 0.0, 0)]
)
def test_a_stop_and_a_thrust_of_zero_stop_the_motors_in_the_air(packet: bytes) -> None:
    drone = Flown()
    drone.firmware.receive(packet, drone.now)
    assert not drone.firmware.has_motors_on
    assert drone.firmware.twist == ZERO


def test_a_drone_counts_as_flying_until_two_seconds_after_its_thrust() -> None:
    drone = Flown()
    drone.firmware.receive(bytes([0x7C, 0]), drone.now)  # the motors stop
    drone.pass_time(1.9)
    assert drone.firmware.height == 0.0
    assert info(drone.firmware) & IS_FLYING
    drone.pass_time(0.2)
    assert not info(drone.firmware) & IS_FLYING


def test_a_drone_that_is_told_to_land_by_itself_needs_no_setpoints() -> None:
    drone = Flown()
    land = bytes([0x8C]) + struct.pack("<BBff?f", 8, 0, 0.0, 0.0, True, 4.0)
    drone.firmware.receive(land, drone.now)  # the set-points still have precedence
    drone.pass_time(0.2)
    assert drone.firmware.height == pytest.approx(0.5)
    for packet in (bytes([0x7D]) + struct.pack("<BI", 0, 0), land):
        drone.firmware.receive(packet, drone.now)
    drone.pass_time(2.0)
    assert drone.firmware.height == pytest.approx(0.25, abs=0.02)
    assert drone.firmware.has_motors_on
    drone.pass_time(2.2)
    assert drone.firmware.height == 0.0
    assert not drone.firmware.has_motors_on


def test_a_locked_drone_obeys_no_setpoint_and_says_so() -> None:
    drone = Flown()
    assert info(drone.firmware) == CAN_FLY | IS_ARMED | IS_FLYING
    drone.firmware.faults = IS_LOCKED
    drone.pass_time(1.0)
    assert info(drone.firmware) == IS_LOCKED
    drone.firmware.receive(hover(), drone.now)
    assert drone.firmware.twist == ZERO
    assert not drone.firmware.has_motors_on


@pytest.mark.parametrize(
    "packet",
    [
        b"\x7c",
        b"\x7c\x0a\x00",
        hover(float("nan")),
        hover(1e9),
        b"\x5c\x02\xff\xff",
        b"\x5d\x06",
        b"\x2d\x63\x00",
        b"\x3c\x00",
    ],
)
def test_a_malformed_packet_is_counted_and_changes_nothing(packet: bytes) -> None:
    drone = Flown()
    before = drone.firmware.twist
    assert drone.firmware.receive(packet, drone.now) == []
    assert drone.firmware.dropped == 1
    assert drone.firmware.twist == before


def test_a_log_block_has_the_values_in_the_frame_of_the_world() -> None:
    firmware = Firmware()
    names = ["stateEstimate.vx", "stateEstimate.vy", "range.front"]
    idents = [list_of_variables(firmware).index(name) for name in names]
    block = b"".join(
        struct.pack("<BH", kind, ident) for kind, ident in zip((7, 7, 2), idents, strict=True)
    )
    assert firmware.receive(b"\x5d\x06\x01" + block, 0.0) == [b"\x5d\x06\x01\x00"]
    assert list(firmware.log_packets(("range.",), 1.0, 0.0)) == []  # not started
    firmware.receive(b"\x5d\x03\x01\x0a", 0.0)
    firmware.set_state(Pose(yaw=1.5707963267948966), Twist(0.2, 0.0, 0.1))
    firmware.set_ranges({"front": 1.234})
    (packet,) = firmware.log_packets(("range.",), 1.5, 10.0)
    assert packet[:5] == b"\x5e\x01" + (1500).to_bytes(3, "little")
    vx, vy, front = struct.unpack("<ffH", packet[5:])
    assert (vx, vy) == (pytest.approx(-0.1), pytest.approx(0.2))
    assert front == 1234
    assert list(firmware.log_packets(("range.",), 1.51, 10.01)) == []  # within the period


def list_of_variables(firmware: Firmware) -> list[str]:
    (told,) = firmware.receive(b"\x5c\x03", 0.0)
    (count,) = struct.unpack("<H", told[2:4])
    items = [firmware.receive(b"\x5c\x02" + struct.pack("<H", n), 0.0)[0] for n in range(count)]
    return [item[5:-1].replace(b"\0", b".").decode() for item in items]
