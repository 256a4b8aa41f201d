"""How long a run with a lease is waited for; whole runs: tests/swarm/test_operating.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import cast

import pytest

from swarmd.cli.output import warn
from swarmd.client.run_lease import follow_runs
from swarmd.client.session import Session
from swarmd.core.codec import encode
from swarmd.core.messages import Epoch, State, Status
from swarmd.network.operator.operator import Operator
from tests.support.goals import make_goal
from tests.support.statuses import status

OLD, NEW = Epoch("0123456789ab", 7), Epoch("ba9876543210", 0)


class StatusesOnly:
    """The part of an operator that hands over statuses; these come at once."""

    def __init__(self, *statuses: Status) -> None:
        self._statuses = statuses

    def watch(self, name: str, handler: Callable[[str, bytes], object]) -> None:
        for one in self._statuses:
            handler(one.robot, encode(one))

    def unwatch(self, name: str) -> None:
        pass


@pytest.mark.parametrize(
    ("epoch", "told"),
    [
        (NEW, "r1: idle"),  # the daemon was started again
        (Epoch(OLD.instance, 6), "r1 was not heard for"),  # a status from before the run
        (None, "r1 was not heard for"),  # the daemon was killed
    ],
)
def test_a_run_whose_daemon_ended_is_not_waited_for(
    epoch: Epoch | None, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    told_of = () if epoch is None else (status("r1", state=State.IDLE, epoch=epoch),)
    session = Session(cast("Operator", StatusesOnly(*told_of)), tell=warn)
    follow_runs(session, make_goal(7), 0.1, {"r1": OLD})
    assert capsys.readouterr().err.startswith(told)
