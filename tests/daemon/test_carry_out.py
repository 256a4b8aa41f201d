"""The order in which the daemon carries out what its robot wants, without a network or a host."""

from __future__ import annotations

from pathlib import Path

from swarmd.core.messages import Code, Reply
from swarmd.core.values import ZERO, Twist
from swarmd.daemon.daemon import Daemon
from swarmd.daemon.store import LatchFile
from swarmd.settings.settings import load_daemon_settings
from tests.daemon.test_daemon import ESTOP, RecordingDriver


async def test_zero_goes_first_then_the_latch_to_the_disk_then_the_ack(tmp_path: Path) -> None:
    """Row 6 of the life of a stop (ARCHITECTURE.md)."""
    values = {"id": "tb3-01", "swarm": "order", "state_dir": str(tmp_path)}
    driver = RecordingDriver()
    daemon = Daemon(load_daemon_settings(None, values), driver)
    stored, store = list[list[Twist]](), daemon._latches.store
    daemon._latches.store = lambda latches: stored.append(driver.sent[:]) or store(latches)  # type: ignore[method-assign, func-returns-value]
    acked: list[tuple[Code, bool]] = []

    def on_ack(reply: Reply) -> None:
        is_on_disk = ESTOP.id in LatchFile(tmp_path / "order" / "tb3-01").read().held
        acked.append((reply.code, is_on_disk))

    daemon._requests.stop(ESTOP, "10.0.0.5", on_ack)
    assert stored == [[ZERO]]
    assert acked == [(Code.APPLIED, True)]
