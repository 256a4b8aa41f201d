"""The daemon owns the loop and connects driver, bus, pattern host and robot.

It starts in this order: pattern host (before Zenoh opens), robot and tick, network, claim of the
id, emergency stop, the latches of its peers, `run`, and the driver last, since the base may belong
to another daemon until the id is claimed. Every exit path commands zero.
"""

from __future__ import annotations

import asyncio
import gc
import logging
import secrets
import signal
import socket
from contextlib import suppress
from functools import partial
from importlib.metadata import version
from typing import Any

from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder, decode_value, encode, encode_value
from swarmd.core.errors import CodecError, SwarmError
from swarmd.core.keys import Key
from swarmd.core.messages import Presence, Request, Status
from swarmd.core.values import ZERO, Neighbor, Twist
from swarmd.daemon.driver_factory import make_driver
from swarmd.daemon.driver_sink import DriverSink
from swarmd.daemon.latchfile import LatchFile
from swarmd.daemon.request_server import RequestServer
from swarmd.daemon.systemd import Notifier
from swarmd.daemon.tick_timer import TickTimer
from swarmd.driver_api.driver import Driver, check_protected
from swarmd.network.bus import ZenohBus
from swarmd.network.claim import Claim, claim_id
from swarmd.network.session import open_in_thread, open_session
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.robot.actions import Actions
from swarmd.robot.lifecycle import RobotSettings
from swarmd.robot.robot import Robot
from swarmd.settings.driver_options import IdleOutputFilter, base_options
from swarmd.settings.settings import DaemonSettings

log = logging.getLogger(__name__)

