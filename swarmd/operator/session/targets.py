"""What a caller gives to a verb: targets, times, words, parameters, and who asks.

- `Targets` of a request: names, globs and labels, and the robots that they match. `targets_of`
  gives the robots that must answer. Labels are known only from statuses.
- `check_time`, `check_words` and `plain_params` check and convert arguments of methods.
- `remember` and `remembered` keep names and labels of robots, for the completion of command lines.
- `operator_name` and the reasons of requests are shortened so that requests and datagrams can carry
  them. A stop must not fail because of its reason: a text that is too long is cut, and a character
  without an encoding in UTF-8 is replaced.
"""

from __future__ import annotations

import contextlib
import getpass
import math
import os
import socket
import time
from collections.abc import Collection, Iterable, Mapping
from fnmatch import fnmatchcase
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.errors import ConfigError, RequestError, unknown
from swarmd.core.files import cache_folder
from swarmd.core.keys import is_id
from swarmd.core.names import expand_globs
from swarmd.core.numbers import python_value
from swarmd.operator.session.exit_codes import NO_TARGET, USAGE

if TYPE_CHECKING:
    from swarmd.link.settings import NetworkSettings
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.texts.assignments import Value


STOP_LOOK = 1.0
"""How long a stop by label looks for labels at most, in s.

The stop is sent to robots that have not answered by then, too.
"""


class Targets(Struct, frozen=True):
    """The robots that a request is for: by names and globs, and by labels.

    A robot with any of the `labels` is a target, too. Without names and labels all robots are
    targets. Robots in `exclude` are no targets. Labels are known only from statuses of robots:
    `named` replaces labels by names.
    """

    names: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()

    @property
    def is_whole_swarm(self) -> bool:
        """True if no robot is named, labelled or excluded."""
        return not self.names and not self.exclude and not self.labels

    @property
    def full_names(self) -> tuple[str, ...]:
        """The targets without wildcards; each is a target even if no robot has that name."""
        return tuple(name for name in self.names if is_id(name) and not self._is_excluded(name))

    def select(self, known: Collection[str], roster: Collection[str] = ()) -> tuple[str, ...]:
        """The targets among the robot names in `known`; `roster`: of the swarm, see `check_known`.

        RequestError if a name or glob, also of `exclude`, matches no robot. RequestError if there
        are labels, since names do not show labels.
        """
        if self.labels:
            raise RequestError("this verb takes names, not labels; see `swarmctl members`", USAGE)
        for glob in (*self.names, *self.exclude):
            if not any(fnmatchcase(name, glob) for name in known):
                check_known(glob, known, roster)
        return self.matching(known)

    def matching(self, known: Iterable[str]) -> tuple[str, ...]:
        """The targets among `known`; names and globs that match no robot are ignored."""
        return tuple(
            name
            for name in sorted(known)
            if (self._is_open or any(fnmatchcase(name, glob) for glob in self.names))
            and not self._is_excluded(name)
        )

    @property
    def _is_open(self) -> bool:
        return not self.names and not self.labels

    def _is_excluded(self, name: str) -> bool:
        return any(fnmatchcase(name, glob) for glob in self.exclude)


def make_targets(
    names: Iterable[str] = (), exclude: Iterable[str] = (), labels: Iterable[str] = ()
) -> Targets:
    """The targets of words; ConfigError for a wrong word.

    Ranges such as `tb3-[01-07]` are expanded: requests contain only names and globs.
    """
    wanted = _expanded(names)
    excluded = _expanded(exclude)
    labels = tuple(labels)
    for label in labels:
        if not is_id(label):
            raise ConfigError(f"{label!r} is no label; expected a-z, 0-9, _ and -")
    return Targets(wanted, excluded, labels)


def _expanded(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for word in words for name in expand_globs(word)))


def check_known(name: str, known: Collection[str], roster: Collection[str] = ()) -> None:
    """RequestError unless the robot is known, with the nearest name.

    With a `roster` the name may be that of a revoked robot, which another name would hide.
    """
    if name in known:
        return
    text = f"{unknown('robot', name, known)}; see `swarmctl members`"
    if name in roster:
        text = f"{name} is on the roster, but is not heard; see `swarmctl members`"
    elif roster and is_id(name):
        text = (
            f"{name} is not on the roster: it was revoked, or never added (`swarmctl keys list`);"
            " what a revoked robot has recorded and logged is on its own disk alone"
        )
    raise RequestError(text, NO_TARGET)


def labels_of(view: MembersView) -> dict[str, tuple[str, ...]]:
    """The labels of each robot whose status is known."""
    members = view.members.items()
    return {name: one.status.labels for name, one in members if one.status is not None}


