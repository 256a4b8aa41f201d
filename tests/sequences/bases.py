"""Bases that a sequence commands, and the links to them, for the real drivers in virtual time.

Each base replaces the lowest layer of its driver: the socket of `simulated`, cflib's connection
(the drone is the firmware of `drivers/crazyflie/firmware.py`), the adapter process of `ros1`, and
the Zenoh session of `rmw_zenoh`. All above is the driver's own code. A base has no command timeout
of its own unless its firmware has one: it goes on with the last command.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import zenoh
from rosbags.typesys.stores import ros1_noetic as noetic

from swarmd.core.events import HazardsInput, ReadingsInput
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.values import ZERO, Odometry, Platform, Pose, Scan, Twist, Value
from swarmd.driver_api import hw_codec
from swarmd.driver_api.driver import Driver
from swarmd.drivers import simulated
from swarmd.drivers.crazyflie import driver as crazyflie
from swarmd.drivers.crazyflie.firmware import Firmware
from swarmd.drivers.crazyflie.flight import HoverSetpoint
from swarmd.drivers.crazyflie.link import IS_FLYING, IS_TUMBLED, LOG_BLOCKS
from swarmd.drivers.ros import cdr, from_ros, messages, to_ros
from swarmd.drivers.ros1 import driver as ros1
from swarmd.drivers.ros1 import serialization
from swarmd.drivers.ros1.adapter import MasterState
from swarmd.drivers.ros2 import driver as ros2
from swarmd.drivers.ros2 import rmw_zenoh
from swarmd.drivers.ros2.key_scheme import TopicEnd
from swarmd.drivers.ros2.rmw_zenoh import RmwZenoh
from swarmd.drivers.ros2.rmw_zenoh import make_driver as make_rmw_zenoh
from swarmd.link.carriers.robot_link import Frame
from swarmd.settings.platforms import load_platform
from tests.sequences.virtual_loop import VirtualLoop

TICK = 0.05  # s
BOOT_TIME = 0.5  # s without a base, after a restart
OWNER_SPEED = 0.3  # m/s of the second owner's commands
FULL, EMPTY = 0.9, 0.1  # the reading of the battery
BATTERY = "battery_share"
BUMP = Hazard(HazardKind.BUMP, "front")
Patch = tuple[object, str, object]

LINK = ("link lost", "link closed", "link back", "base restarted")
SENSED = ("battery low", "battery back", "hazard", "hazard over")
OWNER = ("owner", "owner gone")
ORDERS = ("run", "stop")


class Base:
    """A base with its link. `actions`: what a sequence may do to it, beside the orders.

    A link that is `lost` passes nothing, and nobody is told; one that is `closed` tells its ends.
    """

    actions: tuple[str, ...] = (*LINK, *SENSED)
    platform: Platform = load_platform("burger")
    silence = 1.3  # s after which a silent base must be reported
    return_time = 3.0  # s within which a base that is well again must be reported
    start_time = 0.5  # s within which a base that is up moves
    rest_time = 0.5  # s within which it rests after a stop
    periods = 8, 4  # ticks between two scans and between two readings of odometry
    has_firmware = False  # the base stands by itself, and needs a rest before the next run

    def __init__(self, loop: VirtualLoop) -> None:
        self.loop = loop
        self.link = "ok"
        self.battery = FULL
        self.has_hazard = self.is_owned = False
        self.boots_until = 0.0
        self.on_command: Callable[[Twist], None] = lambda twist: None  # each of the driver
        self.force = ZERO  # the driver's command in force
        self.climbs = 0  # of a drone, by set-points of the driver
        self.ticks = 0
        self.noise = 0.0

    def patches(self) -> Sequence[Patch]:
        """What of the driver's modules is replaced: object, name, value."""
        raise NotImplementedError

    def make(self) -> Driver:
        """Its driver, not connected yet."""
        raise NotImplementedError

    def feed(self, *, scan: bool, odometry: bool) -> None:
        """Send what sensors measure, to a driver that is reached."""
        raise NotImplementedError

    @property
    def is_booted(self) -> bool:
        """True unless the base is restarting."""
        return self.loop.time() >= self.boots_until

    @property
    def is_at_rest(self) -> bool:
        """True if the base stands, and a drone on the ground for long enough."""
        return self.force.is_zero

    @property
    def is_reachable(self) -> bool:
        """True while base and link pass what the driver sends."""
        return self.link == "ok" and self.is_booted

    def tick(self) -> None:
        """Each TICK."""
        self.ticks += 1
        self.noise = 0.001 * (self.ticks % 97)
        self.advance()
        is_scan, is_odometry = (self.ticks % ticks == 0 for ticks in self.periods)
        if self.is_reachable and (is_scan or is_odometry):
            self.feed(scan=is_scan, odometry=is_odometry)
            if self.is_owned:
                self.command_as_owner()

    def advance(self) -> None:
        """What happens to the base by itself."""

    def command_as_owner(self) -> None:
        """The second owner moves the base."""

    def do(self, action: str) -> None:
        """An action of the table."""
        match action:
            case "link lost" | "link closed":
                self.link = action.split()[1]
            case "link back":
                self.link = "ok"
            case "base restarted":
                self.boots_until = self.loop.time() + BOOT_TIME
                self.force = ZERO
            case "battery low" | "battery back":
                self.battery = EMPTY if action == "battery low" else FULL
            case "hazard" | "hazard over":
                self.has_hazard = action == "hazard"
            case "owner" | "owner gone":
                self.is_owned = action == "owner"

    def is_possible(self, action: str) -> bool:
        """True if the action changes something now."""
        match action:
            case "link lost" | "link closed":
                return self.link == "ok"
            case "link back":
                return self.link != "ok"
            case "battery low" | "battery back":
                return (self.battery == FULL) == (action == "battery low")
            case "hazard" | "hazard over":
                return self.has_hazard == (action == "hazard over")
            case "owner" | "owner gone":
                return self.is_owned == (action == "owner gone")
        return True

    def take(self, twist: Twist) -> None:
        """A command of the driver reaches the base."""
        self.force = twist
        self.on_command(twist)

    def scan(self) -> Scan:
        """What the lidar measures now, with some noise."""
        spec = self.platform.scan
        ranges = np.full(len(spec.bearings), 2.0 + self.noise)
        now = self.loop.time()
        return Scan(self.ticks, now, ranges, spec.bearings, spec.range_min, spec.range_max)

    def odometry(self) -> Odometry:
        """The place of the base, which is not played."""
        return Odometry(self.loop.time(), Pose(), ZERO)


