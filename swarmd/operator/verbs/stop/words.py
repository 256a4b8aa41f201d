"""The texts of stop, estop and reset."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import TYPE_CHECKING

from swarmd.operator.session.session import other_swarms, where
from swarmd.operator.texts.values import seconds

if TYPE_CHECKING:
    from swarmd.core.messages import Latch
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.outcome import Outcome


def waiting_for(gaps: Iterable[str]) -> str:
    """The robots that have not stopped; `gaps`: what is known of each, empty if none was heard."""
    return f"waiting for {'; '.join(gaps) or 'a robot to be heard'}"


def not_acknowledged(verb: str, missing: Collection[str]) -> str:
    """How many robots have not stopped, for the page, which shows their names itself."""
    return f"{verb}: {len(missing)} not acknowledged"


def without_labels(robots: Iterable[str]) -> str:
    """The robots that a stop by label reaches since their labels are not known."""
    return f"labels are not known, a stop is sent to them, too: {', '.join(robots)}"


def sent_in_vain(operator: Operator, verb: str, time: float) -> str:
    """A stop that was sent for `time` s and reached no robot; goes on after another text."""
    return f"; `{verb}` was sent {where(operator)} for {seconds(time)} and no robot answered"


def none_heard(operator: Operator) -> str:
    """No robot of this swarm was heard, and the other swarms that were."""
    return f"no robot was heard{other_swarms(operator)}"


def left(robot: str) -> str:
    """Why a robot is no target of a stop."""
    return f"{robot} has left"


def interrupted(reason: str, stopped: Outcome) -> str:
    """A verb that has ended for `reason`, and whose robots were stopped."""
    return f"{reason}: stop sent: {stopped.line}"


def clears(latch_id: str, latch: Latch) -> str:
    """An emergency stop that a reset clears."""
    from swarmd.operator.texts.why import stop_text  # a stop needs none of the words of a reset

    return f"clears emergency stop {latch_id} {stop_text(latch)}"


def of_finding(robot: str, finding: str, *, is_ended: bool) -> str:
    """A finding of a robot, a doubt such as brakes that are weaker than declared."""
    return f"{robot}: {'ends' if is_ended else 'keeps (--findings ends it)'}: {finding}"
