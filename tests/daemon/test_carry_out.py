"""What the daemon makes of its robot, and in which order, without a network or a pattern host."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from swarmd.core.codec import Decoder
from swarmd.core.events import Input, LeaveInput, NetworkInput, NoteInput, RosterInput
from swarmd.core.goal import GoalRecord
from swarmd.core.messages import Code, PeerFault, Reply
from swarmd.core.values import ZERO, Twist
from swarmd.daemon import daemon as daemon_module
from swarmd.daemon.daemon import Daemon
from swarmd.daemon.store import LatchFile
from swarmd.link.datagram import Stop
from swarmd.link.peer import PeerActions
from swarmd.robot.latches import LatchRecord
from swarmd.settings.settings import load_daemon_settings
from tests.daemon.test_daemon import ESTOP, RecordingDriver


@pytest.fixture(autouse=True)
def _no_host(monkeypatch: pytest.MonkeyPatch) -> None:
    """No process for the pattern."""
    runner = SimpleNamespace(
        send=lambda _: None, close=lambda: None, events=list, pid=None, sandbox="", dropped={}
    )
    monkeypatch.setattr(daemon_module, "ProcessRunner", lambda *_, **__: runner)


@pytest.fixture(autouse=True)
def _no_capture() -> Iterator[None]:
    """These daemons do not run, so nothing ends their capture of the log of this process."""
    before = list(logging.getLogger().handlers)
    yield
    logging.getLogger().handlers[:] = before


class Watched(Daemon):
    """A daemon in a state folder, with a driver that keeps its commands."""

    def __init__(self, folder: Path, **values: str | bool) -> None:
        given = {"id": "tb3-01", "swarm": "order", "state_dir": str(folder), **values}
        self.driver, self.inputs = RecordingDriver(), list[Input]()
        super().__init__(load_daemon_settings(None, given), self.driver)

    def step(self, input: Input, **options: Any) -> None:
        self.inputs.append(input)
        super().step(input, **options)


async def test_zero_goes_first_then_the_latch_to_the_disk_then_the_ack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Row 6 of the life of a stop (ARCHITECTURE.md)."""
    daemon = Watched(tmp_path)
    stored, store = list[list[Twist]](), daemon._latches.store

    def note(record: LatchRecord) -> bool:
        stored.append(daemon.driver.sent[:])
        return store(record)

    monkeypatch.setattr(daemon._latches, "store", note)
    acked: list[tuple[Code, bool]] = []

    def on_ack(reply: Reply) -> None:
        is_on_disk = ESTOP.id in LatchFile(tmp_path / "order" / "tb3-01").read().held
        acked.append((reply.code, is_on_disk))

    daemon._requests.stop(ESTOP, "10.0.0.5", on_ack)
    assert stored == [[ZERO]]
    assert acked == [(Code.APPLIED, True)]


async def test_the_end_of_a_goal_is_on_disk_before_a_stop_is_acked(tmp_path: Path) -> None:
    """A robot that restarts would run the goal again (docs/evidence/motion.md, `later_run`)."""
    daemon = Watched(tmp_path)
    acked: asyncio.Future[GoalRecord] = asyncio.get_running_loop().create_future()
    file = tmp_path / "order" / "tb3-01" / "goal"

    def on_ack(reply: Reply) -> None:
        acked.set_result(Decoder(GoalRecord)(file.read_bytes()))

    daemon._requests.stop(Stop(id="s1", verb="stop", operator="alice"), "10.0.0.5", on_ack)
    assert daemon.driver.sent == [ZERO]
    async with asyncio.timeout(60.0):
        record = await acked
    assert record.stood is not None
    await daemon._goals.close()


@pytest.mark.parametrize("has_crashed", [False, True])
async def test_each_way_to_end_commands_zero(tmp_path: Path, has_crashed: bool) -> None:
    """The daemon raises: the robot gets zero (docs/failures.md). A crash says no farewell."""
    daemon = Watched(tmp_path)
    if has_crashed:
        context = {"exception": ZeroDivisionError("on purpose"), "message": "a test"}
        daemon._on_crash(asyncio.get_running_loop(), context)
        assert daemon.driver.sent == [ZERO]
        daemon.driver.sent.clear()
    daemon._leave()
    assert daemon.driver.sent[:1] == [ZERO]
    assert any(isinstance(one, LeaveInput) for one in daemon.inputs) is not has_crashed


@pytest.mark.parametrize("is_revoked", [False, True])
async def test_a_robot_that_takes_a_roster_stands(tmp_path: Path, is_revoked: bool) -> None:
    """docs/security.md."""
    daemon: Any = Watched(tmp_path)
    daemon._network = daemon._puller = SimpleNamespace(take_identity=lambda _: None)
    identity = SimpleNamespace(roster=SimpleNamespace(generation=7))
    daemon._on_roster(SimpleNamespace(identity=identity, text="roster 7", is_revoked=is_revoked))
    assert [one for one in daemon.inputs if isinstance(one, RosterInput)] == [
        RosterInput("roster 7", is_revoked)
    ]


@pytest.mark.parametrize(("must_reopen", "kind"), [(True, NetworkInput), (False, NoteInput)])
async def test_another_address_of_the_interface_stops_the_robot(
    tmp_path: Path, must_reopen: bool, kind: type[Input]
) -> None:
    daemon = Watched(tmp_path)
    change: Any = SimpleNamespace(line="another address", must_reopen=must_reopen)
    daemon.on_interface(change)
    assert [type(one) for one in daemon.inputs] == [kind]


@pytest.mark.parametrize(
    ("values", "takes"), [({}, True), ({"profile": "field", "interface": "lo"}, False)]
)
async def test_without_keys_code_is_taken_on_this_computer_alone(
    tmp_path: Path, values: dict[str, str], takes: bool
) -> None:
    """A swarm without keys on a network takes no code, since anyone could send it."""
    daemon = Watched(tmp_path, insecure=True, **values)
    assert daemon._operators() == (None if takes else {})


async def test_what_peers_tell_of_robots_reaches_the_status(tmp_path: Path) -> None:
    daemon = Watched(tmp_path)
    mute = PeerFault(robot="tb3-02", kind="mute", by=3, of=4, since=6.0)
    daemon._network._owner = daemon  # as in a run
    daemon._network._hand_inputs(PeerActions(peer_faults=(mute,)))
    assert [(one.robot, one.kind) for one in daemon.status().peer_faults] == [("tb3-02", "mute")]
    daemon._network._hand_inputs(PeerActions())  # no change
    assert len(daemon.status().peer_faults) == 1
    daemon._network._hand_inputs(PeerActions(peer_faults=()))
    assert daemon.status().peer_faults == ()