# Simulated


class SimulatedBase(Base):
    """A body of a world process; a lost link is a world that does not read its socket."""

    start_time = 0.3

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__(loop)
        self.client: _WorldClient | None = None
        self.waiting: list[bytes] = []

    def patches(self) -> Sequence[Patch]:
        return (
            (simulated, "RobotClient", partial(_WorldClient, self)),
            (simulated, "monotonic", self.loop.time),
        )

    def make(self) -> Driver:
        return simulated.SimulatedDriver(
            swarm="s", robot="r", platform=self.platform, options={"endpoint": "tcp/127.0.0.1:1"}
        )

    def do(self, action: str) -> None:
        super().do(action)
        if action in ("link closed", "base restarted"):
            self.waiting.clear()
            if self.client is not None:
                self.client.is_known = False
        if action == "link back" and self.waiting:
            # Of the frames that have waited, the world uses the newest.
            self.command(self.waiting[-1])
            self.waiting.clear()

    def command(self, payload: bytes) -> None:
        """A frame with a command comes."""
        if self.link == "lost":
            self.waiting.append(payload)
        elif self.is_reachable:
            wire = hw_codec.decode_command(payload)
            self.take(Twist(wire.linear, wire.angular, wire.lateral))

    def feed(self, *, scan: bool, odometry: bool) -> None:
        client = self.client
        if client is None or not client.is_known:
            return
        frames = [("scan", hw_codec.encode_scan(self.scan()))] if scan else []
        if odometry:
            hazards = (BUMP,) if self.has_hazard else ()
            readings = ReadingsInput({BATTERY: self.battery})
            frames += [
                ("odometry", hw_codec.encode_odometry(self.odometry())),
                ("hazards", hw_codec.encode_input(HazardsInput(hazards))),
                ("readings", hw_codec.encode_input(readings)),
            ]
        client.on_frames([Frame(*frame) for frame in frames])


