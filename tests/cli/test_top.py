"""The figures of `swarmctl top`, and their order."""

from __future__ import annotations

import pytest
from click.testing import CliRunner
from msgspec.structs import replace

from swarmd.cli.swarmctl import cli
from swarmd.cli.top import HEADER, SORTS, records, rows
from swarmd.core.messages import Presence, ProcessUsage, State, Status
from swarmd.network.operator.members_view import MembersView
from tests.support.statuses import RUNNING, make_member, status


def loaded(name: str, cpu: float, pattern_cpu: float, memory: int, rate: float) -> Status:
    usage = ProcessUsage(cpu=cpu, memory=memory)
    pattern = ProcessUsage(cpu=pattern_cpu, memory=40_000_000)
    health = replace(RUNNING.health, usage=usage, pattern_usage=pattern, scan_rate=rate)
    return status(name, health=health)


KNOWN = {
    "a": (loaded("a", 0.10, 0.02, 70_000_000, 5.0), 0.1),
    "b": (loaded("b", 0.05, 0.30, 90_000_000, 9.0), 0.2),
    "c": (loaded("c", 0.01, 0.01, 60_000_000, 2.0), 0.3),
}
VIEW = MembersView({name: make_member(name) for name in (*KNOWN, "d")})


def test_a_row_has_the_usage_of_the_daemon_and_its_pattern() -> None:
    row = dict(zip(HEADER, rows(VIEW, ["b"], KNOWN, "cpu")[0], strict=True))
    assert {"CPU": "5%", "P-CPU": "30%", "MEM": "90 MB", "SCAN": "9.0 Hz"}.items() <= row.items()


@pytest.mark.parametrize(
    ("sort", "order"),
    [("cpu", "bac"), ("memory", "bac"), ("scan", "cab"), ("name", "abc"), ("age", "cba")],
)
def test_rows_are_sorted_and_silent_robots_come_last(sort: str, order: str) -> None:
    assert sort in SORTS.values()
    assert [row[0] for row in rows(VIEW, ["d", "c", "a", "b"], KNOWN, sort)] == [*order, "d"]


def test_figures_that_are_old_or_of_a_robot_that_is_gone_are_not_shown() -> None:
    view = MembersView({**VIEW.members, "a": make_member("a", Presence.FAILED)})
    known = {**KNOWN, "b": (KNOWN["b"][0], 60.0)}
    found = {one["robot"]: one["answered"] for one in records(view, ["a", "b", "c"], known)}
    assert found == {"a": False, "b": False, "c": True}


def test_a_daemon_without_figures_has_none() -> None:
    (one,) = records(VIEW, ["d"], {"d": (status("d"), 0.0)})
    assert one["cpu"] is one["pattern_memory"] is None
    assert rows(VIEW, ["d"], {"d": (status("d"), 0.0)}, "cpu")[0][2] == "-"


def test_a_lost_base_is_shown_whatever_the_state() -> None:
    health = replace(RUNNING.health, driver="no such device", driver_up=False)
    lost = {"d": (status("d", state=State.ESTOPPED, health=health), 0.0)}
    (one,) = records(VIEW, ["d"], lost)
    assert (one["state"], one["lost"]) == ("estopped", "no such device")
    assert rows(VIEW, ["d"], lost, "cpu")[0][1] == "estopped, base lost"


def test_without_a_terminal_it_is_one_line() -> None:
    done = CliRunner().invoke(cli, ["top"])
    assert done.exit_code == 2
    assert "--once" in done.output
