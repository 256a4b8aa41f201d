"""Each sequence of actions on the base and the link of a driver, up to a depth, in virtual time.

A sequence begins with a base that drives by a run, and ends as follows: all that was broken is
mended, the base stands or goes on with its run, a new run moves it, a stop ends that, and the
driver ends. `Daemon` is what a robot does with its driver, reduced to what these rules are about: a
run is held while the base is lost or senses a hazard, and a hold of MAX_HOLD_TIME ends it. Unlike a
robot, the daemon goes on to command a lost base until then: the driver alone must drop that.

1. *The newest command alone*: each command of the driver that moves the base is the last one that
   the daemon has handed to it.
2. *Nothing to a lost base*: no command that moves arrives while the driver reports the base lost.
3. *Zero first*: the first command to a base that is reported again is zero. After a loss that has
   ended the run, the base stands until a new run.
4. *A drone climbs once for each run*: what comes back on the ground stays there until a new run.
5. *Zero after stop*: ZERO_TIME after the end of a run, a base that is reached has the command zero.
6. *A loss is reported*, within the time that the driver promises, and so is a return.
7. *A second owner*: a driver that reports one as a loss does so within OWNER_TIME, and answers its
   commands with zero while the robot is stopped.
8. *What the base senses is handed on*: hazards, and the reading of the battery.
9. *It goes on*: after all is mended, a new run moves the base.

`python -m tests.sequences.drivers --depth 3 --driver ros1 FOLDER` adds a line for each driver and
pause to a file in FOLDER, and prints each sequence that breaks a rule, and its shortest beginning.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import logging
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

from swarmd.core.hazard import ENDS_RUN
from swarmd.core.messages import Reason, State
from swarmd.core.values import ZERO, Twist
from swarmd.driver_api.driver import Driver
from swarmd.robot.timeouts import MAX_HOLD_TIME
from tests.sequences.bases import BASES, BATTERY, BOOT_TIME, ORDERS, TICK, Base
from tests.sequences.virtual_loop import VirtualLoop, run_virtually

PAUSES = (1.2, 2.6, 0.3, 5.0)
"""s after each action: less and more than each time-out of a driver, a gate and a hold."""
DEPTH = 3
ZERO_TIME = 0.4  # s
OWNER_TIME = 0.5  # s
SENSE_TIME = 0.5  # s
CONNECT_TIME = 8.0  # s
LOOK_TIME = 1.5  # s for which a base that is back is looked at before it gets another order
SPEED, SPEED_STEP = 0.1, 1e-4  # m/s: each command of a run has a speed of its own
SAME = 2e-6  # m/s by which a command changes on its way in single precision


class BrokenRuleError(AssertionError):
    """A rule does not hold; `rule`: its number."""

    def __init__(self, rule: int, text: str) -> None:
        super().__init__(f"rule {rule}: {text}")
        self.rule = rule


class Daemon:
    """What a robot does with its driver; it is also the driver's sink."""

    def __init__(self, base: Base, driver: Driver) -> None:
        self.base, self.driver, self.loop = base, driver, base.loop
        self.is_up = False
        self.text = ""
        self.hold: Reason | None = None
        self.up_at = self.held_since = float("inf")
        self.hazards: tuple[Any, ...] = ()
        self.reading: float | None = None
        self.runs = 0
        self.runs_now = False
        self.rests = 1  # ticks before a run begins
        self.ended_at = -float("inf")
        self.state = State.IDLE
        self.newest = ZERO
        self.count = 0
        self.has_returned = False  # and no command has arrived since

    # The sink

    def take(self, input: Any) -> None:
        """Keep hazards and the battery."""
        if hasattr(input, "hazards"):
            self.hazards = input.hazards
        elif hasattr(input, "readings"):
            self.reading = input.readings.get(BATTERY, input.readings.get("battery"))

    def message(self, sender: str, channel: str, payload: bytes) -> None:
        """Nothing is sent."""

    def dropped(self, what: str) -> None:
        """Nothing is counted."""

    def state_of_base(
        self, is_up: bool, text: str, *, hold: Reason | None = None, gets_zero: bool = False
    ) -> None:
        """As `Sink.state`."""
        if is_up and not self.is_up:
            self.up_at = self.loop.time()
            self.has_returned = True
        self.is_up, self.text, self.hold = is_up, text, hold

    # The robot

    def run(self) -> None:
        """An operator wants a run."""
        self.runs += 1
        self.runs_now, self.rests = True, 2
        self.held_since = float("inf")

    def stop(self, state: State = State.STOPPED) -> None:
        """The run ends."""
        self.runs_now, self.state = False, state
        self.ended_at = self.loop.time()

    def tick(self) -> None:
        """Command the base."""
        now = self.loop.time()
        kinds = {hazard.kind for hazard in self.hazards}
        if self.runs_now and kinds & ENDS_RUN:
            self.stop()
        is_held = not self.is_up or self.hold is not None or bool(kinds)
        self.held_since = min(self.held_since, now) if is_held else float("inf")
        if self.runs_now and now - self.held_since >= MAX_HOLD_TIME:
            self.stop()
        twist = ZERO
        if self.runs_now and self.rests:
            self.rests -= 1
            self.state = State.IDLE
        elif self.runs_now:
            self.state = State.RUNNING
            if not kinds and self.hold is None:
                self.count += 1
                twist = Twist(SPEED + SPEED_STEP * (self.count % 1000))
        show = getattr(self.driver, "show", None)
        if show is not None:
            show(SimpleNamespace(state=self.state), None, None)
        self.newest = twist
        is_stopped = self.state not in (State.IDLE, State.RUNNING)
        self.driver.send(twist, 1, 1, is_stopped=is_stopped)


