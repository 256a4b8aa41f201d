"""Writes a pattern and its test to begin with; both hold to the contract as they are."""

from __future__ import annotations

import keyword
import sys
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from string import Template

import click

from swarmd.core.keys import is_id
from swarmd.plugins import installed_patterns

_MOVEMENT = '''\
"""What $name is, in a line."""

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about, nearest


class ${kind}Params(Params, frozen=True):
    """What can be set, and its bounds."""

    speed: Annotated[float, about("its speed", ge=0.0, le=1.0, unit="m/s")] = 0.15
    distance: Annotated[float, about("what is near", ge=0.1, le=3.0, unit="m")] = 0.8


class $kind(MovementPattern[${kind}Params]):
    """Drives ahead, and turns while something is near ahead."""

    params_type = ${kind}Params

    def drive(self, inputs: Inputs) -> Twist:
        """What it wishes to do now; protection has the last word."""
        near = nearest(inputs.scan, half_width=1.0)
        if near is not None and near.range < self.params.distance:
            return Twist(angular=1.0)
        return Twist(linear=self.params.speed)
'''
_TEST_MOVEMENT = '''\
"""What $name has to hold to, and what it is for."""

from swarmd.testing import PatternContract
from swarmd.testing.scans import Disc, scan_of

from $name import $kind


class Test$kind(PatternContract):
    """The contract, on every platform, and tests of its own."""

    pattern = $kind

    def test_drives_ahead_where_nothing_is(self) -> None:
        """An empty scan."""
        subject = self.subject("burger")
        wish = subject.run([scan_of(subject.platform)])[-1].twist
        assert wish is not None
        assert wish.linear > 0.0
        assert wish.angular == 0.0

    def test_turns_in_front_of_something(self) -> None:
        """A disc ahead, its centre 0.6 m away."""
        subject = self.subject("burger")
        wish = subject.run([scan_of(subject.platform, [Disc(0.6, 0.0)])])[-1].twist
        assert wish is not None
        assert wish.linear == 0.0
        assert wish.angular > 0.0
'''
_VOTING = '''\
"""What $name is, in a line."""

from collections.abc import Mapping

from swarmd.api import VotingParams, VotingPattern, majority


class $kind(VotingPattern[VotingParams]):
    """Stands, sends its opinion and adopts that of most neighbours."""

    def decide(self, votes: Mapping[str, int]) -> int:
        """The new opinion; `votes` has the latest one of each neighbour."""
        return majority(votes.values(), self.opinion, ties="keep", rng=self.context.rng)
'''
_TEST_VOTING = '''\
"""What $name has to hold to, and what it is for."""

from swarmd.testing import PatternContract

from $name import $kind


class Test$kind(PatternContract):
    """The contract, on every platform, and tests of its own."""

    pattern = $kind

    def test_adopts_what_most_neighbours_hold(self) -> None:
        """Two against one."""
        pattern = self.subject("burger").make()
        assert isinstance(pattern, $kind)
        assert pattern.decide({"robot-2": 2, "robot-3": 2, "robot-4": 1}) == 2
'''
_PATTERN = '''\
"""What $name is, in a line."""

from swarmd.api import (
    Annotated,
    Context,
    Inputs,
    Outputs,
    Params,
    Pattern,
    Twist,
    about,
)


class ${kind}Params(Params, frozen=True):
    """What can be set, and its bounds."""

    turn: Annotated[float, about("its speed", ge=-1.0, le=1.0, unit="rad/s")] = 0.5
    least: Annotated[int, about("neighbours to meet", ge=1, le=100)] = 1


class $kind(Pattern[${kind}Params]):
    """Turns on the spot until it has met enough neighbours, and says how many."""

    params_type = ${kind}Params
    needs = frozenset({"neighbors"})
    channels = {"met": int}

    def __init__(self, params: ${kind}Params, context: Context) -> None:
        super().__init__(params, context)
        self._met: set[str] = set()

    def step(self, inputs: Inputs) -> Outputs:
        """One step: what it wishes, says and reports."""
        self._met.update(neighbor.id for neighbor in inputs.neighbors)
        count = len(self._met)
        turn = self.params.turn if count < self.params.least else 0.0
        told = {"met": count}
        return Outputs(Twist(angular=turn), messages=told, report=told)
'''
_TEST_PATTERN = '''\
"""What $name has to hold to, and what it is for."""

from swarmd.api import Inputs
from swarmd.testing import PatternContract

from $name import $kind


class Test$kind(PatternContract):
    """The contract, on every platform, and tests of its own."""

    pattern = $kind

    def test_turns_while_it_is_alone(self) -> None:
        """Before any neighbour was there."""
        outputs = self.subject("burger").make().step(Inputs(now=1.0, dt=0.0))
        assert outputs.twist is not None
        assert outputs.twist.angular > 0.0

    def test_stands_once_it_has_met_enough(self) -> None:
        """The contract's story has two neighbours."""
        outputs = self.subject("burger").run([None])[-1]
        assert outputs.twist is not None
        assert outputs.twist.is_zero
        assert outputs.report == {"met": 2}
'''
_TEXTS: Mapping[str, tuple[str, str]] = {
    "movement": (_MOVEMENT, _TEST_MOVEMENT),
    "voting": (_VOTING, _TEST_VOTING),
    "pattern": (_PATTERN, _TEST_PATTERN),
}


def write_plugin(name: str, folder: Path, kind: str) -> tuple[Path, Path]:
    """Write both files and give their paths; UsageError, and no file, for a name that won't do."""
    _check_name(name)
    paths = (folder / f"{name}.py", folder / f"test_{name}.py")
    for path in paths:
        if path.exists():
            raise click.UsageError(f"{path} is there already; move it away or take another name")
    _check_free(name)
    class_name = "".join(word.capitalize() for word in name.split("_"))
    if class_name in "".join(_TEXTS[kind]):  # such as Twist, which it imports
        class_name += "Pattern"
    folder.mkdir(parents=True, exist_ok=True)
    for path, text in zip(paths, _TEXTS[kind], strict=True):
        with path.open("x", encoding="utf-8") as file:
            file.write(Template(text).substitute(name=name, kind=class_name))
    return paths


def _check_name(name: str) -> None:
    is_test = name.startswith("test_")
    if is_id(name) and name.isidentifier() and not keyword.iskeyword(name) and not is_test:
        return
    wanted = (
        "wanted are 1 to 63 of a-z, 0-9 and _, the first a letter, no word of Python's, no test_"
    )
    raise click.UsageError(
        f"a pattern's file is a Python module, and {name!r} is no name: {wanted}"
    )


def _check_free(name: str) -> None:
    """A file is not to have the name of what others import, or of a pattern that is installed."""
    origin = installed_patterns().get(name)
    if origin is not None:
        raise click.UsageError(f"{origin.source} has a pattern {name!r}; take another name")
    if name in sys.stdlib_module_names or find_spec(name) is not None:
        raise click.UsageError(f"{name!r} is a module that others import; take another name")
