"""Histories of a virtual swarm: drawn by a seed, replayed, and shrunk if they break a rule.

A history is a list of steps. A step waits `gap` s, then something is typed by an operator, or
happens to a robot or to the network. After the last step all is healed and started, and ten seconds
after the last command has ended the rule `agreement` is checked::

    replay(4, [
        step(0.0, "run", by="anna", on_join="run", valid=60.0),
        step(2.0, "split", groups=(("r1", "r2", "anna"), ("r3", "r4", "bob"))),
        step(0.5, "estop", by="bob"),
    ])

A step that makes no sense where it stands, such as the thaw of a robot that is not frozen, does
nothing, so that each part of a history is a history.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from swarmd.core.incident import Incident, IncidentKind
from swarmd.link.keys.roster import KeyPermit
from tests.histories.invariants import (
    HEAL_TIME,
    TELL_TIME,
    BrokenRuleError,
    Invariants,
    no_exception,
)
from tests.histories.operators import Command, VirtualOperator
from tests.histories.swarm import (
    CHILD,
    DELAY,
    DISK_TIME,
    JOIN_TICK,
    Disk,
    VirtualDaemon,
    VirtualSwarm,
)

OPERATORS = ("anna", "bob")
PROGRAM = "teacher"
STEPS = 12
LONGEST_COMMAND = 90.0  # s
BOOT_TIME = 2.0  # s until all robots are ready


@dataclass(frozen=True)
class HistoryStep:
    """A step of a history; `args` are those of the method of `History` with this name."""

    gap: float
    name: str
    args: dict[str, Any]

    def __str__(self) -> str:
        args = "".join(f", {key}={value!r}" for key, value in self.args.items())
        return f"step({self.gap!r}, {self.name!r}{args})"


Steps = tuple[HistoryStep, ...]


def step(gap: float, name: str, **args: Any) -> HistoryStep:
    """A step of a history."""
    return HistoryStep(gap, name, args)


class History:
    """A swarm of robots `r1` to `r<count>` and two operators, to which steps happen.

    It is secured with each second seed, and fenced if a pose is to stand still. `permits`: by name
    of a further operator. `judge` makes the rules.
    """

    def __init__(
        self,
        count: int,
        seed: int = 1,
        *,
        is_fenced: bool = False,
        permits: Mapping[str, KeyPermit] | None = None,
        judge: Callable[[VirtualSwarm], Invariants] = Invariants,
    ) -> None:
        self.swarm = VirtualSwarm(
            seed, is_secured=seed % 2 == 0, is_fenced=is_fenced, permits=permits
        )
        self.judge = judge(self.swarm)
        self.swarm.judge = self.judge
        self.operators = {
            name: VirtualOperator(self.swarm, name, number)
            for number, name in enumerate((*OPERATORS, *(permits or {})), 1)
        }
        with no_exception():
            for number in range(count):
                self.swarm.boot(f"r{number + 1}")
            self.swarm.advance(BOOT_TIME)

    def carry_out(self, one: HistoryStep) -> None:
        """Wait, then let the step happen."""
        with no_exception():
            self.swarm.advance(one.gap)
            getattr(self, one.name)(**one.args)

    def end(self) -> None:
        """Heal all and start all, wait, and check the rule `agreement`."""
        self.heal()
        with no_exception():
            for robot in self.swarm.robots.values():
                robot.disk_time, robot.told_x = DISK_TIME, None
                robot.thaw() if robot.is_frozen else None
                robot.start() if not robot.is_up else None
            self.await_commands()
            self.swarm.advance(HEAL_TIME)
        self.judge.check_healed()
        unheard = self.judge.unheard()
        with no_exception():
            self.swarm.until(
                lambda: all(one.black_box.has_file(told.id) for one, told in unheard), TELL_TIME
            )
        self.judge.check_incidents(unheard)

    def await_commands(self) -> None:
        """Wait until no command is under way."""
        some = self.operators.values()
        self.swarm.until(lambda: not any(one.under_way for one in some), LONGEST_COMMAND)

    # Commands

    def run(self, by: str, pattern: str = "drive", **options: Any) -> None:
        self._begin(by, "run", lambda one: one.run(pattern, **options))

    def stop(self, by: str, targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "stop", lambda one: one.stop("stop", targets))

    def estop(self, by: str, targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "estop", lambda one: one.stop("estop", targets))

    def program_stop(
        self,
        by: str,
        verb: Literal["stop", "estop"] = "stop",
        targets: tuple[str, ...] = (),
        is_repeat: bool = False,
    ) -> None:
        """A stop over Zenoh; `is_repeat`: the last one of this operator's program again."""
        self._begin(by, verb, lambda one: one.program_stop(verb, targets, is_repeat=is_repeat))

    def put(self, by: str, sender: str, count: int = 1, payload: bytes | None = None) -> None:
        self._begin(by, "put", lambda one: one.put(sender, count, payload))

    def reset(self, by: str, targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "reset", lambda one: one.reset(targets))

    def goal(self, by: str, pattern: str | None = None, targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "goal", lambda one: one.set_goal(pattern, targets))

    def undo(self, by: str) -> None:
        self._begin(by, "undo", lambda one: one.undo())

    def resume(self, by: str, targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "resume", lambda one: one.resume(targets))

    def label(self, by: str, targets: tuple[str, ...] = (), labels: tuple[str, ...] = ()) -> None:
        self._begin(by, "label", lambda one: one.label(targets, labels))

    def incident(self, by: str, targets: tuple[str, ...] = ()) -> None:
        """An operator marks that something has happened to these robots."""
        self._begin(by, "mark", lambda one: one.mark(targets))

    def wolf(
        self, robot: str, kind: str = "mark", count: int = 30, teller: str | None = None
    ) -> None:
        """A robot tells incidents that never happened, of itself or in the name of another one."""
        daemon = self.swarm.robots.get(robot)
        if daemon is None or not daemon.is_up or daemon.is_frozen:
            return
        draw = self.swarm.chance_of_ids
        by = teller or robot
        told = [
            Incident(
                id=draw.randbytes(6).hex(), robot=by, kind=kind, text="anna: all is well", by=by,
                operator="anna" if kind == IncidentKind.MARK else "",
            )
            for _ in range(count)
        ]  # fmt: skip
        self.judge.on_wolf(robot, (one.id for one in told))
        daemon.black_box.cry(told)

    def push(self, by: str, pattern: str = "pushed", targets: tuple[str, ...] = ()) -> None:
        self._begin(by, "push", lambda one: one.push(pattern, targets))

    def _begin(self, by: str, verb: str, make: Callable[[VirtualOperator], Command]) -> None:
        if by in self.operators:  # else the child of a program that has not forked
            self.operators[by].begin(verb, make(self.operators[by]))

    def sleep(self, by: str, seconds: float, is_noticed: bool = True) -> None:
        """The processes of an operator stand still."""
        self.operators[by].sleep(seconds, is_noticed=is_noticed)

    def die(self, by: str) -> None:
        """The processes of an operator end, also those that renew a lease."""
        self.operators[by].die()

    def end_loop(self, by: str) -> None:
        """The event loop of a program that renews a lease is shut down; the program goes on."""
        self.operators[by].end_loop()

    def fork(self, by: str) -> None:
        """A program forks: the child commands, too, and renews no lease of its parent."""
        parent, name = self.operators[by], f"{by}{CHILD}"
        if name not in self.operators:
            number = len(self.operators) + 1
            self.operators[name] = VirtualOperator(self.swarm, name, number, parent)

    def set_back(self, by: str, seconds: float) -> None:
        """An operator's virtual machine is set back to its snapshot; it keeps the clock id."""
        self.operators[by].die()
        self.operators[by].shift -= seconds

    def jump(self, by: str, seconds: float) -> None:
        """The clock since boot of an operator's machine jumps, as that of a virtual machine."""
        self.operators[by].shift += seconds

    def clone(self, by: str, shift: float) -> None:
        """The operator's computer is a clone of the other one's, `shift` s ahead of it."""
        [other] = [self.operators[name] for name in OPERATORS if name != by]
        self.operators[by].die()
        self.operators[by].clock = other.clock
        self.operators[by].shift = other.shift + shift

    # Robots

    def kill(self, robot: str) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_up:
            daemon.kill()

    def leave(self, robot: str) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_up and not daemon.is_frozen:
            daemon.leave()

    def freeze(self, robot: str, seconds: float = math.inf) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_up and not daemon.is_frozen:
            daemon.freeze(seconds)

    def lose_base(self, robot: str, seconds: float) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_settled and daemon.is_up and not daemon.is_frozen:
            daemon.lose_base(seconds)

    def slow_disk(self, robot: str, seconds: float) -> None:
        """Each write takes this long from now on."""
        daemon = self.swarm.robots.get(robot)
        if daemon is not None:
            daemon.disk_time = seconds

    def thaw(self, robot: str) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_frozen:
            daemon.thaw()

    def ram(self, robot: str) -> None:
        daemon = self.swarm.robots.get(robot)
        if daemon is not None and daemon.is_up:
            daemon.ram()

    def freeze_pose(self, robot: str, seconds: float) -> None:
        """The tracker tells the robot its present pose for this time, with new stamps."""
        daemon = self.swarm.robots.get(robot)
        if daemon is not None:
            daemon.told_x, daemon.told_way = daemon.x, 0.0
            self.swarm.at(self.swarm.now + seconds, lambda: setattr(daemon, "told_x", None))

    def start(self, robot: str, disk: str = "kept", age: float = 10.0) -> None:
        """A daemon starts, after a kill if it is up; `disk`: kept, empty, or `age` s old."""
        daemon = self.swarm.robots.get(robot)
        if daemon is None:
            return
        if daemon.is_up:
            daemon.kill()
        if disk == "kept":
            daemon.start()
            return
        self.judge.forget(robot)
        daemon.start(Disk() if disk == "empty" else daemon.older_disk(age))

    def boot(self, robot: str, tick: float = JOIN_TICK) -> None:
        """A new robot starts; `tick`: s between two turns of its loop while it starts."""
        if robot not in self.swarm.robots:
            self.swarm.boot(robot, tick)

    # The network

    def split(self, groups: tuple[tuple[str, ...], ...]) -> None:
        """Groups of robots and operators that do not reach each other; others reach all."""
        self.swarm.cuts.clear()
        for number, group in enumerate(groups):
            for other in groups[number + 1 :]:
                self.swarm.cut(group, other)

    def cut(self, senders: tuple[str, ...], receivers: tuple[str, ...]) -> None:
        """Nothing passes in this direction."""
        self.swarm.cut(senders, receivers, both=False)

    def heal(self) -> None:
        self.swarm.cuts.clear()
        self.swarm.loss, self.swarm.delay = 0.0, DELAY

    def disturb(self, loss: float = 0.0, delay: float = DELAY) -> None:
        """`loss`: the share of datagrams that is lost; `delay` in s, of datagrams and links."""
        self.swarm.loss, self.swarm.delay = loss, delay

    def play_back(self, robot: str, period: float = 0.3, newest: int = 100) -> None:
        """In a secured swarm an attacker sends a robot the leases that it recorded last.

        In a swarm without keys an attacker needs no recording, and nothing is sent.
        """
        if robot in self.swarm.robots and self.swarm.is_secured:
            self.swarm.play_back(robot, period, newest)

    def wall(self, robot: str, shift: float) -> None:
        """The wall clock of a robot or an operator jumps."""
        node = self.swarm.nodes.get(robot)
        if isinstance(node, VirtualDaemon | VirtualOperator):
            node.wall += shift