class Sink:
    """What a driver is given: `state` of the daemon has another meaning."""

    def __init__(self, daemon: Daemon) -> None:
        self.take, self.message, self.dropped = daemon.take, daemon.message, daemon.dropped
        self.state = daemon.state_of_base


class Judge:
    """Checks rules 1 to 8 after each tick."""

    def __init__(self, base: Base, daemon: Daemon) -> None:
        self.base, self.daemon = base, daemon
        self.unreached_since = self.reached_since = base.loop.time()
        self.owned_since = self.sensed_since = float("inf")
        self.sensed: object = None
        self._fault: BrokenRuleError | None = None
        base.on_command = self.on_command

    def look(self) -> None:
        """BrokenRuleError if a rule does not hold now, or did not since the last look."""
        if self._fault is not None:
            raise self._fault
        base, daemon, now = self.base, self.daemon, self.base.loop.time()
        if base.climbs > daemon.runs:
            raise BrokenRuleError(4, f"{base.climbs} climbs in {daemon.runs} runs")
        if base.is_reachable:
            self.unreached_since = float("inf")
            self.reached_since = min(self.reached_since, now)
        else:
            self.reached_since = float("inf")
            self.unreached_since = min(self.unreached_since, now)
        if now - self.unreached_since > base.silence and daemon.is_up:
            raise BrokenRuleError(6, f"no loss is reported after {base.silence} s")
        is_owned = base.is_owned and base.is_reachable and "owner" in base.actions
        self.owned_since = min(self.owned_since, now) if is_owned else float("inf")
        is_steady = daemon.is_up and now - daemon.up_at > ZERO_TIME and base.is_reachable
        is_over = not daemon.runs_now and now - daemon.ended_at > ZERO_TIME
        is_quiet = now - self.reached_since > ZERO_TIME and not base.is_owned
        if is_steady and is_over and is_quiet and not base.force.is_zero:
            raise BrokenRuleError(5, f"the base has {base.force} without a run")
        if not base.has_firmware and now - self.owned_since > OWNER_TIME:
            if daemon.is_up:
                raise BrokenRuleError(7, "no second owner is reported")
            if daemon.state is State.STOPPED and is_over and not base.force.is_zero:
                raise BrokenRuleError(7, f"the base has {base.force} beside the second owner's")
        self._look_at_senses(now)

    def on_command(self, twist: Twist) -> None:
        """Rules 1 to 3, when a command of the driver arrives."""
        daemon = self.daemon
        has_returned, daemon.has_returned = daemon.has_returned, False
        if twist.is_zero:
            return
        if has_returned:
            self._note(3, f"{twist} comes first after a return")
        if abs(twist.linear - daemon.newest.linear) > SAME or daemon.newest.is_zero:
            self._note(1, f"{twist} comes; the newest is {daemon.newest}")
        if not daemon.is_up:
            self._note(2, f"{twist} comes to a base that is lost: {daemon.text}")

    def _note(self, rule: int, text: str) -> None:
        """Keep the first fault until the next look: a driver may catch what its base raises."""
        self._fault = self._fault or BrokenRuleError(rule, text)

    def _look_at_senses(self, now: float) -> None:
        base, daemon = self.base, self.daemon
        sensed = base.has_hazard, base.battery
        is_told = daemon.is_up and base.is_reachable and sensed == self.sensed
        self.sensed = sensed
        self.sensed_since = min(self.sensed_since, now) if is_told else float("inf")
        if now - self.sensed_since <= SENSE_TIME or now - daemon.up_at <= SENSE_TIME:
            return
        if bool(daemon.hazards) != base.has_hazard:
            raise BrokenRuleError(8, f"hazards are {daemon.hazards}, sensed {base.has_hazard}")
        if daemon.reading is None or (daemon.reading > 0.5) != (base.battery > 0.5):
            raise BrokenRuleError(8, f"the battery is told as {daemon.reading}")


