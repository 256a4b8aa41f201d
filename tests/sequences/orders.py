"""Every fault of up to two datagrams of one run and one stop, which two operators type.

A swarm has two robots, of which one is missing. The run and the stop are begun at each of INSTANTS
instants, so in any order. Of each way (kind, sender, receiver) the FIRST datagrams and each
EACH-th repeat may be lost, copied or delayed: a stop is repeated some forty times, and its repeats
differ by when they come. A pair is made of a fault and of one more fault of a datagram that is sent
later in the history with the first fault, which such a fault may have caused.

A history is right if no rule of `invariants.py` breaks and the last order counts, by when it was
typed: after a later stop all robots stand. After a later run the robot that is there runs, unless a
datagram of the stop was delayed: a robot stands in doubt.

`python -m tests.sequences.orders --faults 2 --shard 1/8 --seconds 600 FOLDER` searches a part. Each
line of the file in FOLDER is a finished cell: a missing robot, a form of the swarm and two
instants. A second call goes on behind the last line.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

from swarmd.link.datagram import Ack, Beacon, GoalReport, MemberList, Solicit, Stop
from tests.histories.history import History, HistoryStep, step
from tests.histories.invariants import BrokenRuleError
from tests.histories.swarm import DELAY

INSTANTS = 20
STEP = 0.12  # s between two instants: a look waits some 2 s for the missing robot
COARSE = 4  # instants of the part that is searched first
WELL = 0.2  # s by which a run must be later than a stop to be later for sure
FIRST, EACH = 2, 8  # of each way of orders and answers the first ones, and each eighth repeat
MISSING: Mapping[str, tuple[int, HistoryStep]] = {  # with the robots that are there before
    "frozen": (2, step(0.0, "freeze", robot="r2")),
    "absent": (2, step(0.0, "kill", robot="r2")),
    "just booted": (1, step(0.0, "boot", robot="r2")),
}
FORMS: Mapping[str, int] = {"open": 1, "secured": 2}  # seeds
CHANGES: Mapping[str, tuple[float, ...]] = {  # s after its time at which a datagram arrives
    "lost": (),
    "copied at once": (0.0, 0.0),
    "copied after 0.5 s": (0.0, 0.5),
    "copied after 2 s": (0.0, 2.0),
    "delayed by 0.5 s": (0.5,),
    "delayed by 2 s": (2.0,),
}
OPERATORS = ("anna", "bob")
_KINDS: Mapping[type, str] = {
    Stop: "stop",
    Ack: "ack",
    GoalReport: "goal",
    Solicit: "look",
    Beacon: "beacon",
    MemberList: "members",
}
_CALLS = {"_hand": "run", "_take_reply": "reply", "_view": "view"}
_ORDERS = {"stop", "ack", "goal", "run", "reply"}  # beside the look of the run's operator
_LOOK = {"look", "beacon", "members", "view"}
_LOOKING = ({"anna", "r1"}, {"anna", "r2"})


class Sent(NamedTuple):
    """A datagram, request or reply; `number`: which one of its way it is, from 0."""

    kind: str
    sender: str
    receiver: str
    number: int


class Fault(NamedTuple):
    """What happens to a datagram: a word of CHANGES."""

    sent: Sent
    change: str

    @property
    def is_late_stop(self) -> bool:
        """True if a robot hears a stop late."""
        return self.sent.kind == "stop" and self.change.startswith("delayed")

    def __str__(self) -> str:
        sent = self.sent
        return f"{sent.kind} {sent.sender}>{sent.receiver} {sent.number} {self.change}"


class Network:
    """Carries out faults, and records what is sent; a `Disturbance`."""

    def __init__(self, history: History, faults: Sequence[Fault]) -> None:
        self._history, self._faults = history, dict(faults)
        self._counts: Counter[tuple[str, str, str]] = Counter()
        self.sent: list[Sent] = []  # what may be disturbed, in order

    def arrivals(self, sender: str, receiver: str, what: object) -> tuple[float, ...]:
        """As its `Faults` say."""
        kind = self._kind_of(sender, receiver, what)
        if not kind:
            return (0.0,)
        way = kind, sender, receiver
        sent = Sent(*way, self._counts[way])
        self._counts[way] += 1
        is_early = sent.number < (1 if kind in _LOOK else FIRST)
        if not is_early and (kind in _LOOK or sent.number % EACH):
            return (0.0,)
        self.sent.append(sent)
        change = self._faults.get(sent)
        arrivals = (0.0,) if change is None else CHANGES[change]
        swarm = self._history.swarm
        swarm.slowest = max(swarm.slowest, DELAY + max(arrivals, default=0.0))
        return arrivals

    def _kind_of(self, sender: str, receiver: str, what: object) -> str:
        """The kind, empty for what carries no order, no answer and no look for a run."""
        kind = _KINDS.get(type(what)) or _CALLS.get(_called(what), "")
        if kind in _ORDERS:
            is_heard = receiver not in OPERATORS or kind in ("ack", "reply")
            return kind if is_heard else ""
        is_look = kind in _LOOK and self._history.operators["anna"].under_way > 0
        return kind if is_look and {sender, receiver} in _LOOKING else ""


def _called(what: object) -> str:
    """The name of the function that is called at the end of a link."""
    while isinstance(what, partial):
        what = what.func
    return getattr(what, "__name__", "")


@dataclass(frozen=True)
class Cell:
    """A missing robot, the form of the swarm, and the instants of the orders."""

    missing: str
    form: str
    run: int
    stop: int

    @property
    def is_coarse(self) -> bool:
        """True for each COARSE-th instant, and for a stop right after such a run."""
        is_grid = self.stop % COARSE == 0 or self.stop == self.run + 1
        return is_grid and self.run % COARSE == 0


@dataclass
class Case:
    """One history; `text`: what is wrong with it. `sent`: what might be disturbed in it."""

    cell: Cell
    faults: tuple[Fault, ...] = ()
    text: str = ""
    sent: list[Sent] = field(default_factory=list)

    def __str__(self) -> str:
        faults = "; ".join(map(str, self.faults)) or "no fault"
        run, stop = STEP * self.cell.run, STEP * self.cell.stop
        head = f"r2 {self.cell.missing}, {self.cell.form}, run at {run:.2f} s, stop at {stop:.2f} s"
        return f"{head}, {faults}: {self.text or 'right'}"


def play(cell: Cell, faults: Sequence[Fault] = ()) -> Case:
    """Let a history happen."""
    case = Case(cell, tuple(faults))
    try:
        case.text = _play(case)
    except BrokenRuleError as error:
        case.text = str(error)
    return case


def _play(case: Case) -> str:
    cell = case.cell
    count, missing = MISSING[cell.missing]
    history = History(count, FORMS[cell.form])
    swarm = history.swarm
    network = Network(history, case.faults)
    case.sent = network.sent
    history.carry_out(missing)
    swarm.disturbance = network
    orders = [(cell.run, step(0.0, "run", by="anna")), (cell.stop, step(0.0, "stop", by="bob"))]
    begun = swarm.now
    for instant, order in sorted(orders, key=lambda pair: pair[0]):
        swarm.advance(begun + STEP * instant - swarm.now)
        history.carry_out(order)
    history.await_commands()
    swarm.disturbance = None
    history.end()
    running = {name for name, one in swarm.robots.items() if one.robot.is_running}
    if cell.stop > cell.run and running:
        return f"{sorted(running)} run after the stop, which was typed last"
    is_clear = STEP * (cell.run - cell.stop) >= WELL
    if is_clear and not any(fault.is_late_stop for fault in case.faults) and "r1" not in running:
        return "r1 stands after the run, which was typed last"
    return ""


def cells() -> list[Cell]:
    """All cells: first those of a coarse grid, then the others; each part in an order by chance."""
    instants = range(INSTANTS)
    all_cells = [Cell(*one) for one in product(MISSING, FORMS, instants, instants)]
    random.Random(1).shuffle(all_cells)
    return sorted(all_cells, key=lambda cell: not cell.is_coarse)


def faults_behind(sent: Sequence[Sent], first: int = 0) -> Iterator[tuple[int, Fault]]:
    """Each fault of what was sent from number `first` on, with the number."""
    for at in range(first, len(sent)):
        for change in CHANGES:
            yield at, Fault(sent[at], change)


def search(cell: Cell, most: int) -> Iterator[Case]:
    """The histories of a cell with exactly `most` faults."""
    base = play(cell)
    if most == 0:
        yield base
        return
    for at, fault in faults_behind(base.sent):
        one = play(cell, (fault,))
        if most == 1:
            yield one
            continue
        for _, second in faults_behind(one.sent, at + 1):
            yield play(cell, (fault, second))


def estimate(seed: int = 1, count: int = 12) -> tuple[int, int, float]:
    """How many histories have one and two faults, and the CPU seconds of one, by some cells."""
    some = random.Random(seed).sample(cells(), count)
    began, singles, pairs = time.process_time(), 0, 0
    for cell in some:
        sent = len(play(cell).sent)
        singles += len(CHANGES) * sent
        pairs += len(CHANGES) ** 2 * sent * (sent - 1) // 2
    seconds = (time.process_time() - began) / count
    return singles * len(cells()) // count, pairs * len(cells()) // count, seconds


def main(folder: Path, arguments: Sequence[str]) -> int:
    """Search a part and add its finished cells to a file in `folder`; 1 if something is wrong."""
    parser = argparse.ArgumentParser(prog="tests.sequences orders", description=__doc__)
    parser.add_argument("--faults", type=int, choices=(0, 1, 2), default=1)
    parser.add_argument("--shard", default="1/1", help="K/N, from 1/N to N/N")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of CPU time")
    parser.add_argument("--estimate", action="store_true", help="only tell the size of the search")
    chosen = parser.parse_args(arguments)
    if chosen.estimate:
        singles, pairs, seconds = estimate()
        print(f"{len(cells())} cells, {singles} single faults, {pairs} pairs, {seconds:.3f} s each")
        return 0
    number, of = map(int, chosen.shard.split("/"))
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"orders-{chosen.faults}-{number}of{of}.jsonl"
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    finished = {tuple(one["cell"]) for one in done}
    count, wrong = sum(one["histories"] for one in done), sum(len(one["wrong"]) for one in done)
    part, began = cells()[number - 1 :: of], time.process_time()
    with path.open("a") as lines:
        for cell in part:
            key = cell.missing, cell.form, cell.run, cell.stop
            if key in finished:
                continue
            if time.process_time() - began > chosen.seconds:
                break
            found, histories = list[str](), 0
            for case in search(cell, chosen.faults):
                histories += 1
                if case.text:
                    found.append(str(case))
                    print(case, flush=True)
            lines.write(json.dumps({"cell": key, "histories": histories, "wrong": found}) + "\n")
            lines.flush()
            finished.add(key)
            count, wrong = count + histories, wrong + len(found)
    print(
        f"{len(finished)} of {len(part)} cells, {count} histories with {chosen.faults} faults,"
        f" {wrong} wrong"
    )
    return 1 if wrong else 0


if __name__ == "__main__":
    *words, where = sys.argv[1:] or ["--estimate", "."]
    sys.exit(main(Path(where), words))
