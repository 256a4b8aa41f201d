"""Driver `crazyflie`: a drone at one height, by the maker's cflib over radio, USB or UDP.

The daemon runs on the computer that holds the radio. `flight.py` decides what is sent; this module
feeds it with the daemon's commands and the drone's log blocks. No parameter of the drone is set,
and nothing is uploaded.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Mapping
from functools import partial
from typing import Annotated

from msgspec import Meta, Struct

from swarmd.core.angles import wrap
from swarmd.core.errors import ConfigError
from swarmd.core.events import (
    HazardsInput,
    OdometryInput,
    PoseInput,
    ReadingsInput,
    ScanInput,
    tag_of,
)
from swarmd.core.finding import Finding
from swarmd.core.hazard import Hazard, HazardKind
from swarmd.core.low_battery import READING as BATTERY
from swarmd.core.messages import Motion, ShownPose, State, Status
from swarmd.core.values import (
    ZERO,
    Odometry,
    Platform,
    Pose,
    Scan,
    SharedPose,
    Twist,
    Value,
)
from swarmd.driver_api.command_gate import CommandGate
from swarmd.driver_api.driver import NullSink, Sink
from swarmd.drivers.crazyflie.flight import (
    LANDED_HEIGHT,
    NOT_ARMED,
    Flight,
    FlightRules,
    HoverSetpoint,
    Phase,
    Seen,
    Wish,
)
from swarmd.drivers.crazyflie.link import (
    CAN_BE_ARMED,
    CAN_FLY,
    IS_ARMED,
    IS_CRASHED,
    IS_FLYING,
    IS_LOCKED,
    IS_TUMBLED,
    MISSING,
    DroneLink,
    call_in_thread,
    has_cflib,
)
from swarmd.drivers.crazyflie.sensors import BATTERY_VOLTS, SENSORS, ranges_of
from swarmd.settings.layered import Layered

NAME = "crazyflie"
PERIOD = 0.05  # s between two set-points
SILENCE_TIMEOUT = 1.0
"""s without a log block after which the drone is lost."""
REOPEN_TIMEOUT = 4.0
"""s without a log block after which the driver connects anew: the drone may have restarted."""
CONNECT_TIMEOUT = 10.0  # s
RETRY_PERIOD = 0.5  # s
CLOSE_TIMEOUT = 0.5  # s
LAND_TIMEOUT = 2.0
"""s that the end of the driver gives a landing; then the firmware lands the drone by itself."""
COMMAND_TIMEOUT = 0.3
"""s after which a command of the daemon counts as none."""
LOW_BATTERY_TIME = 5.0
"""s for which the voltage must be low, as in the firmware: a climb lowers the voltage."""
REST_SPEED = 0.15
"""m/s: a state estimate that is faster while the drone stands is wrong, or the drone is carried."""
REST_TIME = 1.0
"""s for which the state estimate must rest on the floor before a take-off."""
_DECKS = {"bcFlow2": "Flow deck v2", "bcMultiranger": "Multi-ranger"}
_DECK_REMEDY = "switch the drone off, seat the deck, switch the drone on"
_FLOOR_REMEDY = "set the drone on the floor, and restart it"
_STAMP_PERIOD = 1 << 24  # ms, after which the stamps of the drone start again
_HAZARDS = {
    IS_TUMBLED: Hazard(HazardKind.LIFTED, "tumbled"),
    IS_CRASHED: Hazard(HazardKind.LIFTED, "crashed"),
    IS_LOCKED: Hazard(HazardKind.STALL, "locked"),
}
_NOT_HEARD = Hazard(HazardKind.NOT_HEARD, "supervisor.info")
_DEFAULT_HEIGHT = 0.5  # m, of a platform without `heights`

Rate = Annotated[float, Meta(ge=0.05, le=1.0)]
Volts = Annotated[float, Meta(ge=1.0, le=60.0)]


class CrazyflieOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The options of the driver.

    - `uri`: the drone's address for cflib, such as radio://0/80/2M/E7E7E7E7E7, or the addresses of
      all drones by robot.
    - `height`: m above the floor; None: `heights.scan_plane` of the platform.
    - `take_off_rate`, `land_rate`: m/s.
    - `land_after`: s of hovering after the end of a run until the drone lands.
    - `clear`: m that all ranges must have for a take-off.
    - `battery_volts`: the voltages of an empty and a full battery.
    - `low_battery`: the voltage below which the drone lands.
    - `pose_frame`: the name of the shared frame in which the drone's state estimate is (Lighthouse,
      motion capture); empty: the estimate has an origin of its own. `pose_error` in m and
      `pose_yaw_error_deg` bound the errors of the estimate.
    """

    uri: str | dict[str, str]
    height: Annotated[float, Meta(ge=0.2, le=3.0)] | None = None
    take_off_rate: Rate = 0.3
    land_rate: Rate = 0.3
    land_after: Annotated[float, Meta(ge=0.0, le=600.0)] = 5.0
    clear: Annotated[float, Meta(ge=0.1, le=4.0)] = 0.4
    battery_volts: tuple[Volts, Volts] = BATTERY_VOLTS
    low_battery: Volts = 3.2
    pose_frame: Annotated[str, Meta(max_length=63)] = ""
    pose_error: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.05
    pose_yaw_error_deg: Annotated[float, Meta(ge=0.0, le=180.0)] = 5.0