PEER_STATUS_TIMEOUT = 0.5
DRIVER_RETRY_PERIOD = 1.0
NEIGHBORS_PERIOD = 10  # ticks


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
        base = base_options(settings.driver_options, f"driver {settings.driver}")
        self._idle = IdleOutputFilter(base.idle_output)
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._on_crash)
        self._crash: BaseException | None = None
        self._crashed = asyncio.Event()
        self._instance = secrets.token_hex(6)
        self._notify = Notifier()
        self._latches = LatchFile(settings.state_dir / settings.network.swarm / settings.id)
        self._runner = ProcessRunner(self._loop, settings.plugin_dir, self._on_host_events)
        self._bus: ZenohBus | None = None
        self._claim: Claim | None = None
        self._requests = RequestServer(settings.id, self._on_request, self._on_audit)
        self._ticks = 0
        self._status = Decoder(Status)
        self._robot = Robot(
            settings.id,
            settings.platform,
            RobotSettings(
                driver=settings.driver,
                layers=settings.pattern_layers,
                host=socket.gethostname(),
                profile=settings.network.profile,
                version=version("swarmd"),
                labels=settings.labels,
                touch=settings.touch_zones,
            ),
            seed=secrets.randbits(48),
            instance=self._instance,
            now=boottime(),
            latches=self._latches.read(),
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
            if self._claim is None:
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
        await self._join()
        gc.collect()
        gc.freeze()
        self._notify("READY=1")
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
        settings = self._settings
        network = settings.network
        if network.profile == "field":
            log.warning("no certificates: anyone on this network can drive this robot")
        self._session = await open_in_thread(partial(open_session, network))
        self._bus = bus = ZenohBus(self._session, swarm=network.swarm, robot=settings.id)
        self._claim = await claim_id(
            self._session,
            swarm=network.swarm,
            robot=settings.id,
            instance=self._instance,
            settle=network.settle,
            lease=network.lease_seconds,
            on_duplicate=self._on_duplicate,
        )
        self._requests.serve(bus, ("estop", "stop", "reset", "param", "forget"))
        bus.serve_view(lambda: self._with_health(self._robot.status(boottime())), settings.roster)
        bus.on_status(self._on_peer_status)
        bus.listen("msg", "*/*", self._on_message)
        bus.on_member(lambda member: self._update_neighbors())
        for robot, payload in await bus.ask("state", "status", timeout=PEER_STATUS_TIMEOUT):
            with suppress(CodecError):  # the bus counts the malformed statuses that are published
                status = self._status(payload)
                if status.robot == robot:
                    self._on_peer_status(status)
        self._requests.serve(bus, ("run", "reload"))
        self._update_neighbors()
        self._publish(self._robot.status(boottime()))

    def _leave(self) -> None:
        """Command zero, publish `left` and close; the driver's own exit sends zero once more.

        After a crash `left` is not published, so that the peers list the robot as failed.
        """
        self._timer.stop()
        self._send(ZERO, -1, -1)
        try:
            if self._crash is None:
                self._carry_out(self._robot.on_leave(boottime()))
                self._timer.stop()
                self._publish_left()
        finally:
            self._runner.close()
            if self._bus is not None:
                if self._claim is not None:
                    self._claim.release()
                self._bus.close()
                self._session.close()

    def _publish_left(self) -> None:
        self._publish(replace(self._robot.status(boottime()), has_left=True))

    # Inputs from the network

    def _on_request(self, request: Request) -> None:
        self._carry_out(self._robot.on_request(request, boottime()))

    def _on_audit(self, line: str) -> None:
        log.info("%s", line)
        self._robot.log(line, boottime())

    def _on_peer_status(self, status: Status) -> None:
        if status.latches:
            self._carry_out(self._robot.on_latches(status.latches, boottime()))

    def _on_message(self, key: Key, payload: bytes) -> None:
        assert self._bus is not None
        try:
            value = decode_value(payload)
            is_accepted = self._robot.on_message(key.robot, key.name, value, boottime())
        except CodecError:
            self._bus.drop("msg:malformed")
            return
        if not is_accepted:
            self._bus.drop("msg:not_a_neighbor")

    def _on_duplicate(self, instance: str) -> None:
        log.error("id %s is also held by instance %s", self._robot.id, instance)
        self._carry_out(self._robot.on_duplicate(f"instance {instance}", boottime()))

    def _update_neighbors(self) -> None:
        """Unless the driver measures neighbors, every living member is one."""
        if self._bus is None or self.sink.has_neighbors:
            return
        alive = tuple(
            Neighbor(member.robot, 0.0)
            for member in self._bus.members.values()
            if member.presence is Presence.ALIVE
        )
        self._robot.on_neighbors(alive, boottime())

    # Ticks and actions

    def _on_tick(self) -> None:
        self._ticks += 1
        self._carry_out(self._robot.tick(boottime()))
        if self._ticks % NEIGHBORS_PERIOD == 0:
            self._update_neighbors()
            if self._claim is not None and not self._claim.duplicates:
                self._carry_out(self._robot.on_duplicate(None, boottime()))
            if self._notify.pings:
                self._notify("WATCHDOG=1")

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
        is_stored = actions.latches is None or self._latches.write(actions.latches)
        for command in (actions.trial, actions.host):
            if command is not None:
                self._runner.send(command)
        if self._bus is not None:
            for name, value in actions.messages.items():
                try:
                    self._bus.publish("msg", name, encode_value(value))
                except CodecError as error:
                    log.debug("message on %s not sent: %s", name, error)
                    self._bus.drop(f"msg/{name}:unsendable")
        if actions.status is not None:
            self._publish(actions.status)
        for reply in actions.replies:
            self._requests.reply(reply, is_stored=is_stored)
        wake_at = self._robot.wake_at(boottime())
        self._timer.wake_in(None if wake_at is None else wake_at - boottime())

    def _publish(self, status: Status) -> None:
        if self._bus is not None and self._claim is not None:
            self._bus.publish("state", "status", encode(self._with_health(status)), express=True)

    def _with_health(self, status: Status) -> Status:
        network = {} if self._bus is None else self._bus.dropped
        frames = {"host/frames": self._runner.dropped} if self._runner.dropped else {}
        dropped = {**status.health.dropped, **network, **self.sink.drops, **frames}
        health = replace(
            status.health, loop_p99=self._timer.p99, loop_stalls=self._timer.stalls, dropped=dropped
        )
        return replace(status, health=health)


async def _end(task: asyncio.Task[Any]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