class _WorldClient:
    """As `RobotClient`, to a base instead of a socket."""

    age = 0.0

    def __init__(
        self, base: SimulatedBase, endpoint: object, hello: object, on_frames: Callable[..., None]
    ) -> None:
        self.base, self.on_frames = base, on_frames
        self.is_known = False
        base.client = self

    async def run(self) -> None:
        """Keep a connection until cancelled."""
        while True:
            self.is_known = self.is_known or self.base.is_reachable
            if self.base.link == "closed" or not self.base.is_booted:
                self.is_known = False
                await asyncio.sleep(0.5)
            await asyncio.sleep(TICK)

    def send(self, name: str, payload: bytes) -> None:
        """Send a frame."""
        if self.is_known:
            self.base.command(payload)

    def wait_for(self, size: int) -> None:
        """Nothing is kept in a socket."""

    def read(self) -> None:
        """Nothing waits."""


# Crazyflie


class CrazyflieBase(Base):
    """The firmware of a drone, and cflib's connection to it."""

    actions = (*LINK, *SENSED, *OWNER, "estop")
    platform = load_platform("crazyflie")
    return_time = 12.0  # s: a silent drone is connected anew, and a landing is completed
    start_time, rest_time = 4.0, 8.0
    periods = 2, 1  # of LOG_BLOCKS
    has_firmware = True
    boot_time = 2.0  # s until the firmware takes set-points
    low_battery_time = 1.0  # s
    height = 0.5  # m

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__(loop)
        self.firmware = Firmware()
        self.connection: _DroneConnection | None = None

    def patches(self) -> Sequence[Patch]:
        return (
            (crazyflie, "DroneLink", partial(_DroneConnection, self)),
            (crazyflie, "call_in_thread", self.call),
            (crazyflie, "has_cflib", lambda: True),
            (crazyflie, "time", SimpleNamespace(monotonic=self.loop.time)),
            (crazyflie, "LOW_BATTERY_TIME", self.low_battery_time),
        )

    def make(self) -> Driver:
        options: Mapping[str, Value] = {
            "uri": "radio://0",
            "height": self.height,
            "take_off_rate": 1.0,
            "land_rate": 0.5,
            "land_after": 1.0,
        }
        return crazyflie.make_driver(swarm="s", robot="r", platform=self.platform, options=options)

    @property
    def is_at_rest(self) -> bool:
        """True 2 s after the motors had thrust, for which the firmware reports a flight."""
        return self.force.is_zero and not self.firmware._info() & IS_FLYING

    def call(self, call: Callable[[], None]) -> asyncio.Future[None]:
        """As `call_in_thread`, at once."""
        done: asyncio.Future[None] = self.loop.create_future()
        call()
        done.set_result(None)
        return done

    def do(self, action: str) -> None:
        super().do(action)
        if action == "base restarted":
            self.firmware = Firmware()
            self.firmware.faults = IS_TUMBLED if self.has_hazard else 0
            self.boots_until = self.loop.time() + self.boot_time
            if self.connection is not None:
                self.connection.has_logs = False
        elif action == "link closed" and self.connection is not None:
            self.connection.on_lost("the link is closed")
        elif action in ("hazard", "hazard over"):
            self.firmware.faults = IS_TUMBLED if self.has_hazard else 0

    def advance(self) -> None:
        if self.is_booted:
            self.firmware.tick(self.loop.time())
        self.firmware.set_battery(4.0 if self.battery == FULL else 3.0)

    def command_as_owner(self) -> None:
        self.receive(HoverSetpoint(Twist(OWNER_SPEED), self.height))

    def receive(self, setpoint: HoverSetpoint) -> None:
        """A set-point comes by CRTP: port 7, channel 0 (cflib, crazyflie/commander.py)."""
        twist, height = setpoint.twist, setpoint.height
        hover = struct.pack("<ffff", twist.linear, twist.lateral, np.degrees(twist.angular), height)
        packet = bytes([0x70, 10]) + hover if height > 0.0 else bytes([0x70, 0])
        self.firmware.receive(packet, self.loop.time())

    def take_setpoint(self, setpoint: HoverSetpoint) -> None:
        """A set-point of the driver."""
        if not self.is_reachable:
            return
        had_motors_on = self.firmware.has_motors_on
        self.receive(setpoint)
        self.climbs += self.firmware.has_motors_on and not had_motors_on
        self.take(setpoint.twist)

    def feed(self, *, scan: bool, odometry: bool) -> None:
        link = self.connection
        if link is None:
            return
        link.connect()
        if not link.has_logs:
            return
        firmware, stamp = self.firmware, round(1e3 * self.loop.time()) & 0xFFFFFF
        measured = firmware._values | {
            "stateEstimate.z": firmware.height,
            "supervisor.info": firmware._info(),
        }
        for name in (*(["status", "ranges"] if scan else []), "state"):
            variables = LOG_BLOCKS[name][1]
            link.on_data(name, stamp, {each: measured[each] for each in variables})