def make_driver(
    *, swarm: str, robot: str, platform: Platform, options: Mapping[str, Value]
) -> CrazyflieDriver:
    """A driver that has not connected yet; ConfigError for unknown options."""
    read = Layered((f"driver {NAME}", {"uri": {}, **options})).build(CrazyflieOptions)
    if len(platform.scan.bearings) != len(SENSORS):
        raise ConfigError(
            f"driver {NAME}: platform {platform.name} has {len(platform.scan.bearings)} rays;"
            f" expected {len(SENSORS)}: {', '.join(SENSORS)}"
        )
    uri = read.uri if isinstance(read.uri, str) else read.uri.get(robot, "")
    return CrazyflieDriver(robot, uri, platform, read)


class CrazyflieDriver:
    """Talks to the drone at `uri`. It implements `StateDisplay`, to know an estop from a stop."""

    is_simulated = False
    shows_state = True

    def __init__(self, robot: str, uri: str, platform: Platform, options: CrazyflieOptions) -> None:
        """Not connected yet."""
        self._robot = robot
        self._uri = uri
        self._platform = platform
        self._options = options
        height = options.height
        if height is None:
            heights = platform.heights
            height = _DEFAULT_HEIGHT if heights is None else heights.scan_plane
        self._rules = FlightRules(
            height, options.take_off_rate, options.land_rate, options.land_after
        )
        self._flight = Flight(self._rules)
        self._gate = CommandGate()
        self._sink: Sink = NullSink()
        self._link: DroneLink | None = None
        self._state: State | None = None  # by the daemon
        self._seq = 0
        self._told = ""
        # A drone with an estimate in a shared frame has other means than the Flow deck.
        self._needed_decks = [
            name for name in _DECKS if name != "bcFlow2" or not options.pose_frame
        ]
        self._forget()

    async def run(self, sink: Sink) -> None:
        """Feed the sink until cancelled; a drone that was commanded lands on the way out."""
        if not has_cflib():
            raise ConfigError(MISSING)
        if not self._uri:
            raise ConfigError(
                f"driver {NAME}: uri has no address of robot {self._robot}; expected a value such"
                " as radio://0/80/2M/E7E7E7E7E7"
            )
        self._sink = sink
        sink.state(False, f"nothing heard yet from {self._uri}")
        while True:
            text = await self._connection()
            self._close_gate(text)
            await asyncio.sleep(RETRY_PERIOD)

    def send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Take a safe command; it is sent at once as a set-point, and repeated each PERIOD."""
        command = self._gate.filter(twist)
        if command is None:
            return
        self._command = command, is_stopped, time.monotonic()
        self._step()

    def show(self, status: Status | None, motion: Motion | None, pose: ShownPose | None) -> None:
        """Take the state of the robot."""
        if status is not None:
            self._state = status.state

    async def check(self, seconds: float) -> tuple[Finding, ...]:
        """Whether the drone answers, and what it reports; sends no set-point."""
        if not has_cflib():
            return (Finding("library", False, "cflib is not installed", MISSING),)
        heard = _LastInputs()
        connecting = asyncio.create_task(self.run(heard))
        try:
            async with asyncio.timeout(seconds):
                while not connecting.done() and not self._has_reported_all(heard):
                    await asyncio.sleep(PERIOD)
        except TimeoutError:
            pass  # the findings name what is missing
        supervisor = self._supervisor
        volts = self._volts
        decks = self._deck_fault()
        estimate = self._estimate_fault(time.monotonic())
        connecting.cancel()
        await asyncio.gather(connecting, return_exceptions=True)
        nothing = f"none from {self._uri}: {heard.text}"
        remedy = "switch the drone on, and check the radio and driver_options.uri"
        findings = [
            Finding(kind, kind in heard.last, "heard" if kind in heard.last else nothing, remedy)
            for kind in ("scan", "odometry")
        ]
        if supervisor is None:
            return (*findings, Finding("supervisor", False, nothing, remedy))
        findings += [
            Finding("decks", not decks, decks or "found", _DECK_REMEDY),
            Finding("estimate", not estimate, estimate or "rests", _FLOOR_REMEDY),
        ]
        is_charged = volts >= self._options.low_battery
        battery = Finding("battery", is_charged, f"{volts:.2f} V", "charge the battery")
        return (*findings, _supervisor_finding(supervisor), battery)

    def _has_reported_all(self, heard: _LastInputs) -> bool:
        """True once scan, odometry, hazards, the supervisor and the decks have come, at rest.

        Hazards alone do not show that the supervisor has reported: before the supervisor's first
        report the driver reports the hazard NOT_HEARD.
        """
        has_inputs = {"scan", "odometry", "hazards"} <= set(heard.last)
        has_decks = self._decks.keys() >= set(self._needed_decks)
        is_well = has_decks and not self._estimate_fault(time.monotonic())
        return has_inputs and self._supervisor is not None and is_well

    # The connection

    async def _connection(self) -> str:
        """Connect to the drone, and serve the drone until the connection ends; returns the cause.

        When cancelled, lands a drone that was commanded.
        """
        loop = asyncio.get_running_loop()
        opened = loop.create_future()
        lost = loop.create_future()
        self._forget()
        self._flight = Flight(self._rules)

        # The threads of cflib call back; `post` brings their calls into the loop.
        def post(take: object, *values: object) -> None:
            with contextlib.suppress(RuntimeError):  # the loop is closed
                loop.call_soon_threadsafe(take, *values)  # type: ignore[arg-type]

        def settle(future: asyncio.Future[str], text: str) -> None:
            if not future.done():
                future.set_result(text)

        link = DroneLink(
            self._uri,
            lambda: post(settle, opened, ""),
            lambda text: post(settle, lost, text),
            lambda name, stamp, values: post(self._take, link, name, stamp, values),
        )
        self._link = link
        try:
            # `link.open` only begins to connect; then `opened` or `lost` gets a result.
            opening = call_in_thread(link.open)
            await asyncio.wait(
                {opened, lost}, timeout=CONNECT_TIMEOUT, return_when=asyncio.FIRST_COMPLETED
            )
            if opening.done():
                opening.result()  # raises what `open` has raised
            if not opened.done():
                return lost.result() if lost.done() else f"{self._uri} does not answer"
            return await self._serve(lost)
        except asyncio.CancelledError:
            if self._gate.end():  # the drone was commanded
                await self._land(lost)
            raise
        finally:
            self._gate.end()
            self._link = None
            await asyncio.wait({call_in_thread(link.close)}, timeout=CLOSE_TIMEOUT)

    async def _serve(self, lost: asyncio.Future[str]) -> str:
        """Send set-points each PERIOD until the connection ends; returns why it ended.

        `lost`: gets a result when cflib loses the link. A drone that is silent for SILENCE_TIMEOUT
        counts as lost. Its link stays open until REOPEN_TIMEOUT: the drone may be heard again.
        """
        self._heard = time.monotonic()
        while not lost.done():
            await asyncio.wait({lost}, timeout=PERIOD)
            now = time.monotonic()
            silence_s = now - self._heard
            if self._gate.is_open and silence_s > SILENCE_TIMEOUT:
                self._close_gate(f"no log data from {self._uri} for {SILENCE_TIMEOUT:g} s")
            if silence_s > REOPEN_TIMEOUT:
                return f"no log data from {self._uri} for {REOPEN_TIMEOUT:g} s"
            self._tell_status(now)
            self._step()
        return str(lost.result())

    async def _land(self, lost: asyncio.Future[str]) -> None:
        """Land the drone, and send the last set-point: motors off.

        A drone that is in the air after LAND_TIMEOUT is told to land by itself.
        """
        deadline = time.monotonic() + LAND_TIMEOUT
        while not lost.done() and time.monotonic() < deadline:
            setpoint = self._put_step(Wish.LAND, ZERO)
            # On the ground the step sends "motors off", or sends nothing to a silent drone.
            is_told = setpoint is not None or self._seen().is_flying is None
            if self._flight.phase is Phase.GROUND and is_told:
                break
            await asyncio.sleep(PERIOD)
        await asyncio.sleep(2.0 * PERIOD)  # until the last set-point is on its way
        if self._flight.phase is not Phase.GROUND and self._link is not None:
            landing = call_in_thread(partial(self._link.land, self._flight.descent_time))
            await asyncio.wait({landing}, timeout=2.0 * PERIOD)
            await asyncio.sleep(PERIOD)

    def _close_gate(self, text: str) -> None:
        """Drop commands from now on, and report in `text` why the drone counts as lost."""
        self._gate.close(time.monotonic())
        self._sink.state(False, text)
        self._told = text

    def _forget(self) -> None:
        """Forget what the drone reported, and what was to be sent to it."""
        self._command = ZERO, False, -math.inf  # twist, is_stopped, when
        self._sending: asyncio.Future[None] | None = None
        self._waiting: HoverSetpoint | None = None
        self._supervisor: int | None = None  # bits of the drone's supervisor, such as CAN_FLY
        self._volts = math.nan
        self._supervisor_at = -math.inf
        self._ranges_at = -math.inf
        self._height_at = -math.inf
        self._heard = -math.inf
        self._volts_low_since = math.inf
        self._height = 0.0
        self._is_clear = False
        self._speed = 0.0  # m/s, of the state estimate
        self._rests_since = math.inf  # the state estimate, on the floor
        self._decks: dict[str, float] = {}
        self._hazards: tuple[Hazard, ...] = (_NOT_HEARD,)
        self._laps = 0
        self._newest = 0

    # Inputs

    def _take(self, link: DroneLink, name: str, stamp_ms: int, values: Mapping[str, float]) -> None:
        if link is not self._link:  # of an earlier connection
            return
        if not all(math.isfinite(value) for value in values.values()):
            self._sink.dropped(name)
            return
        if name == "deck":
            self._decks |= values
            return
        now = time.monotonic()
        self._heard = now
        if not self._gate.is_open:
            self._gate.open()
            self._sink.state(True, self._text())
            self._hazards = (_NOT_HEARD,)  # until the supervisor's first report
            self._sink.take(HazardsInput(self._hazards))
        stamp = self._stamp(stamp_ms)
        if name == "ranges":
            self._take_ranges(stamp, values, now)
        elif name == "state":
            self._take_state(stamp, values, now)
        else:
            self._take_status(values, now)

    def _stamp(self, stamp_ms: int) -> float:
        """The stamp in s; the drone's counter starts again after 4.7 hours."""
        if stamp_ms < self._newest - _STAMP_PERIOD // 2:
            self._laps += 1
            self._newest = stamp_ms
        self._newest = max(self._newest, stamp_ms)
        return 1e-3 * (self._laps * _STAMP_PERIOD + stamp_ms)

    def _take_ranges(self, stamp: float, values: Mapping[str, float], now: float) -> None:
        spec = self._platform.scan
        ranges = ranges_of(values, spec.range_min, spec.range_max)
        self._is_clear = bool((ranges >= self._options.clear).all())
        self._ranges_at = now
        self._seq += 1
        scan = Scan(self._seq, stamp, ranges, spec.bearings, spec.range_min, spec.range_max)
        self._sink.take(ScanInput(scan))

    def _take_state(self, stamp: float, values: Mapping[str, float], now: float) -> None:
        x, y, z, vx, vy, yaw_deg = (
            values[f"stateEstimate.{name}"] for name in ("x", "y", "z", "vx", "vy", "yaw")
        )
        yaw = wrap(math.radians(yaw_deg))
        c = math.cos(yaw)
        s = math.sin(yaw)
        turn_rate = 1e-3 * values["stateEstimateZ.rateYaw"]
        twist = Twist(c * vx + s * vy, turn_rate, c * vy - s * vx)
        pose = Pose(x, y, yaw)
        self._height = z
        self._height_at = now
        self._speed = math.hypot(vx, vy)
        if self._speed > REST_SPEED or abs(z) > LANDED_HEIGHT:
            self._rests_since = math.inf
        self._rests_since = min(self._rests_since, now)
        self._sink.take(OdometryInput(Odometry(stamp, pose, twist)))
        options = self._options
        if options.pose_frame:
            yaw_error = math.radians(options.pose_yaw_error_deg)
            shared = SharedPose(stamp, pose, options.pose_error, yaw_error, options.pose_frame)
            self._sink.take(PoseInput(shared))

    def _take_status(self, values: Mapping[str, float], now: float) -> None:
        self._supervisor = int(values["supervisor.info"])
        self._supervisor_at = now
        self._volts = values["pm.vbat"]
        if self._volts >= self._options.low_battery:
            self._volts_low_since = math.inf
        elif self._volts_low_since == math.inf:
            self._volts_low_since = now
        empty, full = self._options.battery_volts
        battery = min(max((self._volts - empty) / (full - empty), 0.0), 1.0)
        self._sink.take(ReadingsInput({BATTERY: battery, "height": self._height}))
        self._tell_hazards(_hazards(self._supervisor))

    def _tell_hazards(self, hazards: tuple[Hazard, ...]) -> None:
        if hazards != self._hazards:
            self._hazards = hazards
            self._sink.take(HazardsInput(hazards))

    # Outputs

    def _text(self) -> str:
        flight = self._flight
        text = f"{self._uri}: {flight.phase}"
        return f"{text}; {flight.text}" if flight.text else text

    def _tell_status(self, now: float) -> None:
        """Tell the phase of the flight if it has changed, and a silent supervisor."""
        if not self._gate.is_open:
            return
        if now - self._supervisor_at > SILENCE_TIMEOUT:
            self._tell_hazards((_NOT_HEARD,))
        text = self._text()
        if text != self._told:
            self._told = text
            self._sink.state(True, text)

    def _seen(self) -> Seen:
        now = time.monotonic()
        info = self._supervisor if now - self._supervisor_at <= SILENCE_TIMEOUT else None
        return Seen(
            height=self._height if now - self._height_at <= SILENCE_TIMEOUT else None,
            is_flying=None if info is None else bool(info & IS_FLYING),
            may_fly=info is not None and bool(info & CAN_FLY) and not _hazards(info),
            is_unarmed=info is not None and _is_unarmed(info),
            fault=self._deck_fault() or self._estimate_fault(now),
            is_clear=self._is_clear and now - self._ranges_at <= SILENCE_TIMEOUT,
            is_battery_low=now - self._volts_low_since >= LOW_BATTERY_TIME,
        )

    def _deck_fault(self) -> str:
        """Which deck is missing, or not heard yet; empty if all are there."""
        for name in self._needed_decks:
            if name not in self._decks:
                return f"the parameter deck.{name} is not heard yet"
            if not self._decks[name]:
                return f"no {_DECKS[name]}: deck.{name} is 0"
        return ""

    def _estimate_fault(self, now: float) -> str:
        """Why the state estimate is not that of a standing drone; empty if it is."""
        if now - self._height_at > SILENCE_TIMEOUT:
            return "the state estimate is not heard"
        if now - self._rests_since >= REST_TIME:
            return ""
        return (
            f"the state estimate has not rested for {REST_TIME:g} s: {self._speed:.2f} m/s at"
            f" {self._height:.2f} m; expected at most {REST_SPEED:g} m/s at {LANDED_HEIGHT:g} m"
        )

    def _wish(self) -> tuple[Wish, Twist]:
        twist, is_stopped, since = self._command
        if self._state is State.ESTOPPED:
            return Wish.LAND, ZERO
        is_late = time.monotonic() - since > COMMAND_TIMEOUT
        if is_late or not self._gate.is_open:
            return Wish.WAIT, ZERO
        if is_stopped:
            return Wish.HOVER, ZERO
        wants = self._state is State.RUNNING or not twist.is_zero
        return (Wish.FLY, twist) if wants else (Wish.HOVER, ZERO)

    def _step(self) -> None:
        if self._gate.has_sent:  # a check sends nothing
            self._put_step(*self._wish())

    def _put_step(self, wish: Wish, twist: Twist) -> HoverSetpoint | None:
        """Step the flight, and send its set-point; returns the set-point."""
        setpoint = self._flight.step(time.monotonic(), wish, twist, self._seen())
        if setpoint is not None:
            self._put(setpoint)
        return setpoint

    def _put(self, setpoint: HoverSetpoint) -> None:
        """Send a set-point on a thread; it replaces a set-point that waits for the one before."""
        link = self._link
        if link is None:
            return
        if self._sending is not None and not self._sending.done():
            self._waiting = setpoint
            return
        self._waiting = None
        self._sending = call_in_thread(partial(link.send, setpoint))
        self._sending.add_done_callback(self._on_sent)

    def _on_sent(self, sending: asyncio.Future[None]) -> None:
        if not sending.cancelled():
            sending.exception()  # the callback of a lost link reports it
        if sending is not self._sending:  # of an earlier connection
            return
        waiting = self._waiting
        self._waiting = None
        if waiting is not None:
            self._sending = None
            self._put(waiting)


