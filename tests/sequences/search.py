"""Search through all sequences of actions, each carried out on a world of its own.

A world is made anew for each of the longest sequences; the shorter ones are judged on the way. No
state is saved or copied, so that one sequence never disturbs another one. A copy by `fork` at each
node was measured: a robot takes 3 ms to be made and 1 ms for an action, the pages that a fork
writes 10 ms.

A search is cut into units: each sequence of one action, and each pair of actions with all that
begin with it. A finished unit is a line of a file, and the same command goes on after the last
line. `jobs` units run at a time, each in a process of its own.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Protocol, TypeVar

import msgspec
from msgspec import Struct

from tests.histories.invariants import BrokenRuleError

Labels = tuple[str, ...]
T = TypeVar("T")
R = TypeVar("R")
DRAWN = 1000
"""Sequences of a draw."""
UNIT = 2
"""Actions of a unit: a pair, with all sequences that begin with it."""


class World(Protocol):
    """What the actions change, and who judges it."""

    def act(self, label: str) -> None:
        """Carry an action out. BrokenRuleError if a rule does not hold; any error is a fault."""

    @property
    def tested(self) -> frozenset[str]:
        """The names of the rules that the actions so far have put to the test."""

    @property
    def outcome(self) -> str:
        """The present state in words, to count what a search has reached."""


Choices = Callable[[Labels], Sequence[str]]
"""The actions that may follow a sequence."""


class Violation(Struct, frozen=True):
    """A sequence that breaks a rule; `labels`: its actions."""

    labels: Labels
    rule: str
    text: str


class Tally(Struct):
    """What a search has seen.

    - `sequences`: their number; one that breaks a rule is not continued.
    - `judged`: by rule, the number of sequences that put it to the test.
    - `outcomes`: how many sequences end in each state.
    """

    sequences: int = 0
    judged: dict[str, int] = {}
    outcomes: dict[str, int] = {}
    violations: list[Violation] = []

    def add(self, other: Tally) -> None:
        """Add what another search has seen."""
        self.sequences += other.sequences
        self.violations += other.violations
        for mine, its in ((self.judged, other.judged), (self.outcomes, other.outcomes)):
            for name, count in its.items():
                mine[name] = mine.get(name, 0) + count

    def count(self, world: World) -> None:
        """Count a sequence that has led to this world, and broke no rule."""
        self.sequences += 1
        self.outcomes[world.outcome] = self.outcomes.get(world.outcome, 0) + 1
        for rule in world.tested:
            self.judged[rule] = self.judged.get(rule, 0) + 1


class Unit(Struct, frozen=True):
    """A finished part of a search: all sequences that begin with `prefix`."""

    prefix: Labels
    tally: Tally


class Head(Struct, frozen=True):
    """The first line of a file: the search, and a digest of the code that was searched."""

    name: str
    depth: int
    digest: str


@dataclass(frozen=True)
class Search:
    """All sequences of up to `depth` actions; `make` makes the world in which each begins."""

    make: Callable[[], World]
    choices: Choices
    depth: int

    def replay(self, labels: Labels, tally: Tally, since: int = 0) -> int:
        """Carry one sequence out, and count its parts that are longer than `since` actions.

        Returns the actions up to the first fault, which may lie in the shorter parts; 0 without.
        """
        world = self.make()
        for at, label in enumerate(labels, 1):
            try:
                world.act(label)
            except BrokenRuleError as error:
                violation = Violation(labels[:at], error.rule, str(error))
            except Exception as error:
                violation = Violation(labels[:at], "exception", f"rule exception: {error!r}")
            else:
                if at > since:
                    tally.count(world)
                continue
            if at > since:
                tally.sequences += 1
                tally.violations.append(violation)
            return at
        return 0

    def explore(self, prefix: Labels, depth: int) -> Tally:
        """The tally of `prefix`, and of all sequences up to `depth` that begin with it."""
        tally, broken = Tally(), None
        previous = prefix[:-1]
        for labels in self._longest(prefix, depth):
            if broken is None or labels[: len(broken)] != broken:
                known = next(i for i, one in enumerate(labels) if previous[i : i + 1] != (one,))
                if at := self.replay(labels, tally, known):
                    broken = labels[:at]
                previous = labels
        return tally

    def _longest(self, prefix: Labels, depth: int) -> Iterator[Labels]:
        following = self.choices(prefix) if len(prefix) < depth else ()
        for label in following:
            yield from self._longest((*prefix, label), depth)
        if not following:
            yield prefix

    def units(self) -> Iterator[Labels]:
        """The prefixes of the units: one action alone, or a pair with all that follow."""
        for first in self.choices(()):
            yield (first,)
            if self.depth >= UNIT:
                yield from ((first, second) for second in self.choices((first,)))

    def unit(self, prefix: Labels) -> Unit:
        """A finished unit."""
        return Unit(prefix, self.explore(prefix, self.depth if len(prefix) == UNIT else 1))

    def run(
        self,
        jobs: int = 1,
        file: Path | None = None,
        head: Head | None = None,
        tell: Callable[[int, Tally], None] = lambda done, total: None,
    ) -> Tally:
        """The tally of the search.

        `jobs`: processes that compute; 1: this one. `file`, `head`: keeps finished units; those of
        another search or of other code are dropped. `tell` hears of the share that is done, in
        percent, and the tally.
        """
        done = {} if file is None or head is None else read(file, head)
        total = Tally()
        for tally in done.values():
            total.add(tally)
        wanted = list(self.units())
        for unit in _each(self.unit, [prefix for prefix in wanted if prefix not in done], jobs):
            done[unit.prefix] = unit.tally
            total.add(unit.tally)
            if file is not None:
                with file.open("ab") as opened:
                    opened.write(msgspec.json.encode(unit) + b"\n")
            tell(100 * len(done) // len(wanted), total)
        return total

    def draw(self, seed: int) -> Tally:
        """The tally of DRAWN random sequences of `depth` actions; a shorter fault counts, too."""
        rng, tally = Random(seed), Tally()
        for _ in range(DRAWN):
            labels: Labels = ()
            while len(labels) < self.depth:
                labels += (rng.choice(self.choices(labels)),)
            if 0 < self.replay(labels, tally, self.depth - 1) < self.depth:
                self.replay(labels, tally)  # of these the shorter parts count, too
        return tally

    def draws(self, count: int, jobs: int) -> Tally:
        """The tally of the first `count` draws."""
        total = Tally()
        for tally in _each(self.draw, range(count), jobs):
            total.add(tally)
        total.violations = list({one.labels: one for one in total.violations}.values())
        return total

    def shortest(self) -> Violation | None:
        """The first of the shortest sequences that break a rule; None if all hold."""
        for depth in range(1, self.depth + 1):
            for labels in self._longest((), depth):
                tally = Tally()
                if self.replay(labels, tally, depth - 1):
                    return next(iter(tally.violations))
        return None


def _each(work: Callable[[T], R], of: Sequence[T], jobs: int) -> Iterable[R]:
    """The results of `work`, as they are finished."""
    if jobs == 1:
        yield from map(work, of)
        return
    with multiprocessing.get_context("fork").Pool(jobs) as pool:
        yield from pool.imap_unordered(work, of)


def read(file: Path, head: Head) -> dict[Labels, Tally]:
    """The finished units of this search; the file is begun anew if it is of another one.

    A last line that was cut off is dropped.
    """
    lines = file.read_bytes().splitlines(keepends=True) if file.exists() else []
    whole = [line for line in lines if line.endswith(b"\n")]
    if not whole or msgspec.json.decode(whole[0], type=Head) != head:
        whole = [msgspec.json.encode(head) + b"\n"]
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(b"".join(whole))
    found = [msgspec.json.decode(line, type=Unit) for line in whole[1:]]
    return {unit.prefix: unit.tally for unit in found}