def unlabelled(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The expected robots whose labels are not known, so that they may be targets of a label."""
    if not targets.labels:
        return ()
    lacking = view.expected - labels_of(view).keys()
    by_name = Targets(targets.names).matching(lacking) if targets.names else ()
    return Targets(("*",), (*targets.exclude, *by_name)).matching(lacking)


def named(view: MembersView, targets: Targets) -> Targets:
    """The targets with labels replaced by names.

    RequestError, with the nearest label, if no robot has a label.
    """
    if not targets.labels:
        return targets
    labels_by_robot = labels_of(view)
    _check(targets.labels, labels_by_robot.values())
    robots = (
        name for name, labels in sorted(labels_by_robot.items()) if {*labels} & {*targets.labels}
    )
    return replace(targets, names=(*targets.names, *robots), labels=())


def stop_targets(view: MembersView, targets: Targets) -> Targets:
    """The targets of a stop, with labels replaced by the names of the robots that have them.

    The targets are robots that `targets` names, robots with one of the labels, and robots whose
    labels are not known: in doubt a robot is stopped. Excluded robots are no targets. RequestError
    if the labels of all expected robots are known, and no robot has one of the labels in `targets`.
    """
    labels_by_robot = labels_of(view)
    if view.expected and view.expected <= labels_by_robot.keys():
        _check(targets.labels, labels_by_robot.values())
    named = set(Targets(targets.names).matching(labels_by_robot)) if targets.names else set[str]()
    unlabelled = {
        name for name, labels in labels_by_robot.items() if not {*labels} & {*targets.labels}
    }
    return Targets(("*",), (*targets.exclude, *sorted(unlabelled - named)))


def robots_of(
    view: MembersView, targets: Targets, known: Collection[str] | None = None
) -> tuple[str, ...]:
    """The targets among `known`, by default all members and the roster; RequestError as `named`."""
    known = view.members.keys() | view.roster if known is None else known
    return named(view, targets).select(known, view.roster)


def targets_of(view: MembersView, targets: Targets) -> tuple[str, ...]:
    """The robots that must answer a request to `targets`; RequestError if there are none."""
    expected = view.expected
    names = robots_of(view, targets)
    chosen = tuple(name for name in names if name in expected)
    if not chosen:
        raise no_target(*(f"{name} has left" for name in names))
    return chosen


def no_target(*reasons: str) -> RequestError:
    """The error of a request without a target; `reasons`: why each named robot is no target."""
    text = "; ".join(reasons) or "all robots are excluded"
    return RequestError(f"no robot is targeted: {text}", NO_TARGET)


def _check(labels: Collection[str], of_robots: Collection[Collection[str]]) -> None:
    known = {label for some in of_robots for label in some}
    for label in labels:
        if label not in known:
            raise RequestError(unknown("robot with label", label, known), NO_TARGET)


MAX_TIME = 1e7  # s

Words: TypeAlias = str | Iterable[str]
T = TypeVar("T", float, float | None)
"""One word, or several."""


def check_time(name: str, value: T) -> T:
    """The time as a float of Python, or None as it is.

    ConfigError unless a given time is a finite number of seconds above 0.
    """
    plain = python_value(value)
    is_number = isinstance(plain, Real) and not isinstance(plain, bool)
    if plain is not None and not (is_number and 0.0 < plain <= MAX_TIME):
        raise ConfigError(
            f"{name} is {value!r}; expected a number of seconds above 0, at most {MAX_TIME:.0e}"
        )
    return plain if plain is None else float(plain)  # type: ignore[return-value]  # mypy: a union


def check_words(words: Words, what: str) -> tuple[str, ...]:
    """The words as a tuple; ConfigError unless they are a text or several texts."""
    plain = python_value(words)
    some = tuple(plain) if isinstance(plain, Iterable) and not isinstance(plain, str) else (plain,)
    if not all(isinstance(word, str) for word in some):
        raise ConfigError(f"{what} is {words!r}; expected a text, or a list of texts")
    return tuple(map(str, some))  # numpy's texts cannot be sent


def plain_params(values: Mapping[str, Any]) -> dict[str, Value]:
    """Values that can be sent: numpy's values as Python's. ConfigError for any other type."""
    if not isinstance(values, Mapping) or not all(isinstance(key, str) for key in values):
        raise ConfigError(f"parameters are {values!r}; expected a dict, such as {{'speed': 0.15}}")
    plain: dict[str, Value] = {}
    for key, value in python_value(values).items():
        if isinstance(value, bool | str) or value is None:
            plain[key] = value
        elif isinstance(value, Integral) and -(2**63) <= int(value) < 2**63:
            plain[key] = int(value)
        elif isinstance(value, Real) and not isinstance(value, Integral) and math.isfinite(value):
            plain[key] = float(value)
        else:
            wanted = "a finite number of at most 64 bits, a text, True, False or None"
            raise ConfigError(f"parameter {key} is {value!r}; expected {wanted}")
    return plain


MAX_NAMES = 1024  # the most names of robots, and the most labels
MAX_SWARMS = 32
"""Swarms whose names are kept: those of the latest looks."""
MAX_AGE = 60.0
"""s after which the names are looked up anew."""
EMPTY_AGE = 5.0
"""s after which the names are looked up anew if no robot was found."""
LOOK_TIME = 0.25
"""How long such a look takes at most, in s: the shell waits for it."""


def remember(settings: NetworkSettings, view: MembersView) -> None:
    """Write the names and labels of a look to the user's cache; a failure is ignored."""
    names = view.members.keys() | view.roster
    if names:
        _write(settings, names, _labels(view))


def _labels(view: MembersView) -> list[str] | None:
    """The labels of all robots; None if the look has no status."""
    statuses = [status.status for status in view.members.values() if status.status is not None]
    return [label for status in statuses for label in status.labels] if statuses else None


def _write(
    settings: NetworkSettings, names: Iterable[str], labels: Iterable[str] | None = None
) -> None:
    """Write names and labels; None for `labels` keeps the labels in the file."""
    with contextlib.suppress(OSError, RuntimeError):
        path = _path(settings)
        path.parent.mkdir(parents=True, exist_ok=True)
        kept = known_labels(settings) if labels is None else labels
        content = {
            "names": sorted(filter(is_id, names))[:MAX_NAMES],
            "labels": sorted({*filter(is_id, kept)})[:MAX_NAMES],
        }
        draft = path.with_name(f".{path.name}.{os.getpid()}")  # tempfile takes 10 ms to import
        try:
            draft.write_bytes(msgspec.json.encode(content))
            draft.replace(path)
        except OSError:
            draft.unlink(missing_ok=True)
        files = sorted(path.parent.glob("members-*.json"), key=lambda one: one.stat().st_mtime)
        for old in files[:-MAX_SWARMS]:
            old.unlink(missing_ok=True)


def remembered(settings: NetworkSettings) -> tuple[list[str], float]:
    """The cached names, and their age in s; an infinite age without a cache."""
    try:
        age = max(time.time() - _path(settings).stat().st_mtime, 0.0)
    except (OSError, RuntimeError):
        return [], float("inf")
    return _read(settings, "names"), age


def known_labels(settings: NetworkSettings) -> list[str]:
    """The cached labels."""
    return _read(settings, "labels")


def _read(settings: NetworkSettings, key: str) -> list[str]:
    try:
        found = msgspec.json.decode(_path(settings).read_bytes()[: 256 * MAX_NAMES])[key]
        return [name for name in found if isinstance(name, str) and is_id(name)]
    except (OSError, RuntimeError, ValueError, TypeError, LookupError):  # ValueError: also no UTF-8
        return []


def known_names(operator: Operator) -> list[str]:
    """The cached names; if they are old, a short look renews them."""
    settings = operator.settings
    names, age = remembered(settings)
    if age <= (MAX_AGE if names else EMPTY_AGE) or settings.profile == "routed":
        return names
    view = operator.members(timeout=LOOK_TIME, needs_status=False)
    names = sorted(view.members.keys() | view.roster) or names
    _write(settings, names, _labels(view))
    return names


def _path(settings: NetworkSettings) -> Path:
    return cache_folder() / f"members-{settings.profile}-{settings.swarm}.json"


# Bounds of the texts in a request, in characters, and in a datagram, in bytes.
MAX_OPERATOR = 128
MAX_OPERATOR_BYTES = 256
MAX_REASON = 256
MAX_REASON_BYTES = 512


def operator_name() -> str:
    """The name of this operator, such as `anna@laptop`."""
    try:
        user = getpass.getuser()
    except (OSError, KeyError):
        user = f"uid{os.getuid()}"
    return sendable_name(f"{user}@{socket.gethostname()}")


def sendable_name(name: str) -> str:
    """An operator's name as any request carries it."""
    return _sendable(name, MAX_OPERATOR, MAX_OPERATOR_BYTES)


def request_reason(reason: str) -> str:
    """A reason as a request by Zenoh carries it."""
    return _sendable(reason, MAX_REASON, 4 * MAX_REASON)


def stop_reason(reason: str) -> str:
    """A reason as the datagram of a stop carries it."""
    return _sendable(reason, MAX_REASON, MAX_REASON_BYTES)


def _sendable(text: str, length: int, room: int) -> str:
    """The first `length` characters and `room` bytes; what UTF-8 cannot carry becomes `?`."""
    whole = text.encode("utf-8", "replace").decode()[:length]
    return whole.encode()[:room].decode(errors="ignore")