class _DroneConnection:
    """As `DroneLink`."""

    def __init__(
        self,
        base: CrazyflieBase,
        uri: str,
        on_open: Callable[[], None],
        on_lost: Callable[[str], None],
        on_data: Callable[..., None],
    ) -> None:
        self.base, self.on_open, self.on_lost, self.on_data = base, on_open, on_lost, on_data
        self.is_opening = self.has_logs = False
        base.connection = self

    def open(self) -> None:
        """Begin to connect: the drone answers, or nobody within a second."""
        self.is_opening = True
        self.base.loop.call_later(1.0, self._give_up)

    def _give_up(self) -> None:
        if self.is_opening:
            self.on_lost("nobody answers")

    def connect(self) -> None:
        """The drone is reached."""
        if self.is_opening:
            self.is_opening, self.has_logs = False, True
            self.on_open()
            self.on_data("deck", 0, {"bcFlow2": 1.0, "bcMultiranger": 1.0})

    def send(self, setpoint: HoverSetpoint) -> None:
        """Send a set-point."""
        if self.base.connection is self:
            self.base.take_setpoint(setpoint)

    def land(self, seconds: float) -> None:
        """Tell the drone to land by itself (cflib, high_level_commander.py)."""
        if self.base.is_reachable:
            now, firmware = self.base.loop.time(), self.base.firmware
            firmware.receive(bytes([0x71, 0]), now)
            firmware.receive(bytes([0x80, 8]) + bytes(10) + struct.pack("<f", seconds), now)

    def close(self) -> None:
        """End the connection."""
        self.is_opening = self.has_logs = False
        if self.base.connection is self:
            self.base.connection = None


# ROS


ENTRIES: Mapping[str, Any] = {
    "hazards": {
        "bumper": {"topic": "bumper", "type": "std_msgs/Bool", "means": "bump front"},
    },
    "readings": {
        BATTERY: {"topic": "battery", "type": "std_msgs/Float64", "field": "data"},
    },
    "cmd_vel_type": "twist",
}


