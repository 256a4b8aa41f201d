"""An operator who makes one robot run and looks at it, for tests with whole daemons."""

from __future__ import annotations

from swarmd.core.errors import RequestError
from swarmd.core.messages import Code, State, Status
from swarmd.core.verbs import RunRequest
from swarmd.operator.session.operator import Operator
from tests.support.processes import wait_until
from tests.support.swarmctl import STALLED

ROBOT = "tb3-01"


def status(operator: Operator) -> Status | None:
    """What the robot says of itself; None if it does not answer."""
    member = operator.members().members.get(ROBOT)
    return None if member is None else member.status


def is_running(operator: Operator) -> bool:
    """True while it runs on scans that keep coming."""
    now = status(operator)
    return now is not None and now.state is State.RUNNING and now.health.scan_rate > 1.0


def drive(operator: Operator) -> None:
    """Run `drive` once it senses and answers."""

    def is_applied() -> bool:
        now = status(operator)
        if now is None or not now.health.driver_up or now.decision.scan_age is None:
            return False
        try:
            outcome = operator.request(
                RunRequest,
                {ROBOT: now.epoch},
                pattern="drive",
                params={"speed": 0.1},
                timeout=10.0,
            )
        except RequestError as error:
            if STALLED.search(str(error)):
                return False
            raise
        reply = outcome.replies.get(ROBOT)
        return reply is not None and reply.code is Code.APPLIED

    wait_until(is_applied, "it runs")
