"""Goals on disk, and the signatures of those that come."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from msgspec.structs import replace

from swarmd.core.clock import boottime
from swarmd.core.goal import Goal, GoalRecord
from swarmd.core.verbs import GoalRequest
from swarmd.daemon import store
from swarmd.daemon.goal_service import GoalService
from swarmd.daemon.store import StateFile
from swarmd.operator.session.session import sign_goal
from tests.support.keys import SwarmKeys

GOAL = Goal(generation=3, issuer="bob", id="g3", pattern="drive")


def goal_file(folder: Path) -> StateFile[GoalRecord]:
    return StateFile(folder / "goal", GoalRecord, "goals are lost")


RECORD = GoalRecord(held=GOAL, own=GOAL, ended="stopped", labels=("red",))


def test_a_record_is_written_whole_and_read_again(tmp_path: Path) -> None:
    file = goal_file(tmp_path / "deep")
    assert file.read() == GoalRecord()
    file.write(RECORD)
    assert goal_file(tmp_path / "deep").read() == RECORD
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["goal"]


def test_a_file_that_cannot_be_read_is_no_goal(tmp_path: Path) -> None:
    goal_file(tmp_path).path.write_bytes(b"\x01\xff\xff")
    assert goal_file(tmp_path).read() == GoalRecord()


def test_a_folder_that_cannot_be_written_is_told_once_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store, "RETRY_PERIOD", 0.01)
    blocker, told = tmp_path / "state", list[str]()
    blocker.write_text("in the way")

    async def run() -> None:
        is_failed, is_mended = asyncio.Event(), asyncio.Event()

        def tell(text: str) -> None:
            told.append(text)
            (is_mended if is_failed.is_set() else is_failed).set()

        service = GoalService(blocker, lambda: None, tell)
        service.store(RECORD)
        await asyncio.wait_for(is_failed.wait(), 30.0)
        await asyncio.sleep(0.05)  # some tries more
        blocker.unlink()
        await asyncio.wait_for(is_mended.wait(), 30.0)
        await service.close()

    asyncio.run(run())
    assert len(told) == 2
    assert goal_file(blocker).read() == RECORD


@pytest.mark.parametrize("is_restarted", [False, True])
def test_the_time_of_the_last_stop_outlives_the_daemon_and_is_bounded_after_a_reboot(
    tmp_path: Path, is_restarted: bool
) -> None:
    async def run() -> None:
        service = GoalService(tmp_path, lambda: None, lambda text: None)
        service.store(replace(RECORD, stood=1.5))
        await service.close()

    asyncio.run(run())
    file = goal_file(tmp_path)
    if is_restarted:
        file.write(replace(file.read(), clock="another"))
    read = GoalService(tmp_path, lambda: None, lambda text: None).read()
    assert read.stood is not None
    assert (read.stood == 1.5) is not is_restarted
    assert read.stood <= boottime()


def test_the_time_of_the_last_stop_lies_not_ahead_on_a_computer_that_was_set_back(
    tmp_path: Path,
) -> None:
    """Else the robot would refuse all runs until then."""

    async def run() -> None:
        service = GoalService(tmp_path, lambda: None, lambda text: None)
        service.store(replace(RECORD, stood=boottime() + 600.0))
        await service.close()

    asyncio.run(run())
    read = GoalService(tmp_path, lambda: None, lambda text: None).read()
    assert read.stood is not None
    assert read.stood <= boottime()


def test_the_last_record_is_on_disk_when_the_service_closes(tmp_path: Path) -> None:
    async def run() -> None:
        service = GoalService(tmp_path, lambda: None, lambda text: None)
        for number in range(1, 20):
            service.store(GoalRecord(labels=(f"l{number}",)))
        await service.close()

    asyncio.run(run())
    assert goal_file(tmp_path).read().labels == ("l19",)


def test_goals_that_no_operator_signed_do_not_survive_a_restart_or_a_roster(tmp_path: Path) -> None:
    keys = SwarmKeys(tmp_path / "keys", "lab", ["r1"], operators=["bob"])
    service = GoalService(tmp_path, lambda: keys["r1"], lambda text: None)
    good = sign_goal(GOAL, keys["bob"])
    foreign = replace(good, generation=9)
    goal_file(tmp_path).write(GoalRecord(held=foreign, own=good, before=GOAL, labels=("red",)))
    assert service.read() == GoalRecord(held=good, own=good, labels=("red",))
    assert service.foreign(service.read()) == ()


def test_false_goals_of_peers_leave_room_for_those_of_operators(tmp_path: Path) -> None:
    keys = SwarmKeys(tmp_path / "keys", "lab", ["r1"], operators=["bob"])
    service = GoalService(tmp_path, lambda: keys["r1"], lambda text: None)
    false = (replace(GOAL, generation=n, signature=bytes(64)) for n in range(4, 99))
    assert None in {service.check(one, 0.0) for one in false}
    asked = GoalRequest(id="g3", operator="bob", targets={}, goal=sign_goal(GOAL, keys["bob"]))
    assert service.refusal_of(asked, "r1") is None
