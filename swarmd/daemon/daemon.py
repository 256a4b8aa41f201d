"""The daemon owns the loop and connects driver, network, pattern host and robot.

The order of the start: pattern host (before Zenoh opens), robot and ticks, network, claim of the
id, latches of the peers, requests, driver. The driver is last, since the base may belong to another
daemon until the id is claimed. Every exit path commands zero.
"""

from __future__ import annotations

import asyncio
import dataclasses
import gc
import logging
import math
import secrets
import signal
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from swarmd.core import events
from swarmd.core.clock import TICK, ClockSample, boottime, clock_id
from swarmd.core.codec import encode, encode_value
from swarmd.core.errors import CodecError, CoreFault, SwarmError, fail_stop
from swarmd.core.goal import Goal
from swarmd.core.messages import Reply, Status
from swarmd.core.pattern_manifest import Entry
from swarmd.core.processes import SHORT_SLICE, ask_for_slices
from swarmd.core.record import RecordKind
from swarmd.core.values import Neighbor, Value
from swarmd.core.verbs import EstopRequest, Request, StopRequest
from swarmd.daemon.audit import Audit
from swarmd.daemon.driver import DriverOutput, DriverSink, make_driver
from swarmd.daemon.driver_commands import DriverCommands
from swarmd.daemon.goal_service import GoalService
from swarmd.daemon.health import HealthMeter
from swarmd.daemon.incidents import IncidentService
from swarmd.daemon.key_permits import KeyPermits
from swarmd.daemon.neighbors import NeighborSelection
from swarmd.daemon.network import Network, NetworkRobot
from swarmd.daemon.pattern_transfer import PatternIntake, PatternPull
from swarmd.daemon.pattern_versions import PatternControl, PatternVersions, PushedRuns
from swarmd.daemon.recording import frames
from swarmd.daemon.recording.head import RecordingHead
from swarmd.daemon.recording.lost_member import LOST, LostMember
from swarmd.daemon.recording_service import RecordingService
from swarmd.daemon.requests import RequestServer, Services
from swarmd.daemon.robot_setup import configured_robot, recording_head
from swarmd.daemon.roster_service import RosterService
from swarmd.daemon.store import LatchFile, PatternFiles
from swarmd.daemon.systemd import Notifier
from swarmd.daemon.tick_timer import TickTimer
from swarmd.daemon.tools import FieldTools
from swarmd.daemon.viewer_feed import ViewerFeed
from swarmd.driver_api.command_source import command_source
from swarmd.driver_api.driver import (
    Driver,
    check_protected,
    gathering_driver,
    gripper_of,
    message_carrier,
    state_display,
)
from swarmd.link.carriers.bus import ZenohBus
from swarmd.link.carriers.inbound_queue import DropCounter
from swarmd.link.carriers.interface_watch import InterfaceChange
from swarmd.link.datagram import Address, Beacon, Stop
from swarmd.link.keys.identity import Identity
from swarmd.link.keys.key_permit import PresentRun
from swarmd.link.keys.roster_change import TakenRoster
from swarmd.link.peer import StopVerdict, Summary
from swarmd.link.settings import ONLY_HERE
from swarmd.link.signature import Author
from swarmd.link.spread.pull import Puller, serve_shared
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.robot.actions import Actions
from swarmd.robot.protection.compatibility import body_of
from swarmd.settings.driver_options import base_options, may_rest
from swarmd.settings.settings import DaemonSettings

log = logging.getLogger(__name__)

