"""One robot on the bench: a scripted body, its real daemon, an operator, and a listening peer."""

from __future__ import annotations

import contextlib
import shutil
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import pytest
import zenoh

from swarmd.core.clock import boottime
from swarmd.core.codec import Decoder
from swarmd.core.errors import RequestError
from swarmd.core.keys import build
from swarmd.core.messages import Code, Epoch, Reason, Reply, State, Status
from swarmd.core.values import Twist, Value
from swarmd.core.verbs import VERBS
from swarmd.link.settings import NetworkSettings
from swarmd.operator.session.operator import Operator
from swarmd.settings.settings import load_platform
from tests.support.fake_body import Body, Commanded
from tests.support.processes import (
    CAP,
    DaemonProcess,
    attempts,
    free_endpoint,
    unique_swarm,
    wait_until,
)
from tests.support.swarmctl import STALLED
from tests.support.viewer import Viewer

ROBOT = "tb3-01"
ENDED_BY_STALL = {Reason.PATTERN_RESTARTING, Reason.LOOP_STALLED, Reason.STALE_SCAN}
LOOK_PERIOD = 0.5  # s between two looks for a robot that has restarted
PLUGINS = Path(__file__).parent / "plugins"


@dataclass(frozen=True, slots=True)
class Heard:
    """A status as it was published. `at` on CLOCK_BOOTTIME in s, when it arrived."""

    at: float
    status: Status


@dataclass(frozen=True, slots=True)
class Return:
    """A pattern that drove, failed and came back. Times on CLOCK_BOOTTIME in s.

    `began` is when it was made to fail; `failed` and `restarted` are what was published of it.
    """

    began: float
    failed: Heard
    restarted: Heard


class Witness:
    """A peer that only listens: every status that the robot publishes, in order."""

    def __init__(self, swarm: str) -> None:
        self.heard: list[Heard] = []
        self._decode = Decoder(Status)
        self._news = threading.Condition()
        self.viewer = Viewer(NetworkSettings(swarm=swarm))
        self._key = build(swarm, ROBOT, "state", "status")
        self.viewer.subscribe(self._key, self._on_status)

    def __enter__(self) -> Witness:
        return self

    def __exit__(self, *_: object) -> None:
        self.viewer.close()

    def ask(self) -> Status | None:
        """The robot's status now; None if it does not answer within a second."""
        for answer in self.viewer.get(self._key, timeout=1.0):
            return self._decode(answer.payload.to_bytes())
        return None

    def wait(self, what: str, holds: Callable[[Status], bool], since: float = 0.0) -> Heard:
        """The first status published after `since` for which `holds`; AssertionError after 30 s."""
        deadline = time.monotonic() + CAP
        while True:
            self.viewer.look()
            with self._news:
                for heard in self.heard:
                    if heard.at > since and holds(heard.status):
                        return heard
                assert time.monotonic() < deadline, f"never {what}; at last {self._last()}"
                self._news.wait(LOOK_PERIOD)

    def _last(self) -> str:
        said = [f"{h.status.state} ({h.status.reason}) {h.status.detail}" for h in self.heard[-5:]]
        return f"{said} {self.heard[-1].status.events if self.heard else ''}"

    def _on_status(self, sample: zenoh.Sample) -> None:
        status = self._decode(sample.payload.to_bytes())
        with self._news:
            self.heard.append(Heard(boottime(), status))
            self._news.notify_all()