def replay(count: int, steps: Sequence[HistoryStep], seed: int = 1, **options: Any) -> History:
    """Let a history happen. BrokenRuleError if it breaks a rule. `options`: of `History`."""
    is_fenced = any(one.name == "freeze_pose" for one in steps)
    history = History(count, seed, is_fenced=is_fenced, **options)
    try:
        for one in steps:
            history.carry_out(one)
        history.end()
    except BaseException:
        history.swarm.close()
        raise
    return history


# Histories by chance


def draw(seed: int, steps: int = STEPS) -> tuple[int, Steps]:
    """The count of robots and the steps of the history with this seed."""
    chance = random.Random(seed)
    count = chance.randint(3, 5)
    robots = tuple(f"r{number + 1}" for number in range(count))
    kinds, weights = zip(*_KINDS, strict=True)
    drawn = [_first(chance)]
    while len(drawn) <= steps:
        (make,) = chance.choices(kinds, weights)
        gap = round(chance.choice((0.05, 0.3, 1.0, 2.0, 4.0)) * chance.uniform(0.5, 1.5), 2)
        first, *more = made if isinstance(made := make(chance, robots), tuple) else (made,)
        drawn += replace(first, gap=gap), *more
    return count, tuple(drawn[: steps + 1])


def _first(chance: random.Random) -> HistoryStep:
    on_join = {"on_join": "run", "valid": 60.0} if chance.random() < 0.6 else {}
    return step(0.0, "run", by="anna", **on_join)