NEIGHBORS_PERIOD = 10  # ticks
USAGE_PERIOD = 20  # ticks
MOTION_PERIOD = 2  # ticks
NETWORK_PERIOD = 2  # ticks between two looks at the network without an event
STORAGE_PERIOD = 100  # ticks between two tries to write to a state folder that failed
ACTIVE_TIME = 1.0
"""Seconds after an event with 20 ticks a second, each of which looks at the network."""
SCAN_LOST = 1.0  # s after a scan without another one: the black box waits for none
_ROUTINE = (events.TickInput, events.HostInput)  # inputs on which a running robot decides
_MEASURED = (  # any input that is neither measured nor routine is an event
    events.ScanInput,
    events.RangesInput,
    events.OdometryInput,
    events.NeighborsInput,
    events.PoseInput,
    events.ReadingsInput,
    events.MessageInput,
    events.LeaseInput,
    events.PeersInput,
    events.PlaceInput,
    events.KinInput,
)
_FREQUENT = (  # after such an input an unchanged command waits for the next tick, at most 50 ms
    events.ScanInput,
    events.RangesInput,
    events.HostInput,
)


async def serve(settings: DaemonSettings) -> int:
    """Run a daemon until SIGTERM, SIGINT or SIGHUP; 0 after a clean stop. Raises SwarmError."""
    loop = asyncio.get_running_loop()
    stop = asyncio.Event()
    is_nohup = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    ask_for_slices(SHORT_SLICE)  # before any thread starts: threads inherit the setting
    for number in (signal.SIGTERM, signal.SIGINT, *(() if is_nohup else (signal.SIGHUP,))):
        loop.add_signal_handler(number, stop.set)
    driver = make_driver(settings)
    daemon = Daemon(settings, driver)
    if settings.network.profile == "dev" and not driver.is_simulated:
        log.warning("profile dev: %s", ONLY_HERE)
    await daemon.run(stop)
    return 0


