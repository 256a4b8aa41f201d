"""Part B with the flight of the driver and the emulated firmware, in virtual time, without a radio.

`test_crazyflie.py` has a daemon, and the maker's cflib.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import pytest

from swarmd.core.events import Input, OdometryInput, ReadingsInput, RequestInput
from swarmd.core.values import ZERO, Odometry, Pose, Twist
from swarmd.core.verbs import StopRequest
from swarmd.drivers.crazyflie import firmware
from swarmd.drivers.crazyflie.firmware import Firmware
from swarmd.drivers.crazyflie.flight import Flight, FlightRules, HoverSetpoint, Seen, Wish
from swarmd.operator.acceptance.evidence import Evidence, Samples
from swarmd.operator.acceptance.steps import steps_of
from swarmd.settings.platforms import load_platform

CRAZYFLIE = load_platform("crazyflie")
STEPS = {step.id: step for step in steps_of(CRAZYFLIE)}
AHEAD = Twist(0.1)
PERIOD = 0.05  # s
SETPOINT = 0x7C  # the header of a set-point: port 7, channel 0
BEGIN, EVENT, DOWN, LENGTH = 1.0, 7.5, 4.0, 18.0  # s


@dataclass
class Drone:
    """A drone and its flight; `x` in m by its state estimate."""

    land_after: float = 5.0
    ignores_zero: bool = False
    x: float = 0.0

    def __post_init__(self) -> None:
        self.firmware = Firmware()
        self.flight = Flight(FlightRules(0.5, 0.3, 0.3, self.land_after))

    def send(self, setpoint: HoverSetpoint | None, now: float) -> None:
        """As cflib encodes it."""
        if setpoint is None:
            return
        speed = setpoint.twist.linear
        if self.ignores_zero and speed == 0.0 and self.firmware.twist.linear:
            speed = AHEAD.linear
        payload = bytes([0])
        if setpoint.height > 0.0:
            payload = struct.pack("<Bffff", 10, speed, 0.0, 0.0, setpoint.height)
        self.firmware.receive(bytes([SETPOINT]) + payload, now)

    def advance(self, now: float, wish: Wish | None) -> None:
        """One period; `wish` None: no daemon sends."""
        own = self.firmware
        if wish is not None:
            seen = Seen(own.height, own.has_motors_on, may_fly=True, fault="", is_clear=True)
            twist = AHEAD if wish is Wish.FLY else ZERO
            self.send(self.flight.step(now, wish, twist, seen), now)
        own.tick(now)
        self.x += PERIOD * (own.twist.linear if own.height > 0.02 else 0.0)


def evidence(drone: Drone, after: Wish | None, *more: tuple[Input, float]) -> Evidence:
    """A flight ahead from BEGIN on; from EVENT on the daemon wants `after`; None: it is dead."""
    inputs: list[tuple[Input, float]] = []
    for tick in range(round(LENGTH / PERIOD)):
        now = PERIOD * tick
        is_dead = after is None and EVENT <= now < EVENT + DOWN
        if now < BEGIN or now >= EVENT + DOWN:
            wish: Wish | None = Wish.HOVER
        else:
            wish = Wish.FLY if now < EVENT else after
        drone.advance(now, wish)
        if not is_dead:
            inputs.append((OdometryInput(Odometry(now, Pose(drone.x), ZERO)), now))
            inputs.append((ReadingsInput({"height": drone.firmware.height}), now))
    return Evidence(CRAZYFLIE, Samples([*inputs, *more]))


STOP = (RequestInput(StopRequest(id="s", operator="o")), EVENT)


@pytest.mark.parametrize("wish", [Wish.HOVER, Wish.LAND], ids=["stop", "estop"])
def test_a_sound_drone_stops_and_lands(wish: Wish) -> None:
    found = STEPS["B1"].judge(evidence(Drone(), wish, STOP))
    assert found.result == "pass", found


@pytest.mark.parametrize(
    ("drone", "words"),
    [
        (Drone(land_after=600.0), "still in the air"),
        (Drone(ignores_zero=True), "ignores zero"),
    ],
    ids=["never lands", "ignores zero"],
)
def test_a_stop_that_is_not_obeyed_is_found(drone: Drone, words: str) -> None:
    found = STEPS["B1"].judge(evidence(drone, Wish.HOVER, STOP))
    assert (found.result, words in found.reason) == ("fail", True), found


@pytest.mark.parametrize("step", ["B7", "B8"])
def test_the_firmware_stops_a_drone_without_its_daemon(step: str) -> None:
    found = STEPS[step].judge(evidence(Drone(), None))
    assert found.result == "pass", found
    # It levels after 0.5 s.
    assert float(found.values["way"]) == pytest.approx(0.05, abs=0.011)


@pytest.mark.parametrize("step", ["B7", "B8"])
def test_a_firmware_without_timeouts_is_found(step: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(firmware, "LEVEL_TIMEOUT", 99.0)
    monkeypatch.setattr(firmware, "OFF_TIMEOUT", 99.0)
    found = STEPS[step].judge(evidence(Drone(), None))
    assert (found.result, "drove on" in found.reason) == ("fail", True), found
