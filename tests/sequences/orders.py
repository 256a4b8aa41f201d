"""One run and one stop of two operators, and every fault of up to two of their messages.

A case is a robot that is missing, the instants at which the run and the stop are typed, and faults:
a message that is lost, arrives once more after 0.5 or 2 s, or arrives 0.5 or 2 s late. Messages are
the datagrams between operators and robots, and the requests and answers by links. The operators
look, admit and repeat as `swarmctl` does, and two robots obey. The rules of
tests/histories/invariants.py hold all the time, and at the end all robots stand if the stop was
typed last::

    python -m tests.sequences.orders build/sequences --faults 1 --shard 0/2

Cells (a missing robot and both instants) that have ended are lines of a file of the folder, so that
the same command continues. `--share` takes a part of all cells, by a seed.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import NamedTuple

from tests.histories.history import History, HistoryStep, step
from tests.histories.invariants import BrokenRuleError
from tests.histories.swarm import Delivery

INSTANTS = 20
STEP = 0.12  # s between two instants: a look waits some 2 s for the missing robot
# What happens to the second robot before the first order; it starts or thaws at the end.
MISSING: Mapping[str, tuple[HistoryStep, ...]] = {
    "none": (),
    "frozen": (step(0.0, "freeze", robot="r2"),),
    "absent": (step(0.0, "kill", robot="r2"),),
    "just booted": (step(0.0, "boot", robot="r2"),),
}
# When a message arrives, in s after its time.
FAULTS: Mapping[str, tuple[float, ...]] = {
    "lost": (),
    "copied 0.5 s later": (0.0, 0.5),
    "copied 2 s later": (0.0, 2.0),
    "0.5 s late": (0.5,),
    "2 s late": (2.0,),
}
OPERATORS = frozenset({"anna", "bob"})
FIRST = 2
"""Messages of a kind from a sender to a receiver that faults may meet; later ones repeat them."""
Arrivals = Mapping[Delivery, tuple[float, ...]]


class Cell(NamedTuple):
    """A missing robot, and the instants (0 to INSTANTS - 1) of the run and of the stop."""

    missing: str
    run: int
    stop: int


class Finding(NamedTuple):
    """A case that breaks a rule."""

    cell: Cell
    faults: tuple[tuple[Delivery, str], ...]
    text: str


def cells() -> Iterator[Cell]:
    """All cells."""
    for missing, run, stop in product(MISSING, range(INSTANTS), range(INSTANTS)):
        yield Cell(missing, run, stop)


def play(cell: Cell, arrivals: Arrivals) -> dict[tuple[str, str, str], int]:
    """Let one history happen; returns the number of deliveries by sender, receiver and kind.

    BrokenRuleError if it breaks a rule; AssertionError if the stop was last and a robot runs.
    """
    history = History(1 if cell.missing == "just booted" else 2)
    swarm = history.swarm
    for one in MISSING[cell.missing]:
        history.carry_out(one)
    swarm.deliveries.clear()
    swarm.arrivals = arrivals
    orders = [
        (STEP * cell.run, step(0.0, "run", by="anna")),
        (STEP * cell.stop, step(0.0, "stop", by="bob")),
    ]
    begun = swarm.now
    for at, order in sorted(orders, key=lambda pair: pair[0]):
        swarm.advance(begun + at - swarm.now)
        history.carry_out(order)
    history.await_commands()
    seen = dict(swarm.deliveries)
    history.end()
    if cell.stop > cell.run:
        running = sorted(name for name, one in swarm.robots.items() if one.robot.is_running)
        assert not running, f"the stop was typed last, and {running} run"
    return seen


def messages(cell: Cell) -> list[Delivery]:
    """The messages of a case without faults that faults may meet."""
    return [
        Delivery(*who, number)
        for who, count in sorted(play(cell, {}).items())
        if len(OPERATORS & {*who[:2]}) == 1  # between an operator and a robot
        for number in range(min(count, FIRST))
    ]


def judged(cell: Cell, faults: Sequence[tuple[Delivery, str]]) -> Finding | None:
    """What a case breaks; None if it breaks nothing."""
    try:
        play(cell, {one: FAULTS[name] for one, name in faults})
    except (BrokenRuleError, AssertionError) as error:
        return Finding(cell, tuple(faults), str(error).partition("\n")[0])
    return None


def search(
    cell: Cell, count: int, share: float, chance: random.Random
) -> tuple[int, list[Finding]]:
    """Judge the cases of a cell with up to `count` faults; how many, and what broke a rule.

    That without a fault first: if it breaks a rule, no other is played. `share`: of the others.
    """
    if (found := judged(cell, ())) is not None:
        return 1, [found]
    played, findings = 1, []
    met = messages(cell)
    for number in range(1, count + 1):
        for some in combinations(met, number):
            for names in product(FAULTS, repeat=number):
                if share < 1.0 and chance.random() >= share:
                    continue
                played += 1
                found = judged(cell, tuple(zip(some, names, strict=True)))
                if found is not None:
                    findings.append(found)
    return played, findings


def main(folder: Path, arguments: Sequence[str]) -> int:
    """Search, and write to `folder`; 1 if a rule was broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.sequences orders", description=__doc__)
    parser.add_argument("--faults", type=int, default=1, help="faults of a case, at most")
    parser.add_argument("--shard", default="0/1", help="K/N: each N-th cell from the K-th on")
    parser.add_argument("--share", type=float, default=1.0, help="of the cases of each cell")
    given = parser.parse_args(arguments)
    shard, shards = map(int, given.shard.split("/"))
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"orders-{given.faults}-{given.share:g}.jsonl"
    ended: dict[Cell, tuple[int, int]] = {}
    if file.exists():
        for line in file.read_text().splitlines():
            *cell, played, broken = json.loads(line)
            ended[Cell(*cell)] = played, broken
    for number, cell in enumerate(cells()):
        if number % shards != shard or cell in ended:
            continue
        chance = random.Random(number)
        played, findings = search(cell, given.faults, given.share, chance)
        for found in findings:
            faults = ", ".join(f"{' '.join(map(str, one))} {name}" for one, name in found.faults)
            print(f"{cell}: {faults or 'no fault'}: {found.text}", flush=True)
        with file.open("a") as lines:
            lines.write(json.dumps([*cell, played, len(findings)]) + "\n")
        ended[cell] = played, len(findings)
    played_in_all = sum(played for played, _ in ended.values())
    broken_in_all = sum(broken for _, broken in ended.values())
    print(f"{len(ended)} cells, {played_in_all} cases, {broken_in_all} break a rule")
    return int(broken_in_all > 0)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