class Daemon:
    """One robot's daemon; `run` is its whole life. `sink` takes the inputs of the driver."""

    def __init__(self, settings: DaemonSettings, driver: Driver) -> None:
        """Make all parts of the daemon, on the running loop; `run` opens and starts them.

        Raises ConfigError if the protection of this platform needs more than the driver gives.
        """
        check_protected(settings.platform, driver, settings.file.driver)
        self._gripper = gripper_of(driver)
        if self._gripper is None:
            settings = _without_gripper(settings)
        self._settings = settings
        self._active_until = -math.inf  # s; until then the timer ticks at the full rate
        self._loop = asyncio.get_running_loop()
        self._loop.set_exception_handler(self._on_crash)
        self._crash: BaseException | None = None  # the first error that ends the daemon
        self._crashed = asyncio.Event()
        self._begin_driver(driver)
        self._instance = secrets.token_hex(6)  # marks this life of the daemon
        self._seed = secrets.randbits(48)  # of the robot's random generator
        self._notify = Notifier()  # tells systemd that the daemon is ready, and that it is alive
        self._answers: set[asyncio.Task[None]] = set()  # replies that wait for the disk
        self._has_joined = False
        self._scan_at = -math.inf  # s; the arrival of the last scan
        self._periods = 0  # `TickTimer.periods` at the last tick
        self._provisional: tuple[int, ...] = ()  # the generations in the last ProvisionalInput
        folder = settings.state_dir / settings.network.swarm / settings.id
        # In this order, since each part uses the parts before it.
        self._begin_records(folder)
        self._begin_code(folder)
        self._begin_network()
        self._begin_requests(folder)
        self._begin_robot(driver)

    def _begin_driver(self, driver: Driver) -> None:
        """The output to the base."""
        settings = self._settings
        base = base_options(settings.driver_options, f"driver {settings.file.driver}")
        self._carrier = message_carrier(driver)
        self._may_rest = may_rest(base, driver)
        self._gathering_driver = gathering_driver(driver)
        self._output = DriverOutput(
            driver, settings.file.driver, base.idle_output, self._on_driver_crash
        )

    def _begin_records(self, folder: Path) -> None:
        """Latches, rosters and goals: records on disk that outlive the daemon."""
        settings = self._settings
        self._latches = LatchFile(folder)
        self._drops = DropCounter()
        self._rosters = RosterService(settings.id, settings.identity, self._on_roster, self._drops)
        self._goals = GoalService(folder, lambda: self._rosters.identity, self.on_event)
        self._permits = KeyPermits(
            settings.id, lambda: self._rosters.identity, lambda: self._present_run
        )
        self._puller = Puller(settings.network, settings.id, settings.identity, drops=self._drops)

    def _begin_code(self, folder: Path) -> None:
        """Pushed patterns, and the pattern host that runs them."""
        settings = self._settings
        files = PatternFiles(folder / "patterns")
        with suppress(OSError):  # a sandbox permits only folders that exist when it begins
            files.folder.mkdir(parents=True, exist_ok=True)
        swarm = settings.network.swarm
        self._pattern_versions = PatternVersions(files, settings.id, swarm, self._operators)
        self._pattern_intake = PatternIntake(self._pattern_versions, self._drops)
        self._pushed_runs = PushedRuns(self._pattern_versions)
        state = self._pattern_versions
        intake = self._pattern_intake
        self._pattern_pull = PatternPull(
            state, intake, self._puller, self._on_pulled_code, self._drops
        )
        self._pulled: dict[RecordKind, PatternPull | IncidentService] = {
            RecordKind.PATTERN: self._pattern_pull
        }
        identity = settings.identity
        self._runner = ProcessRunner(
            self._loop,
            settings.plugin_dir,
            self._on_host_events,
            self._pushed_runs.overlay,
            code=[files.folder],
            secret=[settings.state_dir, *([] if identity is None else [identity.folder])],
        )

    def _begin_network(self) -> None:
        settings = self._settings
        self._network = Network(
            settings.network,
            NetworkRobot(
                name=settings.id,
                instance=self._instance,
                roster=settings.roster,
                version=version("swarmd"),
                body=body_of(settings.platform),
            ),
            drops=self._drops,
            identity=settings.identity,
            stop_counters=self._latches.path.with_name("stops"),
            hears_programs=settings.file.neighbors.programs,
        )

    def _begin_requests(self, folder: Path) -> None:
        """Make the services of the daemon, and the server that hands requests to them."""
        settings = self._settings
        self._recording = RecordingService(
            settings.id, settings.recording, self._head, self.on_event
        )
        self._recorder = self._recording.recorder
        self._incidents = self._pulled[RecordKind.INCIDENT] = IncidentService(
            settings.id,
            folder,
            settings.blackbox,
            recorder=self._recorder,
            puller=self._puller,
            head=self._head,
            identity=lambda: self._rosters.identity,
            is_member=self._network.is_robot,
            on_event=self.on_event,
        )
        self._tools = FieldTools(
            settings,
            self._instance,
            self._network,
            version=version("swarmd"),
            keys=lambda: self._rosters.summary,
            sandbox=lambda: self._runner.sandbox,
        )
        # Each request that was answered gives a line of the log and an entry of a file. `clock`
        # names this boot of the machine; `wall` gives s since 1970.
        self._audit = Audit(
            self._on_audit,
            self._tools.audit.add,
            clock=clock_id(),
            wall=time.time,
            role_of=self._permits.role_of,
        )
        self._requests = RequestServer(
            settings.id,
            self._on_request,
            self._audit,
            Services(
                recording=self._recording,
                incidents=self._incidents,
                rosters=self._rosters,
                pushes=self._pattern_intake,
                pushed=self._pattern_pull,
                tools=self._tools,
            ),
            drops=self._drops,
            is_secured=settings.identity is not None,
            judge=self._permits.judge,
        )

    def _begin_robot(self, driver: Driver) -> None:
        """Make the robot, the sources of its inputs, and the parts that show its state.

        The inputs come from driver, neighbours and ticks. Viewer feed and health show the state.
        """
        settings = self._settings
        self._robot = configured_robot(
            settings,
            self._instance,
            self._seed,
            latches=self._latches.read(),
            goals=self._goals.read(),
        )
        self._neighborhood = NeighborSelection(
            settings.file.neighbors,
            self._robot.place_neighbors,
            self._network.heard,
            settings.network.interface_name,
            self._loop,
        )
        self.sink = DriverSink(self.step, self._neighborhood)
        if self._gathering_driver is not None:  # odometry waits until a decision needs it
            self._gathering_driver.gather(self.sink.take_late)
        self._commands: DriverCommands | None = None
        if (source := command_source(driver)) is not None:
            self._commands = DriverCommands(
                self._robot, self._requests, lambda: self._rosters.identity
            )
            source.serve(self._commands.take)
        self._viewer_feed = ViewerFeed(self._robot, self._network, state_display(driver))
        self._timer = TickTimer(self._loop, self._on_tick)
        drop_counts = (
            lambda: self._network.dropped,
            lambda: self.sink.drops,
            lambda: {"host/frames": self._runner.dropped} if self._runner.dropped else {},
        )
        self._health = HealthMeter(self._timer, drop_counts)

    async def run(self, stop: asyncio.Event) -> None:
        """Join the network and serve until `stop` is set; then command zero and close all parts.

        Raises SwarmError if the network cannot be opened or another daemon has the id. Any other
        exception is a crash: the daemon commands zero and closes all parts, then `run` raises the
        exception.
        """
        life = asyncio.create_task(self._live())
        stopped = asyncio.create_task(stop.wait())
        crashed = asyncio.create_task(self._crashed.wait())
        tasks = (life, stopped, crashed)
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            error = life.exception() if life.done() else None
            if isinstance(error, SwarmError):
                raise error
            if error is not None:
                self._crash = self._crash or _cause_of(error)
        finally:
            self._notify("STOPPING=1")
            if not self._has_joined:
                await _end(life)  # before `_leave`, which closes the network that `life` opens
            try:
                self._leave()
            finally:
                for task in tasks:
                    await _end(task)
                await self._goals.close()
                await self._pattern_versions.close()
        if self._crash is not None:  # the error occurred before or in `_leave`
            raise self._crash

    # Start and end

    async def _live(self) -> None:
        """Join the network, then run the driver until this task is cancelled."""
        self._recording.start_if_wanted()  # before any input, so that a replay has all inputs
        self._incidents.open()
        self._check_storage()
        await self._join()
        gc.collect()
        gc.freeze()
        self._notify("READY=1")
        if text := self._network.interface_text:
            self._notify.status(text)
        log.info("ready in swarm %s as %s", self._settings.network.swarm, self._instance)
        await self._output.run(self.sink)  # last, since now the base belongs to this daemon

    def _on_crash(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """After an exception in a callback of the loop: command zero and end the daemon."""
        loop.default_exception_handler(context)
        error: BaseException = context.get("exception") or RuntimeError(context["message"])
        self._crash = self._crash or _cause_of(error)
        self._crashed.set()
        self._output.send_zero()

    def _on_driver_crash(self, error: Exception) -> None:
        """After an exception in `Driver.send`: end the daemon once the present input is handled."""
        self._crash = self._crash or error
        self._crashed.set()

    async def _join(self) -> None:
        if self._settings.network.profile != "dev" and self._settings.identity is None:
            log.warning("insecure: anyone on this network can drive this robot")
        if self._settings.identity is not None:
            _warn_of_end(self._settings.identity)
        control = PatternControl(
            self._robot,
            self._runner,
            on_request=self._on_request,
            step=self.step,
            reply=self._requests.reply,
            warn=self.on_event,
        )
        await self._pattern_versions.open(control)
        await self._network.join(self)
        self._has_joined = True
        self.on_members()

    def serve(self, bus: ZenohBus) -> None:
        """Answer operators and peers on a newly opened bus."""
        self._requests.serve(bus)
        for pulled in self._pulled.values():
            pulled.serve(bus)
        bus.serve_view(
            self.status, lambda: tuple(self._network.members.values()), self._network.roster
        )
        serve_shared(bus, "roster", self._rosters.share)

    def _leave(self) -> None:
        """Command zero, announce to the peers that this robot leaves, and close all parts.

        The driver sends zero once more when it ends. After a crash the robot gets no further input
        and no farewell is sent, so that the peers list the robot as failed.
        """
        self._timer.stop()
        self._output.send_zero()
        for answer in self._answers:
            answer.cancel()
        try:
            if self._crash is None:
                self.step(events.LeaveInput())
                self._timer.stop()  # `step` has set the timer again
        finally:
            self._neighborhood.close()
            self._rosters.close()
            self._puller.close()
            self._pattern_pull.close()
            self._pattern_intake.close()
            self._incidents.close(has_crashed=self._crash is not None)
            self._recording.close()
            self._runner.close()
            self._network.close(is_leaving=self._crash is None)
            self._tools.close()

    # Inputs

    @fail_stop
    def step(self, input: events.Input, *, may_repeat: bool = True, age: float = 0.0) -> None:
        """Hand an input, which arrived `age` s ago, to the robot and carry out the actions.

        `may_repeat` False: a command to the base that equals the last command is not sent again.
        """
        kind = type(input)
        if kind in _ROUTINE:
            self._tell_provisional()
        elif kind not in _MEASURED:
            self._active_until = boottime() + ACTIVE_TIME
            self._timer.rest(False)
        # A decision uses all odometry that has arrived.
        if kind not in _MEASURED and not _is_stop(input) and self._gathering_driver is not None:
            self._gathering_driver.read()
        actions = self._recorder.step(self._robot, input, boottime() - age)
        if actions is not None:
            self._carry_out(actions, may_repeat=may_repeat and kind not in _FREQUENT)
        self._recorder.settle(self._robot)
        if kind is events.ScanInput:
            self._timer.tick_early()
            self._scan_at = boottime()
        elif kind is events.HostInput or (kind is events.TickInput and not self._robot.is_running):
            # The command of this tick has gone to the base: the next scan or tick changes it.
            now = boottime()
            # Lidars turn at most once in two ticks. One that is lost or not there sends no scan.
            is_between = not TICK <= now - self._scan_at < SCAN_LOST
            self._recorder.remember(self._robot, now, self._timer.left if is_between else 0.0)

    def _tell_provisional(self) -> None:
        """Hand the robot the generations of the present run and load that are provisional code."""
        is_provisional = self._pushed_runs.is_provisional
        current = tuple(filter(is_provisional, self._robot.generations))
        if current != self._provisional:
            self._provisional = current
            self.step(events.ProvisionalInput(current))

    def on_input(self, input: events.Input) -> None:
        """Hand the robot an input that came from a peer; audit an adopted latch or goal."""
        judged = self._permits.judge_input(input)
        if judged is None:
            self._drops.add("permit:spread")
            return
        input = judged
        robot = self._robot
        held = set(robot.latches)
        goal = robot.goal
        state = robot.state
        if isinstance(input, events.DuplicateInput) and input.holder is not None:
            log.error("id %s is also held by %s", robot.id, input.holder)
        self.step(input)
        for id in sorted(robot.latches.keys() - held):
            latch = robot.latches[id]
            self._audit.note(f"latch {id}", latch.issuer, "a peer", latch.reason, boottime())
        if isinstance(input, events.LatchesInput) and robot.state is not state:
            text = robot.status(boottime()).detail
            log.info("estopped by the latch of a peer: %s", text)
        if robot.goal is not None and (goal is None or goal.goal != robot.goal.goal):
            adopted = robot.goal.goal
            on_join = f"on_join {adopted.on_join}" if adopted.pattern else ""
            self._audit.note(adopted.text, adopted.issuer, "a peer", on_join, boottime())

    @property
    def _present_run(self) -> PresentRun | None:
        """The pattern that runs, and the bound of its speed; None without one."""
        pattern = self._robot.running_pattern
        return None if pattern is None else PresentRun(pattern, self._robot.running_speed)

    def judge_stop(self, stop: Stop, author: Author | None) -> StopVerdict:
        """What permits leave of a stop. `author`: its verified signer."""
        return self._permits.judge_stop(stop, author)

    def on_refused_stop(
        self, stop: Stop, source: Address, text: str, answer: Callable[[Reply], None]
    ) -> None:
        """Audit a stop that its permit does not permit here; the reply goes to `answer`."""
        self._requests.deny_stop(stop, f"{source[0]}:{source[1]}", text, answer)

    def on_stop(self, stop: Stop, source: Address, answer: Callable[[Reply], None]) -> None:
        """Carry out a stop or estop of an operator or relay; the reply goes to `answer`."""
        self._requests.stop(stop, f"{source[0]}:{source[1]}", answer)

    def check_goal(self, goal: Goal, now: float) -> bool | None:
        """Whether the signature of a peer's goal is valid; None if it cannot be verified now."""
        return self._goals.check(goal, now)

    def on_clock(self, sample: ClockSample) -> None:
        """Record a reading of the clock of a peer."""
        self._recorder.add(frames.ClockEntry(boottime(), *sample))

    def on_interface(self, change: InterfaceChange) -> None:
        """Log a change of the interface; a change of address also stops the robot."""
        log.warning("%s", change.line)
        self._notify.status(change.line)
        self.step(
            events.NetworkInput(change.line)
            if change.must_reopen
            else events.NoteInput(change.line)
        )

    def _on_request(self, request: Request) -> None:
        if refusal := self._goals.refusal_of(request, self._robot.id):
            self._requests.reply(refusal)
            return
        self.step(events.RequestInput(request))

    def _on_audit(self, line: str) -> None:
        log.info("%s", line)
        self.step(events.NoteInput(line))

    def _on_roster(self, taken: TakenRoster) -> None:
        """Apply a newly taken roster: stop the robot, drop foreign goals, reopen the network."""
        log.warning("roster: %s", taken.text)
        what = f"roster {taken.identity.roster.generation}"
        self._audit.note(what, "the authority", "an operator or peer", taken.text, boottime())
        self.step(events.RosterInput(taken.text, taken.is_revoked))
        if foreign := self._goals.foreign(self._robot.goals):
            self.step(events.ForgetInput(foreign))
        self._permits.take_roster()
        self._network.take_identity(taken.identity)
        self._puller.take_identity(taken.identity)
        self._pattern_intake.check_again()

    def on_newer_roster(self, robot: str, address: Address, generation: int) -> None:
        """Pull the roster of a robot whose (unverified) beacon shows a greater generation."""
        if self._puller.pull(robot, address, "roster", on_done=self._rosters.on_pulled):
            log.info("%s at %s may have roster %d: asking for it", robot, address[0], generation)

    def on_event(self, text: str) -> None:
        """Log a warning, also among the robot's events."""
        log.warning("%s", text)
        self.step(events.NoteInput(text))

    def on_lost(self, beacon: Beacon) -> None:
        """Record what is known of the robot, which has failed; begin an incident if it ran."""
        known = LostMember.of(beacon, self._network.link(beacon.robot), self._robot.goal)
        self._recorder.add(frames.TextEntry(boottime(), LOST, frames.as_json(known)))
        self._incidents.on_lost(beacon)

    def on_members(self) -> None:
        """Hand the robot the bodies of all members, and the neighbors.

        A driver that senses neighbors itself replaces the neighbors of the network.
        """
        self.step(events.PeersInput(dict(self._network.bodies)))
        if not self._has_joined or self.sink.has_neighbors:
            return
        alive = tuple(Neighbor(robot, 0.0) for robot in sorted(self._network.alive))
        self.step(events.NeighborsInput(self._neighborhood.select(alive, boottime())))

    def summary(self) -> Summary:
        """The robot's part of a beacon."""
        robot = self._robot
        return Summary(
            robot.state,
            robot.epoch.revision,
            robot.aged_latches(boottime()),
            robot.goal,
            pulled={kind: pulled.digest for kind, pulled in self._pulled.items()},
            wished=robot.wished,
            reset_at=robot.reset_at,
            cleared=robot.cleared,
        )

    def status(self) -> Status:
        """The robot's status, with what the daemon's parts add to it."""
        status = self._robot.status(boottime())
        health = self._health.added_to(
            status.health,
            network=self._network.interface_text,
            storage=self._latches.fault,
            black_box=self._incidents.text,
            sandbox=self._runner.sandbox,
        )
        return replace(
            status,
            health=health,
            recording=self._recording.summary,
            keys=self._rosters.summary,
            programs=self._network.programs,
        )

    # Pushed patterns

    def _operators(self) -> Mapping[str, bytes] | None:
        """The public keys of the operators whose pushed code is accepted, by name.

        A swarm without keys has no such operators. On loopback the result is None: unsigned code is
        accepted. On a network the result is empty: no code is accepted, since anyone could send
        code.
        """
        identity = self._rosters.identity
        if identity is not None:
            return identity.roster.operators
        return None if self._settings.network.profile == "dev" else {}

    def on_beacon(self, beacon: Beacon, address: Address) -> None:
        """Pull records that a peer has and this robot lacks, by the digests in the beacon."""
        for kind, pulled in self._pulled.items():
            pulled.on_beacon(beacon.robot, beacon.digest(kind), address, boottime())

    def _on_pulled_code(self, robot: str, entry: Entry) -> None:
        manifest = entry.manifest
        self._audit.note(f"push {manifest.label}", manifest.issuer, robot, "", boottime())

    # Ticks and actions

    def _on_tick(self) -> None:
        """Step the robot by time, and do the periodic work whose time has come.

        The timer calls this each period (1/20 s), and between two periods if the robot asked.
        """
        periods_before = self._periods
        self._periods = self._timer.periods

        def is_due(interval: int) -> bool:
            """True once every `interval` periods."""
            return self._periods // interval > periods_before // interval

        self.step(events.TICK_INPUT, may_repeat=self._periods > periods_before)
        is_active = boottime() < self._active_until  # stops of the last second may be on their way
        self._timer.rest(self._may_rest and self._robot.is_at_rest and not is_active)
        if self._commands is not None:
            self._commands.note_epoch(boottime())
        self._network.advance(may_wait=not (is_active or is_due(NETWORK_PERIOD)))
        if self._recorder.is_on or self._incidents.is_pending:
            self._network.ask_clocks()  # to merge this recording with recordings of peers
        self._incidents.advance(boottime())
        if pose_and_age := self._robot.pose_to_tell(boottime()):
            self._network.publish_pose(*pose_and_age)
        if is_due(MOTION_PERIOD):
            self._viewer_feed.publish_motion()
        self._tools.advance(boottime())
        if self._latches.fault and is_due(STORAGE_PERIOD) and not self._robot.is_running:
            self._check_storage()  # blocks the loop, so never during a run
        if is_due(USAGE_PERIOD):
            self._measure_usage()
        if is_due(NEIGHBORS_PERIOD):
            self.on_members()
            self._notify.feed_watchdog(self._robot.decided_at, boottime())

    def _measure_usage(self) -> None:
        """Measure the time of the run of a pushed pattern, and the load of the processes."""
        robot = self._robot
        self._pushed_runs.advance(boottime(), robot.running_generation, is_running=robot.is_running)
        self._health.measure(self._runner.pid, boottime())

    def _check_storage(self) -> None:
        """Try to write to the state folder, also latches not yet written; log a change."""
        if not self._latches.check():
            return
        if fault := self._latches.fault:
            text = f"{fault}: an emergency stop would be lost by a restart, or has been by this one"
            log.error("%s", text)
        else:
            text = f"{self._latches.path.parent} can be written again"
            log.info("%s", text)
        self.step(events.NoteInput(text))

    def _on_host_events(self) -> None:
        for event in self._runner.events():
            kept = self._pattern_intake.on_event(event)
            if kept is not None:
                self.step(events.HostInput(self._pushed_runs.granted(kept)))

    def _carry_out(self, actions: Actions, *, may_repeat: bool) -> None:
        """Carry out what the robot wants after an input, the command to the base first.

        `may_repeat` False: a command that equals the last command is not sent again. Latches are on
        disk before any reply is sent.
        """
        self._output.command(actions, boottime(), may_repeat=may_repeat)
        if actions.is_quiet:  # nothing but the command; the next deadline is as before
            return
        if actions.ended:
            log.info("the run ended: %s", actions.ended)
        if actions.goals is not None:
            self._goals.store(actions.goals)  # begins a write, for which `_reply` waits
        is_stored = actions.latches is None or self._latches.store(actions.latches)
        self._tools.storage_fault = self._latches.fault
        for command in (actions.trial, actions.host):
            if command is not None:
                self._runner.send(command)
        if actions.grip is not None and self._gripper is not None:
            self._gripper.grip(actions.grip)
        for channel, value in actions.messages.items():
            self._send_message(channel, value)
        if actions.kin_message is not None:
            self._network.publish_kin_message(actions.kin_message)
        if actions.has_status:
            self._network.publish("status", lambda: encode(self.status()))
            self._viewer_feed.show_status(self.status)
        if actions.failed_code is not None:
            self._pushed_runs.on_failed(actions.failed_code)
        for reply in map(self._pattern_intake.on_reply, actions.replies):
            self._reply(reply, is_stored=is_stored)
        wake_at = self._robot.wake_at(boottime())  # a deadline between two regular ticks
        self._timer.wake_in(None if wake_at is None else wake_at - boottime())

    def _reply(self, reply: Reply, *, is_stored: bool) -> None:
        """Send a reply, at once or when the goals are on disk.

        A reply to a stop or reset says that a goal has ended. The reply waits for the disk, so that
        the goal stays ended after a restart. `is_stored`: the latches are on disk.
        """
        robot = self._robot
        # While the robot runs, no goal has ended. Under a latch the robot joins no goal.
        is_goal_safe = robot.is_running or bool(robot.latches)
        if is_goal_safe or not self._goals.is_writing:
            self._requests.reply(reply, is_stored=is_stored)
            return
        answer = self._loop.create_task(self._answer(reply, is_stored))
        self._answers.add(answer)
        answer.add_done_callback(self._answers.discard)

    def _send_message(self, channel: str, value: Value) -> None:
        """Send a message of the pattern to viewers and robots; count a value without encoding."""
        try:
            payload = encode_value(value)
        except CodecError as error:
            log.debug("message on %s not sent: %s", channel, error)
            self._drops.add(f"msg/{channel}:unsendable")
            return
        self._viewer_feed.publish_message(channel, value)
        if self._carrier is None:
            self._network.publish_message(channel, payload)
        else:  # the base has a radio for the messages of patterns
            self._carrier.send_message(channel, payload)

    async def _answer(self, reply: Reply, is_stored: bool) -> None:
        """Send a reply once the goals are on disk, or the write has failed or timed out."""
        is_stored &= await self._goals.is_stored()
        self._requests.reply(reply, is_stored=is_stored)

    def _head(self) -> RecordingHead:
        return recording_head(self._robot, self._settings.network.swarm, boottime())


def _without_gripper(settings: DaemonSettings) -> DaemonSettings:
    """The settings of a robot whose driver cannot operate the gripper of its platform."""
    platform = settings.platform
    platform = dataclasses.replace(platform, provides=platform.provides - {"gripper"})
    return dataclasses.replace(settings, platform=platform)


def _is_stop(input: events.Input) -> bool:
    """Whether the command is zero whatever odometry says, so that it waits for no reading."""
    what = input.request if isinstance(input, events.RequestInput) else input
    return isinstance(what, StopRequest | EstopRequest | events.LeaveInput)


def _cause_of(error: BaseException) -> BaseException:
    """The error itself, or the error of the robot's core that `error` carries."""
    return error.__cause__ or error if isinstance(error, CoreFault) else error


async def _end(task: asyncio.Task[Any]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def _warn_of_end(identity: Identity) -> None:
    """Log a line if the certificate has expired by this machine's clock, which may be wrong."""
    if (wall := time.time()) > identity.info.expires:
        log.warning(
            "the certificate of %s has ended by the clock of this machine (%s): this robot has no"
            " links, and takes stops; set the clock if it is wrong, else install a new bundle"
            " (swarmctl keys bundle %s)",
            identity.name,
            time.strftime("%Y-%m-%d", time.gmtime(wall)),
            identity.name,
        )
