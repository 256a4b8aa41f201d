"""Emulated Crazyflies: the drones' side of CRTP (their radio protocol), each at a UDP port.

cflib opens such a port by its own UDP driver (`udp://HOST:PORT`). Commands and state are those of
`firmware.py`; the simulated world moves the drones.
"""

from __future__ import annotations

import contextlib
import math
import random
import selectors
import socket
import threading
import time
from collections.abc import Callable, Mapping

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError, NetworkError
from swarmd.core.events import OdometryInput, PoseInput, ReadingsInput, ScanInput, SensorInput
from swarmd.core.low_battery import READING
from swarmd.core.values import Platform, Pose, Twist, Value
from swarmd.driver_api.emulator import OnCommand
from swarmd.drivers.crazyflie.firmware import Firmware
from swarmd.drivers.crazyflie.sensors import BATTERY_VOLTS, SENSORS

TICK = 0.02  # s
_SIZE = 2048
_FRAME = "world"  # the name that the simulated world gives its poses


def make_robots(
    *, robots: Mapping[str, Platform], endpoint: str, on_command: OnCommand
) -> CrtpRobots:
    """Emulated drones on the host of `endpoint`; of its port the first drone has the number."""
    return CrtpRobots(robots, endpoint, on_command)


class CrtpRobots:
    """Emulated drones on one thread: an `Emulator`.

    `loss`: the share of packets lost in each direction; `delay` in s of each packet to a driver.
    `tells_status`: battery and supervisor are sent with each odometry. A test may change these.
    """

    def __init__(
        self,
        robots: Mapping[str, Platform],
        endpoint: str,
        on_command: OnCommand,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open a port for each drone; raises as `EmulatorFactory` does."""
        self._on_command = on_command
        self._clock = clock
        # share of packets, and s
        self.loss = 0.0
        self.delay = 0.0
        self.tells_status = True
        self._draw = random.Random(0)  # of lost packets
        self._lock = threading.RLock()
        self._selector = selectors.DefaultSelector()
        self._drones: dict[str, _Drone] = {}
        host, first = _address(endpoint)
        try:
            for index, (robot, platform) in enumerate(robots.items()):
                port = first + index if first else 0  # 0: any free port
                self._drones[robot] = self._open(robot, platform, host, port)
        except BaseException:
            self._close_sockets()
            raise
        self._is_closed = False
        self._thread = threading.Thread(target=self._serve, name="crazyflies", daemon=True)
        self._thread.start()

    @property
    def driver_options(self) -> Mapping[str, Value]:
        """The addresses of the drones by robot, and the frame of their state estimates."""
        frame = _FRAME if any(drone.is_posed for drone in self._drones.values()) else ""
        return {
            "uri": {name: drone.uri for name, drone in self._drones.items()},
            "pose_frame": frame,
        }

    @property
    def dropped(self) -> int:
        """How many packets could not be read."""
        return sum(drone.firmware.dropped for drone in self._drones.values())

    def firmware(self, robot: str) -> Firmware:
        """The firmware of a drone, for tests; `locked` guards changes."""
        return self._drones[robot].firmware

    def publish(self, robot: str, input: SensorInput) -> None:
        """Send the log blocks that hold this measurement; other kinds are ignored."""
        with self._lock:
            drone = self._drones[robot]
            now = self._clock()
            if isinstance(input, ScanInput):
                ranges = dict(zip(SENSORS, input.scan.ranges.tolist(), strict=True))
                drone.firmware.set_ranges(ranges)
                drone.stamp = input.scan.stamp
                self._log(drone, ("range.",), now)
            elif isinstance(input, OdometryInput):
                drone.stamp = input.odometry.stamp
                drone.odometry = input.odometry.pose
                if drone.frame is not None:
                    pose = _moved(drone.frame, drone.odometry)
                    drone.firmware.set_state(pose, input.odometry.twist)
                    self._log(drone, ("stateEstimate",), now)
                if self.tells_status:
                    self.publish_status(robot)
            elif isinstance(input, ReadingsInput) and READING in input.readings:
                empty, full = BATTERY_VOLTS
                drone.firmware.set_battery(empty + (full - empty) * input.readings[READING])
            elif isinstance(input, PoseInput) and drone.is_posed and drone.frame is None:
                drone.frame = _frame(input.pose.pose, drone.odometry)

    def publish_status(self, robot: str) -> None:
        """Send the log blocks of battery and supervisor."""
        with self._lock:
            self._log(self._drones[robot], ("pm.", "supervisor."), self._clock())

    def send_bytes(self, robot: str, data: bytes) -> None:
        """Send bytes as they are to the driver of a drone."""
        with self._lock:
            self._send(self._drones[robot], data)

    def close(self) -> None:
        """Close all ports, and end the thread."""
        if self._is_closed:
            return
        self._is_closed = True
        self._thread.join()
        self._close_sockets()

    def _open(self, robot: str, platform: Platform, host: str, port: int) -> _Drone:
        if len(platform.scan.bearings) != len(SENSORS):
            raise ConfigError(
                f"platform {platform.name}: scan has {len(platform.scan.bearings)} rays; emulated"
                f" Crazyflies have {len(SENSORS)}: {', '.join(SENSORS)}"
            )
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            link.bind((host, port))
        except OSError as error:
            link.close()
            raise NetworkError(f"emulated Crazyflie {robot}: {host}:{port}: {error}") from None
        link.setblocking(False)
        drone = _Drone(robot, link, is_posed="pose" in platform.provides)
        self._selector.register(link, selectors.EVENT_READ, drone)
        return drone

    def _close_sockets(self) -> None:
        for drone in self._drones.values():
            drone.link.close()
        self._selector.close()

    def _serve(self) -> None:
        while not self._is_closed:
            for key, _ in self._selector.select(TICK):
                self._read(key.data)
            with self._lock:
                now = self._clock()
                for drone in self._drones.values():
                    drone.firmware.tick(now)
                    self._tell(drone)
                    while drone.late and drone.late[0][0] <= now:
                        self._put(drone, drone.late.pop(0)[1])

    def _read(self, drone: _Drone) -> None:
        while True:
            try:
                data, drone.peer = drone.link.recvfrom(_SIZE)
            except BlockingIOError:
                return
            except OSError:  # the driver's port is closed
                continue
            if self._draw.random() < self.loss:
                continue
            with self._lock:
                before = drone.firmware.command_count
                for answer in drone.firmware.receive(data, self._clock()):
                    self._send(drone, answer)
                if drone.firmware.command_count != before:
                    drone.told = None  # each command is told, also an equal command
                    self._tell(drone)

    def _tell(self, drone: _Drone) -> None:
        """Tell the world the command in force, if it has changed."""
        twist = drone.firmware.twist
        if twist != drone.told and drone.firmware.command_count:
            drone.told = twist
            self._on_command(drone.robot, twist)

    def _log(self, drone: _Drone, groups: tuple[str, ...], now: float) -> None:
        for packet in drone.firmware.log_packets(groups, drone.stamp, now):
            self._send(drone, packet)

    def _send(self, drone: _Drone, data: bytes) -> None:
        if self._draw.random() < self.loss:
            return
        if self.delay > 0.0:
            drone.late.append((self._clock() + self.delay, data))
        else:
            self._put(drone, data)

    def _put(self, drone: _Drone, data: bytes) -> None:
        if drone.peer is not None:
            with contextlib.suppress(OSError):  # the driver has gone, or does not read
                drone.link.sendto(data, drone.peer)


class _Drone:
    """One emulated drone and its port.

    `is_posed`: the state estimate is in the shared frame; otherwise it begins at the origin.
    `frame`: the origin of odometry in the frame of the estimate; None until the first pose in the
    shared frame, and no estimate is sent until then.
    """

    def __init__(self, robot: str, link: socket.socket, *, is_posed: bool) -> None:
        self.robot = robot
        self.link = link
        self.is_posed = is_posed
        self.frame = None if is_posed else Pose()
        host, port = link.getsockname()
        self.uri = f"udp://{host}:{port}"
        self.firmware = Firmware()
        self.peer: tuple[str, int] | None = None
        self.told: Twist | None = None
        self.stamp = 0.0
        self.odometry = Pose()
        self.late: list[tuple[float, bytes]] = []


def _address(endpoint: str) -> tuple[str, int]:
    """Host and port of `udp/HOST:PORT` or `tcp/HOST:PORT`; ConfigError for another form."""
    kind, _, rest = endpoint.partition("/")
    host, _, port = rest.rpartition(":")
    if kind not in ("tcp", "udp") or not host or not port.isdecimal():
        raise ConfigError(f"endpoint is {endpoint}; expected a value such as udp/127.0.0.1:0")
    return host, int(port)


def _moved(frame: Pose, pose: Pose) -> Pose:
    """A pose of the odometry's frame in the frame of which `frame` is the origin of odometry."""
    c = math.cos(frame.yaw)
    s = math.sin(frame.yaw)
    x = frame.x + c * pose.x - s * pose.y
    y = frame.y + s * pose.x + c * pose.y
    return Pose(x, y, wrap(frame.yaw + pose.yaw))


def _frame(shared: Pose, odometry: Pose) -> Pose:
    """The origin of odometry in the shared frame, from one pose in both frames."""
    yaw = wrap(shared.yaw - odometry.yaw)
    c = math.cos(yaw)
    s = math.sin(yaw)
    x = odometry.x
    y = odometry.y
    return Pose(shared.x - c * x + s * y, shared.y - s * x - c * y, yaw)
