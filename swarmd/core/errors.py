"""The exceptions of the project, as one tree.

::

    SwarmError
    ├── ConfigError      a file, a key or a parameter is wrong; nothing was started, nothing moved
    │   └── ParameterError       a pattern's parameter is unknown, missing or out of bounds
    ├── CodecError       bytes that do not fit the key they came on; dropped and counted
    ├── PluginError      a pattern or driver cannot be found, loaded or used on this robot
    │   ├── ChangedCodeError     the SHA-256 of a pushed pattern's code differs from its manifest
    │   ├── UnknownPatternError  no pattern has this name
    │   └── MissingSensorError   the platform lacks what a pattern or condition needs
    ├── DriverError      the robot's base cannot be reached or does not answer as it should
    ├── NetworkError     no session, no peers, no answer
    │   ├── IdHeldError  the robot's id belongs to another daemon of the swarm
    │   └── ForkedError  this process was forked from one whose connection it cannot use
    └── RequestError     an operator's request or query of all robots failed as a whole

Every message names what is wrong, where, what was expected and what to do, in one line.

`CoreFault` is outside this tree: it carries an error of the robot's core through
`except Exception` and ends the daemon.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class SwarmError(Exception):
    """The root of all errors that this project raises on purpose."""


class ConfigError(SwarmError):
    """A file, a key or a parameter is wrong."""


class ParameterError(ConfigError):
    """A pattern's parameter is wrong. `parameter` is its name; empty if several do not fit."""

    def __init__(self, text: str, parameter: str = "") -> None:
        super().__init__(text)
        self.parameter = parameter


class CodecError(SwarmError):
    """Bytes that do not fit the key they came on."""


class PluginError(SwarmError):
    """A pattern or driver cannot be found, loaded or used."""


class ChangedCodeError(PluginError):
    """The file of a pushed pattern is missing or has another SHA-256 than its manifest."""


class UnknownPatternError(PluginError):
    """No pattern has this name."""


class MissingSensorError(PluginError):
    """The platform does not provide what a pattern or a condition needs."""


class DriverError(SwarmError):
    """The robot's base cannot be reached or misbehaves."""


class NetworkError(SwarmError):
    """No session, no peers or no answer."""


class IdHeldError(NetworkError):
    """The robot's id belongs to another daemon of this swarm."""


class ForkedError(NetworkError):
    """A process that was forked lacks the threads of the connection that its parent opened."""


class RequestError(SwarmError):
    """An operator's request, or a query of all robots, that failed as a whole.

    The answers of single robots are in an `Outcome`. `exit_code`: the exit code of swarmctl; see
    `swarmd.operator.session.exit_codes`.
    """

    def __init__(self, text: str, exit_code: int) -> None:
        super().__init__(text)
        self.exit_code = exit_code


class CoreFault(BaseException):
    """An error of the robot's core, kept as `__cause__`. It ends the daemon."""


def fail_stop(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function of the robot's core: its errors are raised as `CoreFault`."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except Exception as error:
            raise CoreFault from error

    return run


_MAX_HINTS = 4


def unknown(what: str, name: str, known: Iterable[str]) -> str:
    """One line for an unknown name, with a suggestion.

    Suggests the known names that contain `name` as a word or after a colon, else the most similar
    name, or the name that is most similar after its colon. Else all: first those with a colon,
    which are the user's own.
    """
    names = sorted(known, key=lambda one: (":" not in one, one))
    having = [one for one in names if name in one.split("_") or one.endswith(f":{name}")]
    if 0 < len(having) <= _MAX_HINTS:
        text = " or ".join(filter(None, [", ".join(map(repr, having[:-1])), repr(having[-1])]))
        return f"no {what} {name!r}; did you mean {text}?"
    ends = {end: one for one in names for end in (one.rpartition(":")[2], one)}
    if close := nearest(name, ends):
        return f"no {what} {name!r}; did you mean {ends[close]!r}?"
    return f"no {what} {name!r}; there are: {', '.join(names) or 'none'}"


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name that is most similar to `name`; empty if none is similar."""
    from difflib import get_close_matches  # 1 ms of each start of swarmctl

    return next(iter(get_close_matches(name, sorted(known), n=1, cutoff=0.6)), "")


def named(value: object) -> str:
    """The type of a value in words, for messages: `None`, `a tuple`, `an int`."""
    kind = type(value).__name__
    if value is None:
        return "None"
    return f"an {kind}" if kind[0] in "aeiouAEIOU" else f"a {kind}"
