"""The connection to one drone by cflib, whose threads call back.

cflib (a Crazyflie object) has threads of its own, and its calls may block, for good if the radio
was unplugged. So `call_in_thread` makes each call, on a thread that no end of the process awaits.

Three habits of cflib are kept from harm:

- `close_link` sends thrust 0, which would stop the motors of a flying drone. So the driver lands
  the drone first, and `DroneLink.close` closes the radio link before `close_link`, which then has
  no link to send thrust 0 on.
- A send that fails calls the error callback while cflib holds its lock for sending. cflib's own
  callback then waits for threads that may wait for that lock. `DroneLink` has a callback that only
  reports; the driver then closes the link from another thread.
- A thread sends pings ten times a second, and keeps the process alive. `DroneLink` starts no such
  thread: nothing here reads the statistics of the link.
"""

from __future__ import annotations

import asyncio
import logging
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from importlib.util import find_spec
from typing import Any

from swarmd.drivers.crazyflie.flight import HoverSetpoint

CAN_BE_ARMED = 1 << 0
IS_ARMED = 1 << 1
CAN_FLY = 1 << 3
IS_FLYING = 1 << 4
IS_TUMBLED = 1 << 5
IS_LOCKED = 1 << 6
IS_CRASHED = 1 << 7
"""Bits of `supervisor.info` (cflib, crazyflie/supervisor.py)."""

MISSING = "driver crazyflie needs cflib; expected: pip install 'swarmd[crazyflie]'"
LOG_BLOCKS = {
    "status": (100, ("pm.vbat", "supervisor.info")),
    "ranges": (100, ("range.front", "range.left", "range.back", "range.right")),
    "state": (
        50,
        (
            *(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "yaw")),
            "stateEstimateZ.rateYaw",
        ),
    ),
}
"""The log blocks by name, in the order of their start: the period in ms and the variables. Without
the status no set-point is sent to a drone that stands."""
_HALF_SIZE = {"stateEstimate.z": "FP16"}  # a block has 26 bytes

OnData = Callable[[str, int, Mapping[str, float]], None]
"""Takes the values of a log block: its name, the drone's stamp in ms (24 bits), the values.

Also takes the parameters of group `deck`, under that name, with the stamp 0.
"""


def has_cflib() -> bool:
    """True if the library is installed."""
    return find_spec("cflib") is not None


def call_in_thread(call: Callable[[], None]) -> asyncio.Future[None]:
    """Make a call on a new daemon thread; the result or exception of the future is the call's."""
    done: Future[None] = Future()

    def run() -> None:
        try:
            call()
            done.set_result(None)
        except Exception as error:
            done.set_exception(error)

    threading.Thread(target=run, name="crazyflie", daemon=True).start()
    return asyncio.wrap_future(done)


class DroneLink:
    """A connection to the drone at `uri`; the callbacks come on threads of cflib."""

    def __init__(
        self, uri: str, on_open: Callable[[], None], on_lost: Callable[[str], None], on_data: OnData
    ) -> None:
        import cflib.crtp  # of an extra that few have
        from cflib.crazyflie import Crazyflie

        logging.getLogger("cflib").setLevel(logging.CRITICAL)  # the driver tells what matters
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        self._uri = uri
        self._on_lost = on_lost
        self._on_data = on_data
        self._drone: Any = Crazyflie()
        self._drone._link_error_cb = lambda text: on_lost(_first_line(text))
        self._drone.link_statistics.start = lambda: None
        self._drone.connected.add_callback(lambda uri: self._begin_logs(on_open))
        self._drone.connection_failed.add_callback(lambda uri, text: on_lost(_first_line(text)))
        self._drone.param.add_update_callback(
            group="deck",
            cb=lambda name, value: on_data("deck", 0, {name.removeprefix("deck."): float(value)}),
        )

    def open(self) -> None:
        """Begin to connect; `on_open` or `on_lost` follows."""
        self._drone.open_link(self._uri)

    def send(self, setpoint: HoverSetpoint) -> None:
        """Send a set-point; may block while the radio is busy."""
        if self._drone.link is None:
            return
        if setpoint.height <= 0.0:
            self._drone.commander.send_stop_setpoint()
            return
        twist = setpoint.twist
        self._drone.commander.send_hover_setpoint(
            twist.linear, twist.lateral, math.degrees(twist.angular), setpoint.height
        )

    def land(self, seconds: float) -> None:
        """Tell the drone to land by itself, from where it is, within `seconds`.

        The first packet ends the precedence of the set-points before it.
        """
        if self._drone.link is not None:
            self._drone.commander.send_notify_setpoint_stop()
            self._drone.high_level_commander.land(0.0, seconds, yaw=None)

    def close(self) -> None:
        """End the connection and its threads; sends nothing."""
        link = self._drone.link
        self._drone.link = None
        if link is not None:
            link.close()
        for timer in list(self._drone._answer_patterns.values()):  # else sent again
            timer.cancel()
        self._drone.close_link()

    def _begin_logs(self, on_open: Callable[[], None]) -> None:
        from cflib.crazyflie.log import LogConfig  # of an extra that few have

        try:
            for name, (period, variables) in LOG_BLOCKS.items():
                block = LogConfig(name, period)
                for variable in variables:
                    block.add_variable(variable, _HALF_SIZE.get(variable))
                block.data_received_cb.add_callback(self._take)
                self._drone.log.add_config(block)
                block.start()
        except (KeyError, AttributeError) as error:
            self._on_lost(f"the firmware has no such log variable: {error}")
            return
        on_open()

    def _take(self, stamp: int, values: Mapping[str, float], block: Any) -> None:
        self._on_data(block.name, stamp, dict(values))


def _first_line(text: object) -> str:
    return str(text).strip().splitlines()[0][:200] if str(text).strip() else "the link has ended"
