"""The firmware's side of CRTP (the drones' radio protocol) for one emulated drone. Pure.

Ports, commands and encodings follow cflib 0.1.34 (crtp/crtpstack.py, crazyflie/log.py, toc.py,
commander.py, high_level_commander.py, supervisor.py, platformservice.py). Times are those of
src/modules/src/supervisor.c (bitcraze/crazyflie-firmware, August 2026), which was not run here:
without a set-point the drone levels after 0.5 s, and its motors stop after 2 s; it counts as flying
until 2 s after its motors had thrust.

One difference is on purpose: that supervisor locks a drone whose motors stopped so in flight, until
the drone is switched off and on. The emulated drone obeys the next set-point at once, which asks
more of a driver.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum

from swarmd.core.values import ZERO, Pose, Twist
from swarmd.drivers.crazyflie.link import CAN_BE_ARMED, CAN_FLY, IS_ARMED, IS_FLYING

LEVEL_TIMEOUT = 0.5
OFF_TIMEOUT = 2.0
"""s without a set-point until the drone levels, and until its motors stop."""
NO_RETURN = 32767
"""mm: the range of a sensor without a return; cflib takes 8000 and more for none."""
PROTOCOL_VERSION = 12
CLIMB_SPEED = 1.0
"""m/s: the emulated drone follows the set-point of its height this fast, and falls twice so."""
FLYING_TIME = 2.0
"""s since the motors had thrust for which the drone counts as flying."""
MAX_COMMAND = 100.0
"""m/s or rad/s; a faster command is dropped as unreadable."""


class _Port(IntEnum):
    """The ports of CRTP that the emulated drone serves."""

    PARAMETERS = 2
    RPYT = 3  # set-points of roll, pitch, yaw rate and thrust
    MEMORY = 4
    LOG = 5
    SETPOINT = 7  # set-points of any other kind
    HIGH_LEVEL = 8  # what the drone carries out by itself
    SUPERVISOR = 9
    PLATFORM = 13
    LINK = 15


_LOG_TYPES = {"B": 1, "H": 2, "I": 3, "b": 4, "h": 5, "i": 6, "f": 7, "e": 8}
_LOG_FORMATS = {number: letter for letter, number in _LOG_TYPES.items()}
_LOG_VARIABLES = {
    "range.front": "H",
    "range.back": "H",
    "range.left": "H",
    "range.right": "H",
    "range.up": "H",
    "stateEstimate.x": "f",
    "stateEstimate.y": "f",
    "stateEstimate.z": "f",
    "stateEstimate.vx": "f",
    "stateEstimate.vy": "f",
    "stateEstimate.yaw": "f",
    "stateEstimateZ.rateYaw": "h",
    "pm.vbat": "f",
    "supervisor.info": "H",
}
_PARAMETERS = ("deck.bcFlow2", "deck.bcMultiranger")
_READ_ONLY_BYTE = 0x48  # the type of both parameters
# Checksums of the tables of contents: any numbers, by which cflib finds a table in its cache.
_LOG_CHECKSUM = 0x10C
_PARAMETER_CHECKSUM = 0x9A6
_TOC_INFO = 3
_TOC_ITEM = 2
_CREATE = 6
_APPEND = 7
_DELETE = 2
_START = 3
_STOP = 4
_RESET = 5
_HOVER = 10
_MOTORS_STOP = 0
_END_PRECEDENCE = 0
_LAND = 8
_GET_PROTOCOL = 0
_COUNT_MEMORIES = 1
_GET_STATE = 0x0C
_IS_ANSWER = 0x80
_NO_SUCH_BLOCK = 2  # ENOENT


@dataclass(slots=True)
class _Block:
    """A log block: its variables with the format of each, and its period in s (0: stopped)."""

    variables: list[tuple[str, str]]
    period: float = 0.0
    sent_at: float = -math.inf


class Firmware:
    """One emulated drone. `twist`: the command in force; `height` in m."""

    def __init__(self) -> None:
        self.twist = ZERO
        self.height = 0.0
        self.dropped = 0
        self.command_count = 0  # set-points that were read
        self.faults = 0  # bits of IS_TUMBLED, IS_LOCKED, IS_CRASHED
        self.decks = dict.fromkeys(_PARAMETERS, 1)  # 0: the deck was not found
        self.is_armed = True  # a brushed Crazyflie arms itself, a brushless one does not
        self._target = 0.0  # m; 0: the motors are off
        self._commanded_at = -math.inf
        self._thrust_at = -math.inf
        self._now = -math.inf
        self._is_free = True  # no set-point has precedence over what the drone does by itself
        self._own_rate = 0.0  # m/s of its own landing; 0: none
        self._blocks: dict[int, _Block] = {}
        self._values: dict[str, float] = dict.fromkeys(_LOG_VARIABLES, 0.0)
        self._values |= {name: NO_RETURN for name in _LOG_VARIABLES if name.startswith("range.")}
        self._values["pm.vbat"] = 4.0

    @property
    def has_motors_on(self) -> bool:
        """True while the motors turn."""
        return self._target > 0.0

    def set_ranges(self, ranges: Mapping[str, float]) -> None:
        """Set measured ranges in m by the name of the sensor; infinite: no return."""
        for name, distance in ranges.items():
            near_or_far = 0 if distance == -math.inf else NO_RETURN
            is_measured = math.isfinite(distance)
            self._values[f"range.{name}"] = round(1e3 * distance) if is_measured else near_or_far

    def set_state(self, pose: Pose, twist: Twist) -> None:
        """Set the state estimate: pose in m and rad, velocities in the drone's frame."""
        c = math.cos(pose.yaw)
        s = math.sin(pose.yaw)
        self._values |= {
            "stateEstimate.x": pose.x,
            "stateEstimate.y": pose.y,
            "stateEstimate.yaw": math.degrees(pose.yaw),
            "stateEstimate.vx": c * twist.linear - s * twist.lateral,
            "stateEstimate.vy": s * twist.linear + c * twist.lateral,
            "stateEstimateZ.rateYaw": min(max(round(1e3 * twist.angular), -32768), 32767),
        }

    def set_battery(self, volts: float) -> None:
        """Set the voltage of the battery."""
        self._values["pm.vbat"] = volts

    def tick(self, now: float) -> None:
        """Advance the drone to `now` in s: time-outs of the commander, and the height."""
        passed = min(max(now - self._now, 0.0), 0.1)
        self._now = now
        if self._own_rate:
            self._target = max(self._target - self._own_rate * passed, 0.0)
            self._commanded_at = now
        silence = now - self._commanded_at
        if silence > LEVEL_TIMEOUT:
            self.twist = ZERO
        if silence > OFF_TIMEOUT or self.faults:
            self._target = 0.0
            self.twist = ZERO
            self._thrust_at = -math.inf  # the supervisor has left its state of flight
        if self.has_motors_on:
            self._thrust_at = now
            step = CLIMB_SPEED * passed
            self.height += min(max(self._target - self.height, -step), step)
        else:
            self.height = max(self.height - 2.0 * CLIMB_SPEED * passed, 0.0)

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """The answers to a packet; malformed packets are counted in `dropped`."""
        if not data:
            return []
        # The header: the port in the upper four bits, the channel in the lower two.
        port = data[0] >> 4
        channel = data[0] & 3
        payload = data[1:]
        if data[0] == 0xFF:  # the null packet
            return [data]
        try:
            return [
                bytes([port << 4 | 0x0C | channel]) + answer
                for answer in self._answers(port, channel, payload, now)
            ]
        except (IndexError, struct.error, ValueError, KeyError):
            self.dropped += 1
            return []

    def log_packets(self, prefixes: tuple[str, ...], stamp: float, now: float) -> Iterator[bytes]:
        """The packets of the started blocks with a variable of these groups.

        `stamp` in s of the drone's clock. A block is sent at most once in its period.
        """
        values = self._values | {"stateEstimate.z": self.height, "supervisor.info": self._info()}
        for number, block in self._blocks.items():
            names = [name for name, _ in block.variables]
            if not block.period or not any(name.startswith(prefixes) for name in names):
                continue
            if now - block.sent_at < 0.5 * block.period:
                continue
            block.sent_at = now
            packed = b"".join(
                struct.pack(f"<{form}", values[name] if form in "fe" else int(values[name]))
                for name, form in block.variables
            )
            stamp_ms = int(1e3 * stamp) & 0xFFFFFF
            yield (
                bytes([_Port.LOG << 4 | 0x0C | 2, number]) + stamp_ms.to_bytes(3, "little") + packed
            )

    def _info(self) -> int:
        ready = CAN_FLY | IS_ARMED if self.is_armed else CAN_BE_ARMED
        info = self.faults or ready
        return info | (IS_FLYING if self._now - self._thrust_at < FLYING_TIME else 0)

    def _answers(self, port: int, channel: int, payload: bytes, now: float) -> Iterator[bytes]:
        """The payloads of the answers to a request; none for an unknown port, channel or command.

        Each payload has the layout that cflib reads on the port and channel. A set-point is carried
        out, and has no answer.
        """
        match port, channel:
            case _Port.LINK, 0:  # an echo
                yield payload
            case _Port.LINK, 1:  # the name of the sender
                yield b"Bitcraze Crazyflie".ljust(30, b"\0")
            case _Port.PLATFORM, 1 if payload[0] == _GET_PROTOCOL:
                yield bytes([_GET_PROTOCOL, PROTOCOL_VERSION])
            case _Port.LOG, 0:  # the table of contents
                items = [_item(_LOG_TYPES[kind], name) for name, kind in _LOG_VARIABLES.items()]
                yield from _toc(payload, items, _LOG_CHECKSUM)
            case _Port.LOG, 1:  # a command on a log block
                yield self._log_command(payload)
            case _Port.MEMORY, 0 if payload[0] == _COUNT_MEMORIES:
                yield bytes([_COUNT_MEMORIES, 0])
            case _Port.PARAMETERS, 0:  # the table of contents
                items = [_item(_READ_ONLY_BYTE, name) for name in _PARAMETERS]
                yield from _toc(payload, items, _PARAMETER_CHECKSUM)
            case _Port.PARAMETERS, 1:  # the value of a parameter
                yield payload[:2] + bytes([0, self.decks[_PARAMETERS[payload[0]]]])
            case _Port.SUPERVISOR, 0 if payload[0] == _GET_STATE:
                yield bytes([_IS_ANSWER | _GET_STATE]) + self._info().to_bytes(2, "little")
            case _Port.SETPOINT, 0:
                self._own_rate = 0.0
                self._is_free = False
                self._command(payload, now)
            case _Port.SETPOINT, 1 if payload[0] == _END_PRECEDENCE:
                self._is_free = True
            case _Port.HIGH_LEVEL, 0 if payload[0] == _LAND and self._is_free:
                (seconds,) = struct.unpack("<f", payload[11:15])
                self.twist = ZERO
                self._own_rate = self.height / max(seconds, 0.1)
            case _Port.RPYT, 0:
                (*_, thrust) = struct.unpack("<fffH", payload)
                if thrust == 0:  # the drone is flown by other set-points; thrust 0 ends a flight
                    self._stop_motors(now)

    def _command(self, payload: bytes, now: float) -> None:
        if payload[0] == _MOTORS_STOP:
            self._stop_motors(now)
        elif payload[0] == _HOVER:
            vx, vy, yaw_rate, height = struct.unpack("<ffff", payload[1:17])
            twist = Twist(vx, math.radians(yaw_rate), vy)
            speeds = abs(twist.linear), abs(twist.angular), abs(twist.lateral)
            if not (math.isfinite(sum(speeds) + height) and max(speeds) <= MAX_COMMAND):
                raise ValueError("a set-point that is not finite")
            self.command_count += 1
            if not self.faults and self.is_armed:
                self.twist = twist
                self._target = height
                self._commanded_at = now

    def _stop_motors(self, now: float) -> None:
        self.command_count += 1
        self.twist = ZERO
        self._target = 0.0
        self._commanded_at = now

    def _log_command(self, payload: bytes) -> bytes:
        command = payload[0]
        status = 0
        if command == _RESET:
            self._blocks.clear()
            return bytes([command, 0, status])
        number = payload[1]
        if command in (_CREATE, _APPEND):
            names = list(_LOG_VARIABLES)
            added = [
                (names[ident], _LOG_FORMATS[kind & 0x0F])
                for kind, ident in struct.iter_unpack("<BH", payload[2:])
            ]
            if command == _CREATE:
                self._blocks[number] = _Block([])
            self._blocks[number].variables.extend(added)
        elif number not in self._blocks:
            status = _NO_SUCH_BLOCK
        elif command == _START:
            self._blocks[number].period = 0.01 * payload[2]
        elif command == _STOP:
            self._blocks[number].period = 0.0
        elif command == _DELETE:
            del self._blocks[number]
        return bytes([command, number, status])


def _toc(payload: bytes, items: list[bytes], checksum: int) -> Iterator[bytes]:
    """The answers to a question for a table of contents, or for an item of the table."""
    if payload[0] == _TOC_INFO:
        yield struct.pack("<BHIBB", _TOC_INFO, len(items), checksum, 16, 128)
    elif payload[0] == _TOC_ITEM:
        (ident,) = struct.unpack("<H", payload[1:3])
        yield payload[:3] + items[ident]


def _item(kind: int, name: str) -> bytes:
    return bytes([kind]) + name.replace(".", "\0").encode() + b"\0"