def _is_unarmed(info: int) -> bool:
    """True if the drone can be armed and is not; older firmware reports neither."""
    return bool(info & CAN_BE_ARMED) and not info & IS_ARMED


def _hazards(info: int) -> tuple[Hazard, ...]:
    """The hazards of `supervisor.info`."""
    return tuple(hazard for bit, hazard in _HAZARDS.items() if info & bit)


def _supervisor_finding(info: int) -> Finding:
    """The finding of a check on `supervisor.info`: a fault, or whether the drone can fly."""
    hazards = ", ".join(hazard.text for hazard in _hazards(info))
    remedy = "turn the drone upright, restart it"
    if hazards:
        return Finding("supervisor", False, hazards, remedy)
    if _is_unarmed(info):  # no fault: the drone waits on the ground until it is armed
        return Finding("supervisor", True, NOT_ARMED, remedy)
    can_fly = bool(info & CAN_FLY)
    return Finding("supervisor", can_fly, "ready to fly" if can_fly else "not ready to fly", remedy)


class _LastInputs(NullSink):
    """A sink that keeps the newest input of each kind, and the last state."""

    def __init__(self) -> None:
        self.last: dict[str, object] = {}
        self.text = ""

    def take(self, input: object) -> None:
        self.last[tag_of(input)] = input  # type: ignore[arg-type]

    def state(self, is_up: bool, text: str, **_: object) -> None:
        self.text = text
