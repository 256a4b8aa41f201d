"""How long a run with a lease is waited for; whole runs: tests/swarm/test_operating.py."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import pytest
from msgspec.structs import replace

from swarmd.core.codec import encode
from swarmd.core.messages import Epoch, Reason, State, Status
from swarmd.operator.cli.output import warn
from swarmd.operator.session.exit_codes import APPLIED, FAILED, PARTIAL, TIMEOUT
from swarmd.operator.session.operator import Operator
from swarmd.operator.session.session import Session
from swarmd.operator.verbs.run import lease as run_lease
from swarmd.operator.verbs.run.lease import Lapse, LeasedRuns, LeaseKeeper, follow_runs
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
    follow_runs(session, make_goal(7), 0.1, {"r1": OLD}, lambda now: None)
    assert capsys.readouterr().err.startswith(told)


GOAL = make_goal(7, lease=5.0)
ENDED = status("r1", state=State.STOPPED, reason=Reason.LEASE_ENDED, epoch=NEW)
FINISHED = status("r1", state=State.IDLE, reason=Reason.FINISHED, epoch=NEW)
OTHER = replace(FINISHED, robot="r2")
ASLEEP = Lapse(begun=101.0, seconds=599.0)


def leased(*names: str) -> LeasedRuns:
    return LeasedRuns(GOAL, 10.0, dict.fromkeys(names, OLD), 100.0)


def test_a_command_that_slept_says_so_and_blames_no_robot() -> None:
    """A laptop that was suspended at 101 s and wakes at 700 s."""
    runs = leased("r1", "r2")
    assert list(runs.advance(100.5, None)) == []
    [told] = runs.advance(700.0, ASLEEP)
    assert "this command" in told
    assert "10 min" in told
    assert set(runs.running) == {"r1", "r2"}  # nobody listened meanwhile
    assert list(runs.advance(700.5, Lapse(101.0, 599.1))) == []  # the same one
    [ended] = runs.on_status(ENDED, 701.0)
    assert ended.startswith("r1: stopped (lease_ended)")
    assert list(runs.advance(709.9, ASLEEP)) == []
    [silent] = runs.advance(710.1, ASLEEP)
    assert silent.startswith("r2 ")
    assert "since then" in silent  # since the command went on, not since it slept
    assert runs.exit_code(APPLIED) == FAILED
    assert [*runs.advance(720.0, Lapse(711.0, 6.0))] != []  # another one


@pytest.mark.parametrize(
    ("statuses", "code"),
    [
        ((FINISHED, OTHER), APPLIED),
        ((ENDED, OTHER), PARTIAL),
        ((ENDED,), FAILED),
        ((FINISHED,), PARTIAL),  # r2 was not heard
        ((), TIMEOUT),
    ],
    ids=["finished", "one lapsed", "lapsed and not heard", "one not heard", "none heard"],
)
def test_a_run_that_did_not_end_as_wanted_is_no_success(
    statuses: tuple[Status, ...], code: int
) -> None:
    runs = leased("r1", "r2")
    for one in statuses:
        [_] = runs.on_status(one, 101.0)
    _ = [*runs.advance(200.0, None)]
    assert not runs.running
    assert runs.exit_code(APPLIED) == code
    assert runs.exit_code(PARTIAL) == (code or PARTIAL)  # what the start has told stays


def test_a_keeper_knows_for_how_long_it_has_renewed_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times = [100.0, 101.25, 102.5, 142.5, 143.75]
    clock = iter(times)
    monkeypatch.setattr(run_lease, "boottime", lambda: next(clock))
    operator = cast("Operator", SimpleNamespace(send_lease=lambda *_: None))
    owned = iter([True] * len(times) + [False])
    keeper = LeaseKeeper(operator, "g", 5.0, ["r1"], is_owned=lambda: next(owned))
    monkeypatch.setattr(keeper._ending, "wait", lambda _: None)
    assert keeper.lapse(1000.0) is None  # nothing was renewed yet
    keeper.run()
    assert keeper.lapse(144.0) == Lapse(102.5, 40.0)
    assert keeper.lapse(150.0) == Lapse(143.75, 6.25)  # as it wakes, before it renews
