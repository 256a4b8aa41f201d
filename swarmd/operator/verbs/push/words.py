"""The texts of a push: its canaries, the way back, and the rows of pushed patterns."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

from swarmd.core.messages import Code
from swarmd.operator.texts.values import NOTHING

if TYPE_CHECKING:
    from swarmd.core.verbs import PushedPatternReport
    from swarmd.operator.session.outcome import Outcome

HEADER = ("NAME", "PATTERN", "VERSION", "HASH", "STANDING", "FROM", "TEXT", "")
"""The titles of the rows of `plugin list`."""


def row(report: PushedPatternReport) -> tuple[str, ...]:
    """The cells of a pushed pattern, without its robot."""
    standing = report.standing
    if standing == "provisional" and report.ran:
        standing += f" ({report.ran:.0f} s)"
    origin = f"{report.issuer}, {report.source}" if report.source else report.issuer
    cells = (report.name, report.version, report.digest, standing, origin, report.text)
    return tuple(cell or NOTHING for cell in cells)


def way_back(name: str, robots: Collection[str]) -> str:
    """Which robots have the new code of the pattern `name`, and the verbs that take it back."""
    return (
        f"new code of {name} on {', '.join(robots)}; back: push the file before, or"
        f" `swarmctl plugin remove {name} {' '.join(robots)}`"
    )


def canary_fault(report: PushedPatternReport | None, *, has_answered: bool) -> str:
    """Why a canary does not have the new code; `report`: of the pattern, on this canary."""
    if report is not None and report.text:  # why the new code failed
        return f"returned: {report.text}"
    return "has another version" if has_answered else "does not answer"


def faults_of(outcome: Outcome) -> Iterator[str]:
    """A line for each robot that refused a push, failed or did not answer."""
    for name, reply in outcome.replies.items():
        if reply.code is not Code.APPLIED:
            yield f"{name}: {reply.code}: {reply.text}"
    for name in outcome.missing:
        yield f"{name}: no answer"