class Ros1Base(Base):
    """A robot's nodes and the ROS master, as the adapter reports them; `link lost`: of the network.

    The adapter's own watchdog is not played, since it has threads and a clock of its own, but for
    the zeros of an adapter that begins after another one, and of one that is asked to leave.
    """

    actions = (*LINK, *SENSED, *OWNER, "adapter ended")
    silence = 3.0
    return_time = 4.0

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__(loop)
        self.adapter: _Adapter | None = None
        self.told: object = None

    def patches(self) -> Sequence[Patch]:
        clock = SimpleNamespace(monotonic=self.loop.time, time_ns=lambda: 0)
        return (ros1, "AdapterProcess", partial(_Adapter, self)), (ros1, "time", clock)

    def make(self) -> Driver:
        options: Mapping[str, Value] = {"master": "http://127.0.0.1:1", **ENTRIES}
        return ros1.Ros1Driver(swarm="s", robot="r", platform=self.platform, options=options)

    def do(self, action: str) -> None:
        super().do(action)
        if action == "adapter ended" and self.adapter is not None:
            self.adapter.has_ended = True
            self.adapter = None

    def advance(self) -> None:
        """Report the state of the master: at once if it changes, and each second."""
        adapter = self.adapter
        if adapter is None or self.link == "lost":  # a master is asked with a time-out
            return
        if adapter.holds and self.is_reachable:
            adapter.holds = False
            self.take(ZERO)
        state = self.state()
        if state != self.told or self.ticks % 20 == 0:
            self.told = state
            adapter.listener.on_event(state)

    def state(self) -> MasterState:
        """What the master knows now."""
        if self.link == "closed":
            return MasterState(master=False, text="refused")
        nodes = ["/base"] if self.is_booted else []
        topics = ("/scan", "/odom", "/bumper", "/battery")
        return MasterState(
            master=True,
            publishers={topic: nodes for topic in topics if nodes},
            types={
                "/scan": "sensor_msgs/LaserScan",
                "/odom": "nav_msgs/Odometry",
                "/bumper": "std_msgs/Bool",
                "/battery": "std_msgs/Float64",
            },
            others=["/joystick"] if self.is_owned else [],
            listeners=nodes,
            connected=len(nodes),
            command_type="geometry_msgs/Twist",
        )

    def command_as_owner(self) -> None:
        if self.adapter is not None:
            payload = serialization.encode_twist(Twist(OWNER_SPEED))
            names = self.adapter.config
            self.adapter.listener.on_message(len(names["topics"]), payload)

    def command(self, data: bytes) -> None:
        """The adapter publishes a command."""
        if self.is_reachable:
            self.take(from_ros.twist_of(serialization.decode(messages.Twist, data)))

    def feed(self, *, scan: bool, odometry: bool) -> None:
        if self.adapter is None:
            return
        stamp = self.loop.time()
        sent: list[tuple[str, object]] = []
        if scan:
            sent.append(("/scan", laser_scan(self.scan(), _noetic_header(stamp, "base_scan"))))
        if odometry:
            message: Any = to_ros.odometry_message(self.odometry())
            message.header = _noetic_header(stamp, "odom")
            sent += [
                ("/odom", message),
                ("/bumper", noetic.std_msgs__msg__Bool(self.has_hazard)),
                ("/battery", messages.Float64(self.battery)),
            ]
        for topic, message in sent:
            if self.adapter is not None:
                number = self.adapter.config["topics"].index(topic)
                self.adapter.listener.on_message(number, serialization.encode(message))


def _noetic_header(stamp: float, frame: str) -> Any:
    seconds = int(stamp)
    time = noetic.builtin_interfaces__msg__Time(seconds, int(1e9 * (stamp - seconds)))
    return noetic.std_msgs__msg__Header(0, time, frame)


def laser_scan(scan: Scan, header: Any) -> messages.LaserScan:
    """A scan as a message."""
    first, step = float(scan.bearings[0]), float(scan.bearings[1] - scan.bearings[0])
    return messages.LaserScan(
        header=header,
        angle_min=first,
        angle_max=first + (len(scan.bearings) - 1) * step,
        angle_increment=step,
        time_increment=0.0,
        scan_time=0.2,
        range_min=0.0,
        range_max=100.0,
        ranges=scan.ranges.astype(np.float32),
        intensities=np.empty(0, dtype=np.float32),
    )


