"""The daemon owns the loop and connects driver, bus, pattern host and robot.

It starts in this order: pattern host (before Zenoh opens), robot and tick, network, claim of the
id, the latches of its peers, requests, and the driver last, since the base may belong to another
daemon until the id is claimed. Every exit path commands zero.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import os
import secrets
import signal
import socket
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

from msgspec.structs import replace

from swarmd.core.clock import ClockSample, boottime, clock_id
from swarmd.core.codec import decode_value, encode, encode_value
from swarmd.core.errors import CodecError, SwarmError
from swarmd.core.kernels import describe_kernels
from swarmd.core.messages import Latch, Reply, Request, Status
from swarmd.core.values import ZERO, Neighbor, PeerPlace, Twist
from swarmd.daemon.driver_factory import make_driver
from swarmd.daemon.driver_sink import DriverSink
from swarmd.daemon.latchfile import LatchFile
from swarmd.daemon.network import Network, NetworkHandlers
from swarmd.daemon.recorded_robot import RecordedRobot
from swarmd.daemon.recording_service import RecordingService
from swarmd.daemon.request_server import RequestServer
from swarmd.daemon.systemd import Notifier
from swarmd.daemon.tick_timer import TickTimer
from swarmd.daemon.usage import UsageMeter
from swarmd.driver_api.driver import Driver, check_protected, message_carrier
from swarmd.driver_api.hw_codec import encode_scan
from swarmd.network.bus import ZenohBus
from swarmd.network.datagram import Address, Message, Stop
from swarmd.network.interface_watch import InterfaceChange
from swarmd.network.peer import Summary
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.plugins import pattern_names
from swarmd.protection.compatibility import body_of
from swarmd.recording import frames
from swarmd.recording.head import RecordingHead
from swarmd.robot.actions import Actions
from swarmd.robot.lifecycle import RobotSettings
from swarmd.settings.driver_options import IdleOutputFilter, base_options
from swarmd.settings.settings import DaemonSettings

log = logging.getLogger(__name__)

DRIVER_RETRY_PERIOD = 1.0
NEIGHBORS_PERIOD = 10  # ticks
USAGE_PERIOD = 20  # ticks
MOTION_PERIOD = 2  # ticks


async def serve(settings: DaemonSettings) -> int:
    """Run until SIGTERM, SIGINT or SIGHUP; 0 after a clean stop. Raises SwarmError."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    is_nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    for number in (signal.SIGTERM, signal.SIGINT, *(() if is_nohup else (signal.SIGHUP,))):
        loop.add_signal_handler(number, stop.set)
    daemon = Daemon(settings, make_driver(settings))
    await daemon.run(stop)
    return 0


