"""What a name with a permit may ask of one robot. Pure: `judge` is the only place that decides.

A robot judges each request of such a name, whatever way the request came. The rules:

1. A permit counts until its end, by the wall clock of the robot. On a robot whose wall clock is not
   set no permit counts.
2. A request is permitted only if a line of `may` permits it:

   ======================  ========================================================================
   `stop`, `estop`         of every robot: neither `robots` nor `for` nor `speed` narrows a stop
   `stop NAMES`            of these robots alone, also if the stop is for all robots
   `run PATTERN`           a run of these patterns (a glob; none: any pattern)
   `param PATTERN.NAME`    these parameters of a running pattern (globs; none: any), and of a run
   `drive`                 to drive by hand, and to release
   ======================  ========================================================================

   Every other verb is refused, and a line with an unknown verb permits nothing.
3. `robots` bounds all but stops.
4. A run has no goal: a goal spreads to other robots, and may start runs later. It ends after `for`
   at the latest, and with the permit. A run that is asked for longer than `for` is refused.
5. A run may set only the parameters that `param` permits for its pattern.
6. A hand ends after `for` and with the permit, and drives at `speed` at most.
7. Nothing lets a run of this name drive faster than `speed`. So a name with `speed` may set no
   parameters of a run that has a greater bound, or none.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from fnmatch import fnmatchcase
from functools import lru_cache
from types import MappingProxyType
from typing import NamedTuple

from msgspec.structs import replace

from swarmd.core.clock import FIRST_WALL
from swarmd.core.errors import ConfigError, unknown
from swarmd.core.names import expand_globs, select_names
from swarmd.core.verbs import (
    MAX_AHEAD,
    AnyRequest,
    DriveRequest,
    EstopRequest,
    ParamRequest,
    RunRequest,
    StopRequest,
)
from swarmd.link.keys.roster import KeyPermit

MAX_RUN = 1e7
"""The longest run in s that a request may ask for (`RunRequest.seconds`)."""
STOPS = ("stop", "estop")
VERBS = (*STOPS, "run", "param", "drive")
"""The verbs that a permit may list."""


class Denial(NamedTuple):
    """Why a request is refused, and what the key may."""

    text: str


class PresentRun(NamedTuple):
    """The pattern that runs on a robot. `speed`: the bound of the run in m/s; None: no bound."""

    pattern: str
    speed: float | None = None


class Line(NamedTuple):
    """A line of `may`: a verb, and what it is of; empty: of anything."""

    verb: str
    of: str


class _Case(NamedTuple):
    """A request that is judged."""

    permit: KeyPermit
    robot: str
    wall: float
    running: PresentRun | None


def judge(
    permit: KeyPermit,
    request: AnyRequest,
    robot: str,
    *,
    wall: float,
    running: PresentRun | None = None,
) -> AnyRequest | Denial:
    """The request as `robot` may carry it out, or why the robot refuses it.

    `request`: of the name that has `permit`. `wall`: s since 1970 by the robot's clock. `running`:
    the present run of the robot. The returned request is bounded: a run by `for`, `speed` and the
    end of the permit; a stop of named robots by its targets.
    """
    name = request.operator
    if text := fault_of_time(permit, robot, wall):
        return Denial(f"{name}: {text}")
    rule = _RULES.get(request.verb)
    if rule is None:
        return denied(permit, name, request.verb)
    judged = rule(_Case(permit, robot, wall, running), request)
    if isinstance(judged, Denial):
        return denied(permit, name, judged.text)
    return judged


def is_bound_stop(permit: KeyPermit, verb: str) -> bool:
    """True if the permit names the robots that its name may stop, or no robot."""
    return not any(line.verb == verb and not line.of for line in lines_of(permit))


def stoppable(permit: KeyPermit, verb: str, robots: Collection[str]) -> tuple[str, ...]:
    """Those of `robots` that the name may stop. `verb`: stop or estop."""
    if not is_bound_stop(permit, verb):
        return tuple(robots)
    lines = [line for line in lines_of(permit) if line.verb == verb]
    return tuple(robot for robot in robots if any(_names(line.of, robot) for line in lines))


def denied(permit: KeyPermit, name: str, what: str) -> Denial:
    """Why a request (`what`) of `name` is refused, and what the key of the name may."""
    return Denial(f"{name} may not {what}; its key may {permit_text(permit)}")


def fault_of_time(permit: KeyPermit, robot: str, wall: float) -> str:
    """Why a permit does not count now; empty if it counts. `wall`: s since 1970."""
    if wall < FIRST_WALL:
        return f"the clock of {robot} is not set, so that no permit counts there"
    if wall >= permit.until:
        return f"its permit ended {moment(permit.until)}"
    return ""


def permit_text(permit: KeyPermit) -> str:
    """What a permit permits, such as `stop, run attraction; on tb3-0[1-3]; at most 60 s`."""
    bounds = (
        ", ".join(permit.may) or "only look",
        f"on {permit.robots}" if permit.robots else "",
        "" if permit.longest is None else f"at most {permit.longest:g} s a run",
        "" if permit.speed is None else f"at most {permit.speed:g} m/s",
        f"until {moment(permit.until)}",
    )
    return "; ".join(filter(None, bounds))


def moment(wall: float) -> str:
    """A time in s since 1970, such as `2026-11-30 14:20 UTC`."""
    return time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime(wall))


def check_permit(permit: KeyPermit, robots: tuple[str, ...]) -> None:
    """Raise ConfigError for a permit that cannot mean what it says. `robots`: of the roster."""
    if permit.robots:
        select_names((permit.robots,), robots)
    for text in permit.may:
        _check_line(text, robots)
    verbs = {line.verb for line in lines_of(permit)}
    for verb in ("run", "drive"):
        if verb in verbs and not verbs & {*STOPS}:
            raise ConfigError(f"whoever may {verb} must be able to stop: add `stop`")


def _check_line(text: str, robots: tuple[str, ...]) -> None:
    verb, of = _split(text)
    if verb not in VERBS:
        raise ConfigError(
            f"{unknown('request of a permit', verb, VERBS)}; expected stop, estop, `run PATTERN`,"
            " `param PATTERN.NAME` or drive"
        )
    if verb in STOPS:
        if of:
            select_names((of,), robots)
        return
    if verb == "drive" and of:
        raise ConfigError(f"{text!r}: expected `drive` alone; `robots` says which robots")
    if any(char in of for char in " [],"):
        raise ConfigError(f"{text!r}: expected one name, with * and ? for any characters")
    if verb == "param" and of and "." not in of:
        raise ConfigError(f"{text!r}: expected PATTERN.NAME, such as `param {of}.*`")


def lines_of(permit: KeyPermit) -> tuple[Line, ...]:
    """The lines of `may`."""
    return tuple(_split(text) for text in permit.may)


def _split(text: str) -> Line:
    verb, _, of = text.strip().partition(" ")
    return Line(verb, of.strip())


@lru_cache(maxsize=256)
def _globs(text: str) -> tuple[str, ...]:
    """The globs of a text such as `tb3-0[1-3],fox-*`; none if it cannot be read."""
    try:
        return expand_globs(text)
    except ConfigError:
        return ()


def _names(text: str, robot: str) -> bool:
    """True if a text such as `tb3-0[1-3]` names the robot."""
    return any(fnmatchcase(robot, glob) for glob in _globs(text))


def _matches(glob: str, name: str) -> bool:
    """True if a name matches a glob; a glob in which a bracket stands matches nothing."""
    return "[" not in glob and fnmatchcase(name, glob)


# The rules of the verbs


def _judge_stop(case: _Case, request: AnyRequest) -> AnyRequest | Denial:
    """A stop of this robot, if the permit names this robot or none.

    A stop of all robots sets a goal, and an emergency stop of the swarm spreads: they would reach
    robots that the permit does not name. So such a stop becomes one of this robot.
    """
    assert isinstance(request, StopRequest | EstopRequest)
    verb = request.verb
    if not is_bound_stop(case.permit, verb):
        return request
    if not stoppable(case.permit, verb, (case.robot,)):
        return Denial(f"{verb} {case.robot}")
    if request.targets is None:
        request = replace(request, targets={case.robot: None})
    return replace(request, scope="robots") if isinstance(request, EstopRequest) else request


def _judge_run(case: _Case, request: AnyRequest) -> AnyRequest | Denial:
    """A run without a goal, bounded by `for`, by the end of the permit and by `speed`."""
    assert isinstance(request, RunRequest)
    permit = case.permit
    pattern = request.pattern
    if not _is_for(permit, case.robot):
        return Denial(f"run {pattern} on {case.robot}")
    if not any(_is_line_of_run(line, pattern) for line in lines_of(permit)):
        return Denial(f"run {pattern}")
    if request.goal is not None:
        return Denial("set a goal")
    for name in request.params:
        if not _may_set(permit, pattern, name):
            return Denial(f"set {pattern}.{name}")
    if permit.longest is not None and (request.seconds or 0.0) > permit.longest:
        return Denial(f"run for {request.seconds:g} s")
    left = permit.until - case.wall - (MAX_AHEAD if request.at else 0.0)
    if left <= 0.0:
        return Denial("run at a time so near the end of its permit")
    return replace(
        request,
        seconds=_least(request.seconds, permit.longest, left if left <= MAX_RUN else None),
        speed=_least(request.speed, permit.speed),
    )


def _judge_param(case: _Case, request: AnyRequest) -> AnyRequest | Denial:
    """Parameters of the pattern that runs, unless the run may be faster than the permit."""
    assert isinstance(request, ParamRequest)
    permit = case.permit
    running = case.running
    if not _is_for(permit, case.robot):
        return Denial(f"set parameters on {case.robot}")
    if running is None:
        return request  # the robot refuses it: no pattern runs
    for name in request.params:
        if not _may_set(permit, running.pattern, name):
            return Denial(f"set {running.pattern}.{name}")
    bound = math.inf if running.speed is None else running.speed
    if permit.speed is not None and bound > permit.speed:
        return Denial("set parameters of a run without its bound of speed")
    return request


def _judge_drive(case: _Case, request: AnyRequest) -> AnyRequest | Denial:
    """A hand, bounded by `for`, by the end of the permit and by `speed`; a release is permitted."""
    assert isinstance(request, DriveRequest)
    permit = case.permit
    if not _is_for(permit, case.robot):
        return Denial(f"drive {case.robot}")
    if not any(line == Line("drive", "") for line in lines_of(permit)):
        return Denial("drive")
    left = permit.until - case.wall
    return replace(
        request,
        seconds=_least(request.seconds, permit.longest, left if left <= MAX_RUN else None),
        speed=_least(request.speed, permit.speed),
    )


_RULES: Mapping[str, Callable[[_Case, AnyRequest], AnyRequest | Denial]] = MappingProxyType(
    {
        "stop": _judge_stop,
        "estop": _judge_stop,
        "run": _judge_run,
        "param": _judge_param,
        "drive": _judge_drive,
    }
)
"""By verb; another verb is refused."""


def _is_for(permit: KeyPermit, robot: str) -> bool:
    return not permit.robots or _names(permit.robots, robot)


def _is_line_of_run(line: Line, pattern: str) -> bool:
    return line.verb == "run" and (not line.of or _matches(line.of, pattern))


def _may_set(permit: KeyPermit, pattern: str, name: str) -> bool:
    """True if a line of `may` permits to set the parameter `name` of a pattern."""
    for line in lines_of(permit):
        if line.verb != "param":
            continue
        of_pattern, _, of_name = line.of.partition(".")
        if not line.of or (_matches(of_pattern, pattern) and _matches(of_name, name)):
            return True
    return False


def _least(*values: float | None) -> float | None:
    """The least of the values that are not None; None without one."""
    given = [value for value in values if value is not None]
    return min(given, default=None)
