"""An emulated Crazyflie in a room: it moves while it is in the air, and drifts there.

`swarmd.drivers.crazyflie.emulator` is the drone's side of the radio, over UDP. The simulated world
of `swarmctl sim` does not know that a drone stands, and lets it drift on the floor.
"""

from __future__ import annotations

import math
import threading
import time

import numpy as np

from swarmd.core.events import OdometryInput, ScanInput
from swarmd.core.values import ZERO, Odometry, Pose, Scan, Twist
from swarmd.drivers.crazyflie import firmware
from swarmd.drivers.crazyflie.emulator import CrtpRobots
from swarmd.drivers.crazyflie.link import LOG_BLOCKS
from swarmd.settings.platforms import load_platform

PLATFORM = load_platform("crazyflie")
PERIOD = 0.05  # s between two state estimates
SCAN_EVERY = 2  # periods
RESPONSE = 0.15  # s, of first order
IN_AIR = 0.02  # m
DRIFT = 0.005  # m/s
SIDE = 2.6  # m to a wall at each side
HAND = 0.3  # m


class CrazyflieBase:
    """One drone `cf-01`, and what a person does with it.

    Faults: `is_mirrored`: left and right are swapped. `ignores_zero`: set-points of zero velocity
    are not flown. `keeps_last`: the firmware has no timeout of set-points. `scale`: of the state
    estimate. `loss`: of packets, from `plug_in` on.

    `ahead` in m: the wall ahead. `hand`: the side at which a hand is held, as an index of the four
    ranges; -1: none.
    """

    def __init__(
        self,
        *,
        is_mirrored: bool = False,
        ignores_zero: bool = False,
        keeps_last: bool = False,
        scale: float = 1.0,
        loss: float = 0.0,
    ) -> None:
        self.ahead, self.hand = SIDE, -1
        self.speed = 0.0  # m/s ahead
        self._is_mirrored, self._ignores_zero, self._scale = is_mirrored, ignores_zero, scale
        self._loss = loss
        self._wanted = ZERO
        self._way = np.zeros(2)  # true, m from where the person set it
        self._estimate = np.zeros(2)
        self._began = time.monotonic()
        self._draws = np.random.default_rng(1)
        self._count = 0
        self.robots = CrtpRobots({"cf-01": PLATFORM}, "udp/127.0.0.1:0", self._obey)
        if keeps_last:
            self._keep_last()
        self._is_over = threading.Event()
        self._flying = threading.Thread(target=self._fly)
        self._flying.start()

    @property
    def options(self) -> dict[str, object]:
        return {"uri": str(self.robots.driver_options["uri"]["cf-01"])}  # type: ignore[index,call-overload]

    @property
    def height(self) -> float:
        return self.robots.firmware("cf-01").height

    @property
    def is_flying_ahead(self) -> bool:
        return self.speed > 0.05

    @property
    def is_connected(self) -> bool:
        """A daemon has started all its logs."""
        blocks = self.robots.firmware("cf-01")._blocks.values()
        return len(blocks) == len(LOG_BLOCKS) and all(block.period for block in blocks)

    def set_down(self, ahead: float = SIDE) -> None:
        """A person sets it on the floor, `ahead` m from the wall that it faces."""
        self._way[:] = 0.0
        self.ahead = ahead

    def unplug(self) -> None:
        """The radio is unplugged."""
        self.robots.loss = 1.0

    def plug_in(self) -> None:
        """The radio is there, and loses the share `loss` of the packets from now on."""
        self.robots.loss = self._loss

    def close(self) -> None:
        self._is_over.set()
        self._flying.join()
        self.robots.close()

    def _obey(self, robot: str, twist: Twist) -> None:
        if not (self._ignores_zero and twist.is_zero and self.height > IN_AIR):
            self._wanted = twist

    def _keep_last(self) -> None:
        """Repeat the last set-point within the timeouts of the firmware, as if it had none."""
        own = self.robots.firmware("cf-01")
        tick = own.tick

        def ticked(now: float) -> None:
            silence = now - own._commanded_at
            if firmware.LEVEL_TIMEOUT / 2.0 < silence < math.inf:
                own._commanded_at = now
            tick(now)

        own.tick = ticked  # type: ignore[method-assign]

    def _fly(self) -> None:
        velocity, before = np.zeros(2), time.monotonic()
        while not self._is_over.wait(PERIOD):
            wanted, now = self._wanted, time.monotonic()
            passed, before = now - before, now
            if self.height > IN_AIR:
                share = 1.0 - math.exp(-passed / RESPONSE)
                velocity += share * (np.array((wanted.linear, wanted.lateral)) - velocity)
                moved = passed * (velocity + self._draws.normal(0.0, DRIFT, 2))
            else:
                velocity[:] = 0.0
                moved = np.zeros(2)
            self._way += moved / self._scale  # it flies by its estimate
            self._estimate += moved
            self.speed = float(velocity[0])
            self._publish(velocity)

    def _publish(self, velocity: np.ndarray) -> None:
        stamp = time.monotonic() - self._began
        pose = Pose(float(self._estimate[0]), float(self._estimate[1]))
        twist = Twist(float(velocity[0]), 0.0, float(velocity[1]))
        self.robots.publish("cf-01", OdometryInput(Odometry(stamp, pose, twist)))
        self._count += 1
        if self._count % SCAN_EVERY:
            return
        x, y = self._way
        ranges = np.array((self.ahead - x, SIDE - y, SIDE + x, SIDE + y))
        if self.hand >= 0:
            ranges[self.hand] = HAND
        if self._is_mirrored:
            ranges = ranges[[0, 3, 2, 1]]
        spec = PLATFORM.scan
        scan = Scan(self._count, stamp, ranges, spec.bearings, spec.range_min, spec.range_max)
        self.robots.publish("cf-01", ScanInput(scan))