class _Adapter:
    """As `AdapterProcess`."""

    pid = 1

    def __init__(
        self,
        base: Ros1Base,
        script: str,
        python: str,
        config: Mapping[str, Any],
        environ: Mapping[str, str],
        listener: Any,
    ) -> None:
        self.base, self.config, self.listener = base, config, listener
        self.has_ended = False
        self.holds = bool(config["holds"])  # it begins with zeros
        base.adapter, base.told = self, None

    def send(self, command: bytes) -> None:
        """Send a command."""
        if not self.has_ended:
            self.base.command(command)

    async def until_end(self, seconds: float) -> bool:
        """Wait; True once the process has ended."""
        await asyncio.sleep(seconds)
        return self.has_ended

    async def close(self, *, politely: bool) -> str:
        """End the process, which sends zero if it is asked to leave."""
        if politely and not self.has_ended and self.base.is_reachable:
            self.base.take(ZERO)
        self.has_ended = True
        return "has ended"


class Ros2Base(Base):
    """A robot's node and the router, by `rmw_zenoh`.

    A lost link is a router that is frozen: what is sent to it waits, and comes when it goes on.
    """

    actions = (*LINK, *SENSED, *OWNER)
    return_time = 3.5

    def __init__(self, loop: VirtualLoop) -> None:
        super().__init__(loop)
        self.session: _Session | None = None
        self.waiting: list[bytes] = []
        self.starts = 0
        self.announced: Sequence[str] = ()
        self.asked: list[Callable[[], object]] = []
        self.keys: dict[str, str] = {}

    @property
    def hub(self) -> str:
        """The id of the router."""
        return f"{self.starts + 1:032x}"

    def patches(self) -> Sequence[Patch]:
        async def opened(open_it: object) -> _Session:
            while not self.is_reachable:
                await asyncio.sleep(TICK)
            self.session = _Session(self)
            return self.session

        return (
            (ros2, "open_in_thread", opened),
            (ros2, "command_publisher", lambda session, key: _Publisher(self)),
            (ros2, "linked_hubs", lambda session: self.hubs()),
            (ros2, "ask_hub", self.ask),
            (ros2, "query_kept", Mock()),
            (ros2, "subscribe_with_history", Mock()),
            (ros2, "has_subscriber", lambda publisher: self.is_booted),
            (rmw_zenoh, "time", SimpleNamespace(time_ns=lambda: round(1e9 * self.loop.time()))),
        )

    def make(self) -> Driver:
        self.scheme = RmwZenoh(0, "/cmd_vel", "/", "base", 0)
        options: Mapping[str, Value] = {"endpoint": "tcp/127.0.0.1:1", **ENTRIES}
        return make_rmw_zenoh(swarm="s", robot="r", platform=self.platform, options=options)

    def hubs(self) -> frozenset[str]:
        """The routers to which the session is linked."""
        is_linked = self.link != "closed" and self.is_booted
        return frozenset({self.hub}) if is_linked else frozenset()

    def ask(self, session: object, on_answer: Callable[[], object]) -> None:
        """The router answers within a millisecond, or once it goes on."""
        if self.link == "lost":
            self.asked.append(on_answer)
        else:
            self.loop.call_later(0.001, on_answer)

    def do(self, action: str) -> None:
        if action == "base restarted":
            self.starts += 1
            self.waiting.clear()
            self.announce(())
        elif action == "link closed":
            self.waiting.clear()
            self.announce(())
        was_lost = self.link == "lost"
        super().do(action)
        if action == "link back" and was_lost:
            self.asked, asked = [], self.asked
            self.waiting, waiting = [], self.waiting
            for payload in waiting:
                self.command(payload)
            for on_answer in asked:
                on_answer()

    def advance(self) -> None:
        if self.session is not None and self.is_reachable and not self.announced:
            ends = [
                TopicEnd("/scan", messages.LaserScan, True, False, 5),
                TopicEnd("/odom", messages.Odometry, True, False, 5),
                TopicEnd("/bumper", BOOL, True, False, 5),
                TopicEnd("/battery", messages.Float64, True, False, 5),
                TopicEnd("/cmd_vel", messages.Twist, False, True, 5),
            ]
            self.announce(self.scheme.tokens(self.hub, ends))

    def announce(self, tokens: Sequence[str]) -> None:
        """Withdraw the node's tokens, and announce these."""
        session, before, self.announced = self.session, self.announced, tokens
        if session is not None:
            for token in before:
                session.tell_token(token, zenoh.SampleKind.DELETE)
            for token in tokens:
                session.tell_token(token, zenoh.SampleKind.PUT)

    def command_as_owner(self) -> None:
        self.publish("/cmd_vel", from_ros.twist_message(Twist(OWNER_SPEED)))

    def command(self, payload: bytes) -> None:
        """A command comes."""
        if self.link == "lost":
            self.waiting.append(payload)
        elif self.is_reachable:
            twist = from_ros.twist_of(cdr.decode(messages.Twist, payload))
            # The zero for either type is 5e-324 m/s to the side, read as a Twist.
            self.take(ZERO if abs(twist.lateral) < 1e-300 and twist.linear == 0.0 else twist)

    def feed(self, *, scan: bool, odometry: bool) -> None:
        if self.session is None:
            return
        if scan:
            head = to_ros.header(self.loop.time(), "base_scan")
            self.publish("/scan", laser_scan(self.scan(), head))
        if odometry:
            self.publish("/odom", to_ros.odometry_message(self.odometry()))
            self.publish("/bumper", BOOL(self.has_hazard))
            self.publish("/battery", messages.Float64(self.battery))

    def publish(self, topic: str, message: object) -> None:
        """The node, or another one, publishes."""
        if self.session is not None:
            if topic not in self.keys:
                self.keys[topic] = self.scheme.key(topic, type(message))
            self.session.deliver(topic, self.keys[topic], cdr.encode(message))