class Daemon:
    """One robot's daemon; `run` is its whole life. `sink` takes what the driver measures."""

    def __init__(self, settings: DaemonSettings, driver: Driver) -> None:
        check_protected(settings.platform, driver, settings.driver)
        self._settings = settings
        self._driver = driver
        self._carrier = message_carrier(driver)
        base = base_options(settings.driver_options, f"driver {settings.driver}")
        self._idle = IdleOutputFilter(base.idle_output)
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._on_crash)
        self._crash: BaseException | None = None
        self._crashed = asyncio.Event()
        self._instance = secrets.token_hex(6)
        self._seed = secrets.randbits(48)
        self._notify = Notifier()
        self._latches = LatchFile(settings.state_dir / settings.network.swarm / settings.id)
        self._runner = ProcessRunner(self._loop, settings.plugin_dir, self._on_host_events)
        self._network = Network(
            settings.network,
            settings.id,
            self._instance,
            settings.roster,
            NetworkHandlers(
                summary=self._summary,
                on_stop=self._on_stop,
                on_latches=self._on_latches,
                on_message=self._on_message,
                on_place=self._on_place,
                on_clock=self._on_clock,
                on_members=self._update_neighbors,
                on_duplicate=self._on_duplicate,
                on_interface=self._on_interface,
                on_event=self._on_network_event,
                serve=self._serve,
            ),
            version=version("swarmd"),
            body=body_of(settings.platform),
        )
        self._has_joined = False
        self._recording = RecordingService(
            settings.id,
            settings.recording,
            self._head,
            self._on_network_event,
            self._network.drop,
        )
        self._requests = RequestServer(
            settings.id,
            self._on_request,
            self._on_audit,
            forget=self._network.forget,
            record=self._recording.answer,
        )
        self._usage, self._pattern_usage = UsageMeter(), UsageMeter()
        self._ticks = 0
        self._shown_scan = -1  # sequence of the last scan for viewers
        self._robot = RecordedRobot(
            settings.id,
            settings.platform,
            RobotSettings(
                driver=settings.driver,
                layers=settings.pattern_layers,
                host=socket.gethostname(),
                profile=settings.network.profile,
                version=version("swarmd"),
                kernels=describe_kernels(),
                labels=settings.labels,
                touch=settings.touch_zones,
                accepts=settings.accepts,
            ),
            seed=self._seed,
            instance=self._instance,
            now=boottime(),
            latches=self._latches.read(),
            recorder=self._recording.recorder,
        )
        self.sink = DriverSink(self._robot, self._carry_out)
        self._timer = TickTimer(self._loop, self._on_tick)

    async def run(self, stop: asyncio.Event) -> None:
        """Serve until `stop` is set. Raises SwarmError without a network or if the id is held."""
        living = asyncio.create_task(self._live())
        ends = {living, *(asyncio.create_task(e.wait()) for e in (stop, self._crashed))}
        try:
            await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if living.done():
                error = living.exception()
                if not isinstance(error, SwarmError):
                    self._crash = self._crash or error
                living.result()
            if self._crash is not None:
                raise self._crash
        finally:
            self._notify("STOPPING=1")
            if not self._has_joined:
                await _end(living)  # it is still joining
            try:
                self._leave()
            finally:
                for end in ends:
                    await _end(end)
        if self._crash is not None:  # while it was leaving
            raise self._crash

    # Start and end

    async def _live(self) -> None:
        self._recording.start_if_wanted()  # before any input, so that a replay has all of them
        await self._join()
        gc.collect()
        gc.freeze()
        self._notify("READY=1")
        if text := self._network.interface_text:
            self._notify.status(text)
        log.info("ready in swarm %s as %s", self._settings.network.swarm, self._instance)
        await self._drive()  # only now the base belongs to this daemon

    async def _drive(self) -> None:
        """Run the driver; one that raises is started again."""
        while True:
            try:
                await self._driver.run(self.sink)
            except SwarmError as error:
                log.warning("driver %s: %s", self._settings.driver, error)
                self.sink.state(False, str(error))
            await asyncio.sleep(DRIVER_RETRY_PERIOD)

    def _on_crash(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """A callback of the daemon raised: command zero and end the daemon."""
        loop.default_exception_handler(context)
        self._crash = self._crash or context.get("exception") or RuntimeError(context["message"])
        self._crashed.set()
        self._send(ZERO, -1, -1)

    def _send(
        self, twist: Twist, scan_seq: int, requested_scan_seq: int, *, is_stopped: bool = False
    ) -> None:
        """Hand a command to the driver; one that raises ends the daemon after all else is done."""
        try:
            self._driver.send(twist, scan_seq, requested_scan_seq, is_stopped=is_stopped)
        except Exception as error:  # a driver may raise anything
            log.exception("driver %s: a command could not be sent", self._settings.driver)
            self._crash = self._crash or error
            self._crashed.set()

    async def _join(self) -> None:
        if self._settings.network.profile == "field":
            log.warning("no certificates: anyone on this network can drive this robot")
        await self._network.join()
        self._has_joined = True
        self._update_neighbors()

    def _serve(self, bus: ZenohBus) -> None:
        """Answer requests on a bus that was opened, the first one or a later one."""
        self._requests.serve(bus, ("reset", "param", "forget", "record", "run", "reload"))
        self._recording.serve(bus)
        bus.serve_view(
            self._status,
            lambda: tuple(self._network.members.values()),
            self._settings.roster,
        )

    def _leave(self) -> None:
        """Command zero, tell the peers and close; the driver's own exit sends zero once more.

        After a crash the last beacon is not sent, so that the peers list the robot as failed.
        """
        self._timer.stop()
        self._send(ZERO, -1, -1)
        try:
            if self._crash is None:
                self._carry_out(self._robot.on_leave(boottime()))
                self._timer.stop()
        finally:
            self._recording.close()
            self._runner.close()
            self._network.close(is_leaving=self._crash is None)

    # Inputs from the network

    def _on_request(self, request: Request) -> None:
        self._carry_out(self._robot.on_request(request, boottime()))

    def _on_audit(self, line: str) -> None:
        log.info("%s", line)
        self._robot.log(line, boottime())

    def _on_stop(self, stop: Stop, source: Address, answer: Callable[[Reply], None]) -> None:
        self._requests.stop(stop, f"{source[0]}:{source[1]}", answer)

    def _on_latches(self, latches: Mapping[str, Latch]) -> None:
        before = self._robot.state
        self._carry_out(self._robot.on_latches(latches, boottime()))
        if self._robot.state is not before:
            text = self._robot.status(boottime()).detail
            log.info("estopped by the latch of a peer: %s", text)

    def _on_message(self, message: Message) -> None:
        try:
            value = decode_value(message.payload)
            is_accepted = self._robot.on_message(message.robot, message.channel, value, boottime())
        except CodecError:
            self._network.drop("msg:malformed")
            return
        if not is_accepted:
            self._network.drop("msg:not_a_neighbor")

    def _on_place(self, place: PeerPlace) -> None:
        self._robot.on_peer_place(place, boottime())

    def _on_clock(self, sample: ClockSample) -> None:
        self._recording.recorder.add(frames.ClockEntry(boottime(), *sample))

    def _on_duplicate(self, holder: str | None) -> None:
        if holder is not None:
            log.error("id %s is also held by %s", self._robot.id, holder)
        self._carry_out(self._robot.on_duplicate(holder, boottime()))

    def _on_interface(self, change: InterfaceChange) -> None:
        """Tell of a change of the interface; with another address the robot stands."""
        log.warning("%s", change.line)
        self._notify.status(change.line)
        if change.must_reopen:
            self._carry_out(self._robot.on_network_changed(change.line, boottime()))
        else:
            self._robot.log(change.line, boottime())

    def _on_network_event(self, text: str) -> None:
        log.warning("%s", text)
        self._robot.log(text, boottime())

    def _update_neighbors(self) -> None:
        """Tell the robot of the members, its neighbors unless the driver measures those."""
        self._robot.on_peers(self._network.bodies, boottime())
        if not self._has_joined or self.sink.has_neighbors:
            return
        alive = tuple(Neighbor(robot, 0.0) for robot in sorted(self._network.alive))
        self._robot.on_neighbors(alive, boottime())

    def _summary(self) -> Summary:
        robot = self._robot
        return Summary(robot.state, robot.epoch.revision, robot.latches)

    # Ticks and actions

    def _on_tick(self) -> None:
        self._ticks += 1
        self._carry_out(self._robot.tick(boottime()))
        self._network.advance()
        if self._recording.recorder.is_on:
            self._network.ask_clocks()
        if told := self._robot.pose_to_tell(boottime()):
            self._network.publish_pose(*told)
        if self._ticks % MOTION_PERIOD == 0:
            self._publish_motion()
        if self._ticks % USAGE_PERIOD == 0:
            self._usage.measure(os.getpid(), boottime())
            self._pattern_usage.measure(self._runner.pid, boottime())
        if self._ticks % NEIGHBORS_PERIOD == 0:
            self._update_neighbors()
            if self._notify.pings:
                self._notify("WATCHDOG=1")

    def _publish_motion(self) -> None:
        motion, scan = self._robot.motion(boottime()), self._robot.scan
        if motion is not None:
            self._network.publish("motion", lambda: encode(motion))
        if scan is not None and scan.seq != self._shown_scan:
            self._shown_scan = scan.seq
            self._network.publish("scan", lambda: encode_scan(scan))

    def _on_host_events(self) -> None:
        for event in self._runner.events():
            self._carry_out(self._robot.on_host(event, boottime()))

    def _carry_out(self, actions: Actions) -> None:
        if self._idle.allows(actions.twist, actions.is_idle, boottime()):
            self._send(
                actions.twist,
                actions.decision.scan_seq,
                actions.requested_scan_seq,
                is_stopped=actions.is_stopped,
            )
        if actions.is_quiet:
            return
        is_stored = actions.latches is None or self._latches.write(actions.latches)
        for command in (actions.trial, actions.host):
            if command is not None:
                self._runner.send(command)
        for name, value in actions.messages.items():
            try:
                payload = encode_value(value)
            except CodecError as error:
                log.debug("message on %s not sent: %s", name, error)
                self._network.drop(f"msg/{name}:unsendable")
                continue
            if self._carrier is None:
                self._network.publish_message(name, payload)
            else:
                self._carrier.send_message(name, payload)
        if actions.status is not None:
            self._network.publish("status", lambda: encode(self._status()))
        for reply in actions.replies:
            self._requests.reply(reply, is_stored=is_stored)
        wake_at = self._robot.wake_at(boottime())
        self._timer.wake_in(None if wake_at is None else wake_at - boottime())

    def _status(self) -> Status:
        status = self._robot.status(boottime())
        frames = {"host/frames": self._runner.dropped} if self._runner.dropped else {}
        dropped = {
            **status.health.dropped,
            **self._network.dropped,
            **self.sink.drops,
            **frames,
        }
        health = replace(
            status.health,
            loop_p99=self._timer.p99,
            loop_stalls=self._timer.stalls,
            dropped=dropped,
            network=self._network.interface_text,
            usage=self._usage.usage,
            pattern_usage=self._pattern_usage.usage,
        )
        return replace(status, health=health, recording=self._recording.summary)

    def _head(self) -> RecordingHead:
        """What recordings tell of this robot."""
        settings = self._settings
        layers = {
            name: settings.pattern_layers(name) for name in pattern_names(settings.plugin_dir)
        }
        return RecordingHead(
            robot=settings.id,
            swarm=settings.network.swarm,
            driver=settings.driver,
            clock=clock_id(),
            instance=self._instance,
            seed=self._seed,
            version=version("swarmd"),
            kernels=describe_kernels(),
            platform=settings.platform,
            labels=settings.labels,
            layers={name: values for name, values in layers.items() if values},
            touch=settings.touch_zones,
            accepts=settings.accepts,
            revision=self._robot.epoch.revision,
            generation=self._robot.generation,
            latches=self._robot.latches,
            cleared=self._robot.cleared,
        )


async def _end(task: asyncio.Task[Any]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
