"""The texts of a run. What is wrong in an option is said where the option is checked."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING

from swarmd.operator.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.core.messages import Status


# A start at one moment


def without_clock(robots: Iterable[str]) -> str:
    """The robots that are not asked to start at one moment."""
    return f"not asked, since their clocks did not answer: {', '.join(robots)}"


def start(at: float, apart: float, by_clocks: float) -> str:
    """A start in `at` s, and how far apart robots start, all in s."""
    return (
        f"start in {seconds(at)}: robots start at most {1e3 * apart:.0f} ms apart,"
        f" {1e3 * by_clocks:.1f} ms of it by their clocks"
    )


# Canaries


def canaries_begin(robots: Iterable[str], time: float) -> str:
    """The canaries, and the s for which they must run well."""
    return f"canary: {', '.join(robots)} for {seconds(time)}"


def canaries_not_started(robots: Iterable[str]) -> str:
    """Canaries of which one has not started."""
    return f"canary: {', '.join(robots)} did not start; nothing was sent to the others"


def canaries_failed(faults: Mapping[str, str], missing: Collection[str], other_count: int) -> str:
    """What is said after failed canaries were stopped.

    `faults`: by canary. `missing`: canaries that have not acknowledged the stop. `other_count`: how
    many targets are no canaries.
    """
    reasons = "; ".join(f"{name}: {fault}" for name, fault in faults.items())
    stop_text = "it was stopped"
    if missing:
        stop_text = f"{', '.join(missing)} DID NOT ACKNOWLEDGE THE STOP"
    rest = f"the other {other_count} robots" if other_count > 1 else "the other robot"
    return f"canary failed: {reasons}; {stop_text}; nothing was sent to {rest}"


def started_before(error: Exception, canaries: Iterable[str]) -> str:
    """An error after which the canaries may run."""
    return f"{error}; {', '.join(canaries)} started before, and may run"


# A lease


def runs_while_here(lease: float) -> str:
    """How long robots run under a lease of that many s."""
    return f"the robots run while this command runs, and {seconds(lease)} longer; Ctrl-C stops them"


def ended(status: Status) -> str:
    """The end of a run, by the robot's status."""
    detail = f" {status.detail}" if status.detail else ""
    return f"{status.robot}: {status.state} ({status.reason}){detail}"


def renewed_nothing(lapse: float, lease: float) -> str:
    """A lease that was not renewed for `lapse` s; both in s."""
    return (
        f"this command renewed no lease for {seconds(lapse)}: it was stopped, or this computer"
        f" slept. Runs end {seconds(lease)} after the last renewal; start them anew"
    )


def not_heard(robot: str, patience: float, *, is_after_lapse: bool) -> str:
    """A robot that was not heard for `patience` s."""
    after = " since then" if is_after_lapse else ""
    return f"{robot} was not heard for {seconds(patience)}{after}: it is not waited for"