BOOL: Any = cdr.store().types["std_msgs/msg/Bool"]


class _Publisher:
    def __init__(self, base: Ros2Base) -> None:
        self.base = base

    def put(self, payload: bytes, *, attachment: object) -> None:
        """Send a command."""
        self.base.command(payload)


class _Session:
    """As a Zenoh session to the router."""

    def __init__(self, base: Ros2Base) -> None:
        self.base = base
        self.info = SimpleNamespace(zid=lambda: "f" * 32)
        self.subscribers: dict[str, Callable[[Any], None]] = {}
        self.on_token: Callable[[Any], None] = lambda sample: None
        base.announced = ()

    def liveliness(self) -> Any:
        """The announcements."""
        return SimpleNamespace(
            declare_subscriber=self._declare_tokens,
            declare_token=Mock(),
            get=lambda key, callback, timeout: callback.drop(),
        )

    def _declare_tokens(self, key: str, callback: Any, history: bool) -> None:
        self.on_token = callback.callback

    def declare_subscriber(self, key: str, receive: Any, **_: object) -> None:
        """Keys are `0/<topic>/*/*`."""
        self.subscribers[key.removeprefix("0").removesuffix("/*/*")] = receive

    def tell_token(self, token: str, kind: zenoh.SampleKind) -> None:
        """A token comes or goes."""
        self.on_token(SimpleNamespace(kind=kind, key_expr=token))

    def deliver(self, topic: str, key: str, payload: bytes) -> None:
        """A sample comes."""
        if topic in self.subscribers:
            sample = SimpleNamespace(key_expr=key, payload=zenoh.ZBytes(payload))
            self.subscribers[topic](sample)

    def close(self) -> None:
        """Close the session."""
        if self.base.session is self:
            self.base.session = None


BASES: Mapping[str, Callable[[VirtualLoop], Base]] = {
    "simulated": SimulatedBase,
    "crazyflie": CrazyflieBase,
    "ros1": Ros1Base,
    "ros2": Ros2Base,
}
