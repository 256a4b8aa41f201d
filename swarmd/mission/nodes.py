"""What the elements of a mission do, step by step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

from swarmd.mission.elements import Element, Parallel, Run, Sequence, Switch
from swarmd.mission.watch import Facts, Watch
from swarmd.values import Inputs, Outputs, Twist


class Stepper(Protocol):
    """Steps parts by name."""

    def run_part(self, name: str, inputs: Inputs) -> Outputs:
        """One step of a part."""


class Node(ABC):
    """One element. `over` says why it has ended; empty while it goes on."""

    def __init__(self, element: Element) -> None:
        self.name = element.name
        self.over = ""
        self._is_new = True
        self._watch = None if element.until is None else Watch(element.until)

    def begin(self, now: float) -> None:
        """It starts, or starts anew."""
        self.over = ""
        self._is_new = True
        if self._watch is not None:
            self._watch.begin(now)

    def check(self, facts: Facts) -> str:
        """Why it has ended, also by its own condition; to be asked before each step.

        Before its first step it has not: what its parts last reported is from another time.
        """
        is_new, self._is_new = self._is_new, False
        if self._watch is not None and not self.over and self._watch.is_met(facts) and not is_new:
            self.over = str(self._watch.condition)
        return self.over

    @abstractmethod
    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        """One step of all that is in it now; what its driver wants."""

    @property
    @abstractmethod
    def phase(self) -> str:
        """What it is at, in words."""


class _Run(Node):
    def __init__(self, element: Run) -> None:
        super().__init__(element)
        self._part = element.part

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        outputs = stepper.run_part(self._part, inputs)
        if outputs.done is not None:
            self.over = f"{self._part}: {outputs.done}"
        return outputs.twist

    @property
    def phase(self) -> str:
        return self.name


class _Sequence(Node):
    def __init__(self, element: Sequence) -> None:
        super().__init__(element)
        self._steps = [node_of(step) for step in element.steps]
        self._then = element.then
        self._index = 0

    def begin(self, now: float) -> None:
        super().begin(now)
        self._index = 0
        self._steps[0].begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        if self._steps[self._index].check(facts):
            if not self._advance(facts.now):
                return None
            self._steps[self._index].check(facts)  # its first, which ends nothing
        current = self._steps[self._index]
        twist = current.step(stepper, inputs, facts)
        if current.over and self._is_last and self._then != "repeat":
            self.over = current.over
        return twist

    def _advance(self, now: float) -> bool:
        if self._is_last and self._then != "repeat":
            self.over = self._steps[self._index].over
            return False
        self._index = (self._index + 1) % len(self._steps)
        self._steps[self._index].begin(now)
        return True

    @property
    def _is_last(self) -> bool:
        return self._index == len(self._steps) - 1

    @property
    def phase(self) -> str:
        return _joined(self.name, self._steps[self._index].phase)


class _Parallel(Node):
    def __init__(self, element: Parallel) -> None:
        super().__init__(element)
        self._items = [node_of(item) for item in element.items]
        self._driver = element.driver

    def begin(self, now: float) -> None:
        super().begin(now)
        for item in self._items:
            item.begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        wish = None
        for index, item in enumerate(self._items):
            if item.check(facts):
                continue
            twist = item.step(stepper, inputs, facts)
            if index == self._driver:
                wish = twist
        if all(item.over for item in self._items):
            self.over = "; ".join(item.over for item in self._items)
        return wish

    @property
    def phase(self) -> str:
        return self.name or "+".join(item.phase for item in self._items if not item.over)


class _Switch(Node):
    def __init__(self, element: Switch) -> None:
        super().__init__(element)
        self._branches = [
            (None if when is None else Watch(when), node_of(inner))
            for when, inner in element.branches
        ]
        self._chosen: Node | None = None

    def begin(self, now: float) -> None:
        super().begin(now)
        self._chosen = None
        for watch, _ in self._branches:
            if watch is not None:
                watch.begin(now)

    def step(self, stepper: Stepper, inputs: Inputs, facts: Facts) -> Twist | None:
        # All are asked each time: what they remember must not depend on the others.
        holds = [watch is None or watch.is_met(facts) for watch, _ in self._branches]
        chosen = next(
            (n for is_so, (_, n) in zip(holds, self._branches, strict=True) if is_so), None
        )
        if chosen is not self._chosen:
            self._chosen = chosen
            if chosen is not None:
                chosen.begin(facts.now)
        if chosen is None or chosen.check(facts):
            return None
        return chosen.step(stepper, inputs, facts)

    @property
    def phase(self) -> str:
        return _joined(self.name, "" if self._chosen is None else self._chosen.phase)


def node_of(element: Element) -> Node:
    """The node that carries an element out."""
    if isinstance(element, Run):
        return _Run(element)
    if isinstance(element, Sequence):
        return _Sequence(element)
    return _Parallel(element) if isinstance(element, Parallel) else _Switch(element)


def _joined(*names: str) -> str:
    return "/".join(name for name in names if name)