def _by(chance: random.Random) -> str:
    return chance.choice(OPERATORS)


def _some(chance: random.Random, robots: tuple[str, ...]) -> tuple[str, ...]:
    """All robots (empty), or some by name."""
    if chance.random() < 0.6:
        return ()
    return tuple(sorted(chance.sample(robots, chance.randint(1, len(robots) - 1))))


def _run(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    options: dict[str, Any] = {"pattern": chance.choice(("drive", "drive", "circle"))}
    draw = chance.random()
    if draw < 0.45:
        options |= {"on_join": "run", "valid": chance.choice((5.0, 60.0))}
    elif draw < 0.55:
        options |= {"lease": 2.0, "here": chance.choice((1.0, 8.0))}
    elif draw < 0.65:
        options |= {"ahead": 2.0}
    elif draw < 0.72:
        options |= {"has_goal": False}
    elif draw < 0.80:
        options |= {"pattern": chance.choice(("missing", "pushed"))}
    elif draw < 0.85:
        options |= {"params": {"wrong": 1}}
    elif draw < 0.95:
        options |= {"seconds": chance.choice((3.0, 20.0))}
    targets = _some(chance, robots)
    return step(0.0, "run", by=_by(chance), **({"targets": targets} if targets else {}), **options)


def _command(name: str) -> Callable[[random.Random, tuple[str, ...]], HistoryStep]:
    def make(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
        targets = _some(chance, robots)
        return step(0.0, name, by=_by(chance), **({"targets": targets} if targets else {}))

    return make


def _program_stop(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    """Of a Zenoh program, which may also repeat its last one, seconds later."""
    verb, targets = chance.choice(("stop", "stop", "estop")), _some(chance, robots)
    more: dict[str, Any] = {"is_repeat": True} if chance.random() < 0.3 else {}
    if targets:
        more["targets"] = targets
    return step(0.0, "program_stop", by=_by(chance), verb=verb, **more)


def _put(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    """A Zenoh program's messages, in its own name or that of a robot, some beyond the limits."""
    sender = chance.choice((PROGRAM, PROGRAM, *robots))
    more: dict[str, Any] = {} if chance.random() < 0.7 else {"payload": chance.randbytes(3)}
    return step(0.0, "put", by=_by(chance), sender=sender, count=chance.choice((1, 200)), **more)


def _goal(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "goal", by=_by(chance), pattern=chance.choice((None, "drive")))


def _undo(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "undo", by=_by(chance))


def _label(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "label", by=_by(chance), targets=(chance.choice(robots),), labels=("red",))


def _push(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "push", by=_by(chance))


def _robot(name: str) -> Callable[[random.Random, tuple[str, ...]], HistoryStep]:
    return lambda chance, robots: step(0.0, name, robot=chance.choice(robots))


def _start(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    disk = chance.choice(("kept", "kept", "kept", "empty", "old"))
    return step(0.0, "start", robot=chance.choice(robots), disk=disk)


def _boot(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "boot", robot=f"r{len(robots) + chance.randint(1, 2)}")


def _split(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    names = [*robots, *OPERATORS]
    chance.shuffle(names)
    parts = chance.choice((2, 2, 3))
    groups = tuple(tuple(sorted(names[number::parts])) for number in range(parts))
    return step(0.0, "split", groups=groups)


def _cut(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    one, other = chance.sample([*robots, *OPERATORS], 2)
    return step(0.0, "cut", senders=(one,), receivers=(other,))


def _heal(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    return step(0.0, "heal")


def _disturb(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    loss, delay = chance.choice((0.0, 0.1, 0.4)), chance.choice((0.005, 0.1, 0.5))
    return step(0.0, "disturb", loss=loss, delay=delay)


def _wall(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    node, shift = chance.choice((*robots, *OPERATORS)), chance.choice((-1e6, 1e6))
    return step(0.0, "wall", robot=node, shift=shift)


def _slow_disk(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    seconds = chance.choice((0.3, 2.0, 5.0))
    return step(0.0, "slow_disk", robot=chance.choice(robots), seconds=seconds)


# Several steps, of which each has its gap: what an even choice of single ones makes rarely


def _after(chance: random.Random, shortest: float, longest: float, one: HistoryStep) -> HistoryStep:
    return replace(one, gap=round(chance.uniform(shortest, longest), 2))


def _both(chance: random.Random) -> tuple[str, str]:
    """The two operators, in any order."""
    one, other = chance.sample(OPERATORS, 2)
    return one, other


def _withdrawn(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A run that is to begin at a time, and the other operator's stop before, at or after it."""
    one, other = _both(chance)
    end = step(0.0, chance.choice(("stop", "stop", "estop", "goal", "run")), by=other)
    start = step(0.0, "run", by=one, ahead=chance.choice((2.0, 4.0)))
    return start, _after(chance, 0.5, 7.0, end)


def _burst(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """Commands of both operators within half a second."""
    stops = (_command("stop"), _command("estop"), _program_stop)
    makes = (_run, _run, *stops, _command("reset"), _goal, _undo)
    pair = _both(chance)
    return tuple(
        _after(chance, 0.0, 0.25, replace(one, args=one.args | {"by": pair[number % 2]}))
        for number, one in enumerate(make(chance, robots) for make in chance.choices(makes, k=3))
    )


def _undo_chain(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    return tuple(
        _after(chance, 0.05, 4.0, step(0.0, "undo", by=_by(chance)))
        for _ in range(chance.randint(2, 4))
    )


def _cut_lease(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """An operator renews a run's lease, and some robots do not hear it for a while."""
    by, deaf = _by(chance), _some(chance, robots) or robots
    run = step(0.0, "run", by=by, lease=2.0, here=8.0)
    cut = step(0.0, "cut", senders=(by,), receivers=deaf)
    return run, _after(chance, 1.5, 5.0, cut), _after(chance, 0.5, 4.0, step(0.0, "heal"))


def _push_with_split(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """Code that reaches a part of the robots, which run it, and the others once the split heals."""
    by = _by(chance)
    steps = [
        _split(chance, robots),
        step(0.0, "push", by=by),
        step(0.0, "run", by=by, pattern="pushed", on_join="run", valid=60.0),
    ]
    chance.shuffle(steps)
    steps.append(chance.choice((step(0.0, "heal"), step(0.0, "push", by=by))))
    return tuple(_after(chance, 0.3, 4.0, one) for one in steps)


def _run_before_stop(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A run whose operator waits for a missing robot, and the other operator's stop meanwhile."""
    one, other = _both(chance)
    missing = chance.choice(robots)
    gone = chance.choice(
        (
            step(0.0, "freeze", robot=missing, seconds=chance.choice((0.9, 4.0))),
            step(0.0, "kill", robot=missing),
            step(0.0, "cut", senders=(missing,), receivers=(one,)),
            step(0.0, "start", robot=missing),
            _boot(chance, robots),
        )
    )
    start = chance.choice((_run, _run, _command("resume")))(chance, robots)
    stop = chance.choice((_command("stop"), _command("estop"), _program_stop, _goal))
    end = stop(chance, robots)
    back = chance.choice(
        (
            step(0.0, "heal"),
            step(0.0, "thaw", robot=missing),
            step(0.0, "start", robot=missing),
        )
    )
    return (
        gone,
        _after(chance, 0.0, 1.0, replace(start, args=start.args | {"by": one})),
        _after(chance, 0.02, 2.5, replace(end, args=end.args | {"by": other})),
        _after(chance, 0.1, 3.0, back),
    )


def _late_run(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A start whose operator stands still, and perhaps the other operator's stop meanwhile."""
    one, other = _both(chance)
    start = chance.choice((_run, _run, _command("resume")))(chance, robots)
    seconds = chance.choice((0.8, 3.0, 6.0, 12.0, 40.0))
    sleep = step(0.0, "sleep", by=one, seconds=seconds, is_noticed=chance.random() < 0.3)
    end = chance.choice((_command("stop"), _heal, _heal))(chance, robots)
    by = {"by": other} if end.name == "stop" else {}
    return (
        replace(start, args=start.args | {"by": one}),
        _after(chance, 0.0, 1.5, sleep),
        _after(chance, 0.1, 3.0, replace(end, args=end.args | by)),
    )


def _other_clock(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """Orders of two machines with one clock id."""
    one = _by(chance)
    shift = chance.choice((5.0, 30.0, 600.0)) * chance.choice((-1.0, 1.0))
    change = chance.choice(
        (step(0.0, "clone", by=one, shift=shift), step(0.0, "set_back", by=one, seconds=abs(shift)))
    )
    orders = [chance.choice((_run, _command("stop")))(chance, robots) for _ in range(3)]
    pair = [replace(order, args=order.args | {"by": _by(chance)}) for order in orders]
    return tuple(_after(chance, 0.05, 3.0, each) for each in (pair[0], change, *pair[1:]))


def _dead_script(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A program that renews a lease dies."""
    by = _by(chance)
    run = step(0.0, "run", by=by, lease=2.0, here=8.0)
    return run, _after(chance, 0.05, 5.0, step(0.0, "die", by=by))


def _dead_loop(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """The loop of a program that renews a lease ends, and perhaps the program commands again."""
    by = _by(chance)
    run = step(0.0, "run", by=by, lease=2.0, here=8.0)
    more = replace(_run(chance, robots), args=_run(chance, robots).args | {"by": by})
    end = _after(chance, 0.05, 5.0, step(0.0, "end_loop", by=by))
    return (run, end, _after(chance, 0.5, 4.0, more)) if chance.random() < 0.3 else (run, end)


def _play_back(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A run with a lease whose operator ends, and its recorded leases, to one robot.

    That robot has started meanwhile, is new, or was out of reach.
    """
    by, robot = _by(chance), chance.choice((*robots, f"r{len(robots) + 1}"))
    joins: dict[str, Any] = {"on_join": "run", "valid": 300.0} if chance.random() < 0.7 else {}
    run = step(0.0, "run", by=by, lease=2.0, here=8.0, **joins)
    end = step(0.0, chance.choice(("die", "end_loop")), by=by)
    away = chance.choice(
        (
            step(0.0, "start", robot=robot, disk=chance.choice(("kept", "empty"))),
            step(0.0, "boot", robot=robot),
            step(0.0, "cut", senders=(by,), receivers=(robot,)),
        )
    )
    period, newest = chance.choice(((0.1, 100), (0.3, 100), (1.0, 8)))
    replayed = step(0.0, "play_back", robot=robot, period=period, newest=newest)
    middle = [_after(chance, 0.5, 4.0, end), _after(chance, 0.05, 4.0, away)]
    chance.shuffle(middle)
    return run, *middle, _after(chance, 0.0, 3.0, replayed)


def _fork(chance: random.Random, robots: tuple[str, ...]) -> Steps:
    """A program that renews a lease forks; the child commands, and the parent may end."""
    by = _by(chance)
    makes = (_run, _command("stop"), _command("stop"), _command("estop"))
    command = chance.choice(makes)(chance, robots)
    die, end_loop = step(0.0, "die", by=by), step(0.0, "end_loop", by=by)
    ended = chance.choice((die, end_loop, step(0.0, "heal")))
    return (
        step(0.0, "run", by=by, lease=2.0, here=8.0),
        _after(chance, 0.5, 2.0, step(0.0, "fork", by=by)),
        _after(chance, 0.05, 3.0, ended),
        _after(chance, 0.05, 3.0, replace(command, args=command.args | {"by": f"{by}{CHILD}"})),
    )


def _freeze(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    """For less and more than a stall, a lease and the life of a relayed stop's first intervals."""
    seconds = chance.choice((0.2, 1.0, 2.9, 3.1, 8.0))
    return step(0.0, "freeze", robot=chance.choice(robots), seconds=seconds)


def _freeze_pose(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    seconds = chance.choice((2.0, 8.0, 60.0))
    return step(0.0, "freeze_pose", robot=chance.choice(robots), seconds=seconds)


def _lose_base(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    """For less and more than the hold that ends a run."""
    seconds = chance.choice((0.3, 1.5, 2.5, 6.0))
    return step(0.0, "lose_base", robot=chance.choice(robots), seconds=seconds)


def _wolf(chance: random.Random, robots: tuple[str, ...]) -> HistoryStep:
    """A robot cries wolf, now and then in the name of another one."""
    more = {"teller": chance.choice(robots)} if chance.random() < 0.3 else {}
    kind = chance.choice(("mark", "mark", "estop", "hazard", "silent", "fault"))
    count = chance.choice((3, 30))
    return step(0.0, "wolf", robot=chance.choice(robots), kind=kind, count=count, **more)


_Made = HistoryStep | Steps
_KINDS: tuple[tuple[Callable[[random.Random, tuple[str, ...]], _Made], float], ...] = (
    (_run, 5.0),
    (_command("stop"), 3.0),
    (_command("estop"), 2.5),
    (_program_stop, 2.0),
    (_put, 0.7),
    (_command("reset"), 3.0),
    (_command("incident"), 1.5),
    (_command("resume"), 1.0),
    (_goal, 0.5),
    (_undo, 0.7),
    (_label, 0.3),
    (_push, 0.4),
    (_robot("kill"), 0.7),
    (_robot("leave"), 0.4),
    (_robot("freeze"), 1.5),
    (_robot("thaw"), 1.5),
    (_robot("ram"), 1.0),
    (_start, 2.5),
    (_boot, 0.8),
    (_split, 2.0),
    (_cut, 0.8),
    (_heal, 2.5),
    (_disturb, 0.8),
    (_wall, 0.2),
    (_slow_disk, 0.5),
    (_freeze, 0.8),
    (_freeze_pose, 0.6),
    (_lose_base, 1.2),
    (_withdrawn, 0.6),
    (_burst, 1.0),
    (_undo_chain, 0.4),
    (_cut_lease, 0.4),
    (_push_with_split, 0.4),
    (_run_before_stop, 2.0),
    (_late_run, 1.2),
    (_other_clock, 1.2),
    (_dead_script, 0.4),
    (_wolf, 0.8),
    (_dead_loop, 0.4),
    (_play_back, 0.8),
    (_fork, 0.5),
)


# Failures


def fault_of(count: int, steps: Sequence[HistoryStep], seed: int = 1) -> BrokenRuleError | None:
    """The rule that a history breaks; None if all hold."""
    try:
        replay(count, steps, seed).swarm.close()
    except BrokenRuleError as error:
        return error
    return None


def script(count: int, steps: Sequence[HistoryStep], seed: int = 1) -> str:
    """What repeats a history in Python."""
    lines = "".join(f"        {one},\n" for one in steps)
    return f"replay(\n    {count},\n    [\n{lines}    ],\n    seed={seed},\n)"


def shrink(
    count: int, steps: Sequence[HistoryStep], rule: str, seed: int = 1, tries: int = 400
) -> tuple[int, Steps]:
    """A shorter history that breaks the same rule: fewer steps, robots and seconds.

    Delta debugging (Zeller and Hildebrandt, IEEE TSE 28, 2002) over the steps, then one by one.
    """
    left = tries

    def breaks(robots: int, some: Sequence[HistoryStep]) -> bool:
        nonlocal left
        left -= 1
        found = fault_of(robots, some, seed) if left >= 0 else None
        return found is not None and found.rule == rule

    best = tuple(steps)
    size = max(len(best) // 2, 1)
    while True:
        shorter = next(
            (
                rest
                for at in range(0, len(best), size)
                if breaks(count, rest := _without(best, at, size))
            ),
            None,
        )
        if shorter is not None:
            best = shorter
        elif size == 1:
            break
        else:
            size = max(size // 2, 1)
    while count > 2 and breaks(count - 1, best):
        count -= 1
    for at, one in enumerate(best):
        for gap in (0.05, 0.5, 1.0, 2.0):
            if gap < one.gap and breaks(count, _with(best, at, replace(one, gap=gap))):
                best = _with(best, at, replace(one, gap=gap))
                break
        for name in sorted(one.args.keys() - _NEEDED):
            args = {key: value for key, value in best[at].args.items() if key != name}
            if breaks(count, _with(best, at, replace(best[at], args=args))):
                best = _with(best, at, replace(best[at], args=args))
    return count, best


_NEEDED = frozenset({"by", "robot", "groups", "senders", "receivers", "sender", "shift", "valid"})


def _with(steps: Steps, at: int, one: HistoryStep) -> Steps:
    return (*steps[:at], one, *steps[at + 1 :])


def _without(steps: Steps, at: int, size: int) -> Steps:
    """The steps but those from `at` on; their gaps go to the step after them."""
    gone, rest = steps[at : at + size], steps[at + size :]
    if rest:
        gap = round(sum(one.gap for one in gone) + rest[0].gap, 2)
        rest = (replace(rest[0], gap=gap), *rest[1:])
    return (*steps[:at], *rest)
