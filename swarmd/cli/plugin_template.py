"""Writes a new pattern and its test; both pass the contract as they are."""

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

_TEST = '''\
"""The contract of all patterns, and tests of $name."""

{}

from $name import $kind


class Test$kind(PatternContract):
    """The contract on every platform, and tests of its own."""

    pattern = $kind

'''
_MOVEMENT = '''\
"""What $name does, in one line."""

from swarmd.api import Annotated, Inputs, MovementPattern, Params, Twist, about, nearest


class ${kind}Params(Params, frozen=True):
    """Parameters with their bounds."""

    speed: Annotated[float, about("forward speed", ge=0.0, le=1.0, unit="m/s")] = 0.15
    distance: Annotated[float, about("turns within", ge=0.1, le=3.0, unit="m")] = 0.8


class $kind(MovementPattern[${kind}Params]):
    """Drives ahead, and turns while an obstacle is near ahead."""

    params_type = ${kind}Params

    def drive(self, inputs: Inputs) -> Twist:
        """The requested command; protection may change it."""
        near = nearest(inputs.scan, half_width=1.0)
        if near is not None and near.range < self.params.distance:
            return Twist(angular=1.0)
        return Twist(linear=self.params.speed)
'''
_TESTS_MOVEMENT = '''\
    def test_drives_ahead_without_obstacles(self) -> None:
        """An empty scan."""
        subject = self.subject("burger")
        command = subject.run([scan_of(subject.platform)])[-1].twist
        assert command is not None
        assert command.linear > 0.0
        assert command.angular == 0.0

    def test_turns_in_front_of_an_obstacle(self) -> None:
        """A disc ahead, its centre 0.6 m away."""
        subject = self.subject("burger")
        command = subject.run([scan_of(subject.platform, [Disc(0.6, 0.0)])])[-1].twist
        assert command is not None
        assert command.linear == 0.0
        assert command.angular > 0.0
'''
_VOTING = '''\
"""What $name does, in one line."""

from collections.abc import Mapping

from swarmd.api import VotingParams, VotingPattern, majority


class $kind(VotingPattern[VotingParams]):
    """Stands still, sends its opinion and adopts the majority's."""

    def decide(self, votes: Mapping[str, int]) -> int:
        """The new opinion; `votes` has the latest one of each neighbour."""
        return majority(votes.values(), self.opinion, ties="keep", rng=self.context.rng)
'''
_TESTS_VOTING = '''\
    def test_adopts_the_opinion_of_the_majority(self) -> None:
        """Two against one."""
        pattern = self.subject("burger").make()
        assert isinstance(pattern, $kind)
        assert pattern.decide({"robot-2": 2, "robot-3": 2, "robot-4": 1}) == 2
'''
_PATTERN = '''\
"""What $name does, in one line."""

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
    """Parameters with their bounds."""

    turn: Annotated[float, about("turn rate", ge=-1.0, le=1.0, unit="rad/s")] = 0.5
    enough: Annotated[int, about("robots to hear", ge=1, le=100)] = 1


class $kind(Pattern[${kind}Params]):
    """Turns on the spot until it has heard enough robots, and reports how many."""

    params_type = ${kind}Params
    needs = frozenset()  # every robot can hear messages
    channels = {"count": int}

    def __init__(self, params: ${kind}Params, context: Context) -> None:
        super().__init__(params, context)
        self._heard: set[str] = set()

    def step(self, inputs: Inputs) -> Outputs:
        """The command, the message and the report of one step."""
        self._heard.update(message.sender for message in inputs.messages)
        count = len(self._heard)
        turn = self.params.turn if count < self.params.enough else 0.0
        return Outputs(
            Twist(angular=turn), messages={"count": count}, report={"heard": count}
        )
'''
_TESTS_PATTERN = '''\
    def test_turns_while_alone(self) -> None:
        """No message was heard yet."""
        outputs = self.subject("burger").make().step(Inputs(now=1.0, dt=0.0))
        assert outputs.twist is not None
        assert outputs.twist.angular > 0.0

    def test_stops_after_the_first_message(self) -> None:
        """One robot is enough by default."""
        message = Message("robot-2", "count", value=0, age=0.1)
        inputs = Inputs(now=1.0, dt=0.0, messages=(message,))
        outputs = self.subject("burger").make().step(inputs)
        assert outputs.twist is not None
        assert outputs.twist.is_zero
        assert outputs.report == {"heard": 1}
'''
_CONTRACT = "from swarmd.testing import PatternContract"
_TEXTS: Mapping[str, tuple[str, str]] = {
    "movement": (
        _MOVEMENT,
        _TEST.format(f"{_CONTRACT}\nfrom swarmd.testing.scans import Disc, scan_of")
        + _TESTS_MOVEMENT,
    ),
    "voting": (_VOTING, _TEST.format(_CONTRACT) + _TESTS_VOTING),
    "pattern": (
        _PATTERN,
        _TEST.format(f"from swarmd.api import Inputs, Message\n{_CONTRACT}") + _TESTS_PATTERN,
    ),
}


def write_plugin(name: str, folder: Path, kind: str) -> tuple[Path, Path]:
    """Write both files and return their paths; UsageError, and no file, for an unusable name."""
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
    wanted = "expected 1 to 63 of a-z, 0-9 and _, the first a letter, no word of Python's, no test_"
    raise click.UsageError(
        f"a pattern's file is a Python module, and {name!r} is no name: {wanted}"
    )


def _check_free(name: str) -> None:
    """UsageError if a module or an installed pattern has the name."""
    origin = installed_patterns().get(name)
    if origin is not None:
        raise click.UsageError(f"{origin.source} has a pattern {name!r}; take another name")
    if name in sys.stdlib_module_names or find_spec(name) is not None:
        raise click.UsageError(f"{name!r} is the name of a Python module; take another name")