def possible(name: str, depth: int) -> Iterator[tuple[str, ...]]:
    """The sequences of `depth` actions, each of which changes something."""

    def grow(done: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        if len(done) == depth:
            yield done
            return
        base = BASES[name](SimpleNamespace(time=lambda: 0.0))  # type: ignore[arg-type]
        for action in done:
            base.do(action)
        for action in (*ORDERS, *base.actions):
            if base.is_possible(action):
                yield from grow((*done, action))

    return grow(())


def play(name: str, actions: Sequence[str], pause: float) -> None:
    """Let a sequence happen; BrokenRuleError if a rule does not hold."""
    loop = VirtualLoop()
    base = BASES[name](loop)
    with ExitStack() as stack:
        for where, what, value in base.patches():
            stack.enter_context(mock.patch.object(where, what, value))
        run_virtually(loop, _story(base, actions, pause))


async def _story(base: Base, actions: Sequence[str], pause: float) -> None:
    loop, driver = base.loop, base.make()
    daemon = Daemon(base, driver)
    judge = Judge(base, daemon)
    running = loop.create_task(driver.run(Sink(daemon)))

    async def let_pass(seconds: float, until: Any = lambda: False) -> bool:
        """Let time pass, at most until something holds; True if it holds."""
        end = loop.time() + seconds - 1e-6
        while loop.time() < end and not until():
            base.tick()
            await asyncio.sleep(0.0)
            daemon.tick()
            await asyncio.sleep(TICK)
            judge.look()
            if running.done():
                running.result()
        return bool(until())

    def moves() -> bool:
        return not base.force.is_zero

    async def need(rule: int, what: str, seconds: float, until: Any) -> None:
        if not await let_pass(seconds, until):
            raise BrokenRuleError(rule, f"{what} within {seconds:g} s; {daemon.text}")

    try:
        await need(6, "the base is not reported", CONNECT_TIME, lambda: daemon.is_up)
        await let_pass(1.5)  # an estimate that rests
        daemon.run()
        await need(9, "the first run does not move the base", base.start_time + 1.0, moves)
        for action in actions:
            _do(base, daemon, action)
            await let_pass(pause)
        for action in ("link back", "battery back", "hazard over", "owner gone"):
            if action in base.actions and base.is_possible(action):
                base.do(action)
        await let_pass(base.silence + BOOT_TIME)  # a loss may not be reported yet
        await need(6, "no return is reported", base.return_time, lambda: daemon.is_up)
        await let_pass(LOOK_TIME)
        daemon.stop()
        await let_pass(2.0 * ZERO_TIME)
        await need(9, "the base does not rest", base.rest_time, lambda: base.is_at_rest)
        daemon.run()
        await need(9, "a new run does not move the base", base.start_time, moves)
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
    if not base.force.is_zero:
        raise BrokenRuleError(5, f"the base has {base.force} after the driver's end")


def _do(base: Base, daemon: Daemon, action: str) -> None:
    if action == "run":
        daemon.run()
    elif action == "stop":
        daemon.stop()
    elif action == "estop":
        daemon.stop(State.ESTOPPED)
    else:
        base.do(action)


def fault_of(name: str, actions: Sequence[str], pause: float) -> str:
    """What is wrong with a sequence; empty if nothing is."""
    try:
        play(name, actions, pause)
    except BrokenRuleError as error:
        return str(error)
    return ""


def search(name: str, depth: int, pauses: Sequence[float] = PAUSES) -> Iterator[str]:
    """Play all sequences of up to `depth` actions, the shortest first; a text for each fault.

    A sequence whose beginning breaks a rule is not played.
    """
    broken: set[tuple[tuple[str, ...], float]] = set()
    for length in range(depth + 1):
        for actions in possible(name, length):
            for pause in pauses:
                if any((actions[:some], pause) in broken for some in range(length)):
                    continue
                if fault := fault_of(name, actions, pause):
                    broken.add((actions, pause))
                    yield f"{name}, {', '.join(actions) or 'nothing'}, each {pause} s: {fault}"


def main(folder: Path, arguments: Sequence[str]) -> int:
    """Search, and add a line for each driver and pause to a file in `folder`; 1 with a fault."""
    parser = argparse.ArgumentParser(prog="tests.sequences drivers")
    parser.add_argument("--depth", type=int, default=DEPTH)
    parser.add_argument("--driver", choices=tuple(BASES), action="append")
    chosen = parser.parse_args(arguments)
    with _only_critical():
        return _search_all(folder, chosen)


@contextlib.contextmanager
def _only_critical() -> Iterator[None]:
    """Log no loss of a base, which is a warning; later tests in this process log as before."""
    logger = logging.getLogger("swarmd")
    level = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(level)


def _search_all(folder: Path, chosen: argparse.Namespace) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"drivers-{chosen.depth}.jsonl"
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    finished = {(one["driver"], one["pause"]) for one in done}
    for pause in PAUSES:
        for name in chosen.driver or BASES:
            if (name, pause) in finished:
                continue
            began, faults = time.process_time(), list[str]()
            for fault in search(name, chosen.depth, (pause,)):
                faults.append(fault)
                print(fault, flush=True)
            count = sum(1 for n in range(chosen.depth + 1) for _ in possible(name, n))
            line = {
                "driver": name,
                "pause": pause,
                "sequences": count,
                "seconds": round(time.process_time() - began, 1),
                "faults": faults,
            }
            done.append(line)
            with path.open("a") as lines:
                lines.write(json.dumps(line) + "\n")
    for one in done:
        told = f"{one['sequences']} sequences in {one['seconds']} s, {len(one['faults'])} faults"
        print(f"{one['driver']}, {one['pause']} s after each action: {told}")
    return 1 if any(one["faults"] for one in done) else 0


if __name__ == "__main__":
    *words, where = sys.argv[1:] or ["drivers"]
    sys.exit(main(Path(where), words))