class Bench:
    """A body and a daemon in a swarm of their own; `start` begins each of the daemon's lives."""

    def __init__(self, folder: Path) -> None:
        self.swarm = unique_swarm()
        self.folder = folder
        self.state = folder / "state" / self.swarm / ROBOT
        self._plugins = folder / "plugins"
        shutil.copytree(PLUGINS, self._plugins, ignore=shutil.ignore_patterns("__pycache__"))
        self._left = contextlib.ExitStack()
        platform = load_platform("waffle_pi")
        self.body = self._left.enter_context(
            Body(platform, swarm=self.swarm, robot=ROBOT, endpoint=free_endpoint())
        )
        self.witness = self._left.enter_context(Witness(self.swarm))
        self.daemon: DaemonProcess
        self.driver_options: Mapping[str, Value] = {}
        self.prefix: tuple[str, ...] = ()  # of the daemon's command line
        self._born = 0.0

    def close(self) -> None:
        """End everything, the latest first."""
        self._left.close()

    # Its lives

    def start(self, environ: Mapping[str, str] | None = None) -> float:
        """A daemon that is ready, has its body and can be asked; when it was begun."""
        begun = boottime()
        self.spawn(environ).wait_ready()
        self.witness.wait("with its body", lambda status: status.health.driver_up, begun)
        self.operator = self._left.enter_context(self._operator())
        self.meet()
        status = self.status()
        self._born = boottime() - status.uptime
        return begun

    def meet(self) -> None:
        """Return once the operator reaches it: links that were cut come back one by one."""
        wait_until(lambda: ROBOT in self.operator.members().answered, "it answers the operator")

    def spawn(self, environ: Mapping[str, str] | None = None) -> DaemonProcess:
        """A daemon that is starting, in the folder of those before."""
        self.daemon = self._left.enter_context(
            DaemonProcess(
                self.folder,
                swarm=self.swarm,
                robot=ROBOT,
                endpoint=self.body.endpoint,
                plugin_dir=self._plugins,
                options={"driver_options": {"endpoint": self.body.endpoint, **self.driver_options}},
                environ=environ,
                prefix=self.prefix,
            )
        )
        return self.daemon

    def replace_body(self, body: Body) -> None:
        """Another body at the place of the one before; close that one first."""
        self.body = self._left.enter_context(body)

    def _operator(self) -> Operator:
        return Operator(NetworkSettings(swarm=self.swarm), name="zoe@test")

    # Working it

    def status(self) -> Status:
        """What it answers now, or as soon as it does."""
        found: list[Status] = []

        def look() -> bool:
            found.extend(one for one in (self.witness.ask(),) if one is not None)
            return bool(found)

        wait_until(look, f"it answers; its log: {self.daemon.text()[-2000:]}")
        return found[0]

    def ask(self, verb: str, *, epoch: Epoch | None = None, **args: Any) -> Reply:
        """Its answer to a request that quotes the epoch it has now, or the one given."""
        targets = {ROBOT: epoch or self.status().epoch}
        outcome = self.operator.request(VERBS[verb].asked, targets, **args, timeout=10.0)
        assert not outcome.missing, f"no answer to {verb}; its log: {self.daemon.text()[-2000:]}"
        return outcome.replies[ROBOT]

    def run(self, pattern: str, **params: float) -> Reply:
        """Its answer to `run`."""
        return self.ask("run", pattern=pattern, params=params)

    def drive(self, pattern: str = "drive") -> Commanded:
        """It runs and moves: the first command that did. On a starved machine asks again."""
        for _ in attempts(f"{pattern} is loaded"):
            asked = boottime()
            try:
                reply = self.run(pattern)
            except RequestError as error:
                if STALLED.search(str(error)):
                    continue
                raise
            if reply.code is Code.APPLIED:
                return self.body.wait_moving(asked)
            print(f"not loaded: {reply.text}")
            assert STALLED.search(reply.text)
        raise AssertionError

    def drive_until_restarted(self, pattern: str, fail: Callable[[], float] = boottime) -> Return:
        """It drives, fails and is restarted. `fail` makes it fail and tells when.

        On a starved machine, where it is not reloaded within the two seconds of a hold, this
        tries again.
        """
        for _ in attempts(f"{pattern} is restarted in time"):
            self.drive(pattern)
            began = fail()
            has_failed = self._has_event(f"{pattern} failed", began)
            failed = self.witness.wait(f"{pattern} failed", _or_given_up(has_failed), began)
            if not has_failed(failed.status):
                print(f"stopped before it failed: {failed.status.detail}")
                continue
            restarted = self._has_event(f"{pattern} restarted", began)
            end = self.witness.wait(f"{pattern} restarted", _or_given_up(restarted), began)
            if not _is_given_up(end.status):
                return Return(began, failed, end)
            print(f"not restarted in time: {end.status.detail}")
        raise AssertionError

    def drive_to_quarantine(self, pattern: str) -> tuple[Commanded, Heard]:
        """The first command that moved, and how it ended. On a starved machine tries again."""
        for _ in attempts(f"{pattern} is restarted in time"):
            moving = self.drive(pattern)
            end = self.witness.wait("faulted", _or_given_up(_is_faulted), moving.at)
            if not _is_given_up(end.status):
                return moving, end
            print(f"not restarted in time: {end.status.detail}")
        raise AssertionError

    def halt(self, verb: Literal["stop", "estop"]) -> Reply:
        """Its ack of stop or estop."""
        outcome = self.operator.send_stop(verb, reason="test")
        assert not outcome.missing, (
            f"no ack; it ended with {self.daemon.process.poll()}: {self.daemon.text()[-2000:]}"
        )
        reply = outcome.replies[ROBOT]
        assert reply.code is Code.APPLIED, reply.text
        return reply

    def calm(self) -> None:
        """It stands, senses and can be run again, whatever was before."""
        self.body.scans, self.body.odometry = self.body.clear, Twist()
        self.halt("stop")
        wait_until(self._has_reset, "its reset is not refused by a stall")
        wait_until(lambda: _sensors(self.status()), "it senses again")

    def _has_reset(self) -> bool:
        status = self.status()
        if status.state not in (State.ESTOPPED, State.FAULTED):
            return True
        reply = self.ask("reset", ids=list(status.latches))
        assert reply.code is Code.APPLIED or STALLED.search(reply.text), reply.text
        return reply.code is Code.APPLIED

    # Looking at it

    def await_state(self, state: State, reason: Reason, since: float = 0.0) -> Heard:
        """When it first said so after `since`."""
        return self.witness.wait(
            f"{state} ({reason})",
            lambda status: status.state is state and status.reason is reason,
            since,
        )

    def await_reason(self, reason: Reason, since: float = 0.0) -> Heard:
        """When it first said, after `since`, that it stands for this reason."""
        return self.witness.wait(reason, lambda status: status.reason is reason, since)

    def await_event(self, text: str, since: float = 0.0) -> Heard:
        """When it first listed an event of after `since` that holds this text."""
        return self.witness.wait(f"event {text!r}", self._has_event(text, since), since)

    def _has_event(self, text: str, since: float) -> Callable[[Status], bool]:
        after = since - self._born
        return lambda status: any(
            text in event.text and event.at > after for event in status.events
        )

    def moves_not(self, since: float, scans: int = 5) -> None:
        """All commands after `since` are zero, also those upon the next few scans."""
        now = boottime()
        wait_until(
            lambda: len({one.scan_seq for one in self.body.commands if one.at > now}) > scans,
            f"{scans} more scans were answered",
        )
        moved = [
            f"{one.twist} {one.at - since:.4f} s after, on scan {one.scan_seq}"
            for one in self.body.commands
            if one.at > since and not one.twist.is_zero
        ]
        assert not moved

    def lives(self, instance: str) -> None:
        """The daemon with this `instance` answers, and commands its body as ever."""
        assert self.daemon.process.poll() is None
        assert self.status().epoch.instance == instance
        now, before = boottime(), len(self.body.commands)
        self.body.wait(lambda command: len(self.body.commands) >= before + 5, now)


def _is_given_up(status: Status) -> bool:
    """A stall has ended the run: of the host, the daemon, or this process, whose scans it needs."""
    return status.state is State.STOPPED and status.reason in ENDED_BY_STALL


def _or_given_up(holds: Callable[[Status], bool]) -> Callable[[Status], bool]:
    return lambda status: holds(status) or _is_given_up(status)


def _is_faulted(status: Status) -> bool:
    return status.state is State.FAULTED


def _sensors(status: Status) -> bool:
    age = status.decision.scan_age
    return status.health.driver_up and age is not None and age < 0.3


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """A robot for all tests of a module, which thereby show that its daemon survives them."""
    with contextlib.closing(Bench(tmp_path_factory.mktemp("bench"))) as made:
        made.start()
        yield made


@pytest.fixture
def robot(shared: Bench) -> Bench:
    """The module's robot; it stands and can be run."""
    shared.calm()
    return shared


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    """A robot of the test's own, not started yet."""
    with contextlib.closing(Bench(tmp_path)) as made:
        yield made
