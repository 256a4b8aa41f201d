"""The study of faults on DDS: a short form of it, and its table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from studies import keeper
from studies.ros import __main__ as study
from studies.ros.chain import Chain
from studies.ros.faults import Fault, faults
from studies.ros.study import Row, _answer, _fault, rows
from studies.ros.table import HEAD, line, summary
from swarmd.core.messages import State
from tests.support.ros2_bridge import why_no_bridge

SHORT = ("lidar silent", "another node drives: 50 commands per second")


def chosen(names: Sequence[str] = SHORT) -> list[Fault]:
    return [fault for fault in faults() if fault.name in names]


def row(fault: Fault, **changes: object) -> Row:
    seen: dict[str, object] = {
        "noticed": 0.62,
        "says": "`stopped` (`stale_scan`): tcp/127.0.0.1:1234 | x",
        "commanded": 0.4,
        "stood": 0.8,
        "driven": (0.123,),
        "code": 0,
        "taken": 0.24,
        "answer": "commanded zero",
        "late": 0,
        "again": 1.44,
        "needs_more": False,
        "others": "",
    }
    return Row(fault=fault, **{**seen, **changes})  # type: ignore[arg-type]


@pytest.mark.evidence
@pytest.mark.integration
@pytest.mark.skipif(bool(why_no_bridge()), reason=why_no_bridge())
def test_faults_are_noticed_and_no_command_to_move_follows_a_stop(
    tmp_path: Path,
) -> None:
    with Chain(tmp_path, seed=1) as chain:
        found = list(rows(chain, chosen()))
    assert {one.fault.name for one in found} == {*SHORT}
    for one in found:
        assert one.noticed < math.inf, one
        assert one.says, one
        assert one.code == 0, one
        assert one.late == 0, one
        assert one.again < math.inf, one
        assert sum(one.driven) > 0.0, one


def test_the_names_of_the_faults_differ() -> None:
    names = [fault.name for fault in faults()]
    assert len(set(names)) == len(names) >= 20


def test_a_row_tells_what_was_seen() -> None:
    (silent,) = chosen(SHORT[:1])
    cells = line(row(silent), "tcp/127.0.0.1:1234").split(" | ")
    assert cells[0] == "| lidar silent"
    assert cells[1] == "0.6"
    assert cells[2] == "`stopped` (`stale_scan`): tcp/127.0.0.1:7447 / x"
    assert cells[3] == "0.4 (0.7)"
    assert cells[5] == "0.12"
    assert cells[6] == "`stop`: 0, 0.2, commanded zero"
    assert len(cells) == HEAD[0].count("|") - 1


@pytest.mark.parametrize(
    ("changes", "cell", "text"),
    [
        ({"noticed": math.inf}, 1, "**never**"),
        ({"commanded": 0.8}, 3, "**0.8 (0.7)**"),
        ({"late": 3}, 7, "**3**"),
        ({"again": math.inf}, 8, "**not** |"),
    ],
)
def test_a_row_shows_what_must_not_be(changes: dict[str, object], cell: int, text: str) -> None:
    (silent,) = chosen(SHORT[:1])
    seen = row(silent, **changes)
    assert line(seen, "tcp/127.0.0.1:1").split(" | ")[cell] == text
    assert seen.is_late == (cell in (3, 7))


@pytest.mark.parametrize(
    ("printed", "answer"),
    [
        ("tb3-01  applied  commanded zero; measured 0.00 m/s", "commanded zero"),
        ("tb3-01  failed   nothing was sent: driver lost", "failed nothing was sent"),
        ("tb3-02  applied  commanded zero", ""),
    ],
)
def test_the_answer_of_the_robot_is_one_phrase(printed: str, answer: str) -> None:
    assert _answer(f"NAME  ANSWER  TEXT\n{printed}\n", "tb3-01") == answer


@pytest.mark.parametrize(
    ("driver", "state", "text"),
    [
        ("connected", State.RUNNING, ""),
        ("/scan is silent", State.RUNNING, "/scan is silent"),
        ("/odom: its pose jumped by 4.9 m and 34 deg in 0.05 s", State.RUNNING, ""),
        ("/odom: its pose jumped by 4.9 m and 34 deg in 0.05 s", State.STOPPED, "stopped: late"),
    ],
)
def test_that_the_study_carries_a_robot_is_no_report(driver: str, state: State, text: str) -> None:
    status: Any = SimpleNamespace(
        state=state, reason=None, detail="late", health=SimpleNamespace(driver=driver)
    )
    assert _fault(status, "connected", is_ordered=False) == text


def test_the_summary_counts_what_was_noticed_and_who_was_held() -> None:
    first, second = chosen()
    text = summary([row(first), row(second, noticed=math.inf, others="r2: held")], (1, 2), 3)
    assert text.startswith("2 faults, 1 noticed, 0 with")
    assert "r2: held" in text.replace("\n", " ")


def test_a_row_that_is_kept_is_not_measured_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played: list[str] = []

    class FakeChain:
        """A chain without processes, whose robots touch a wall in each row."""

        def __init__(self, folder: Path, seed: int) -> None:
            self.bridge = SimpleNamespace(endpoint=f"tcp/127.0.0.1:{1000 + len(played)}")
            self.contacts = (0, 7)

        def __enter__(self) -> FakeChain:
            return self

        def __exit__(self, *error: object) -> None:
            pass

    def play(chain: FakeChain, fault: Fault) -> Row:
        if len(played) == 2:
            raise KeyboardInterrupt
        played.append(fault.name)
        chain.contacts = (chain.contacts[0], chain.contacts[1] + 1)
        return row(fault, stood=math.inf, says=f"at {chain.bridge.endpoint}")

    for name, value in (("Chain", FakeChain), ("play", play), ("why_no_bridge", lambda: "")):
        monkeypatch.setattr(study, name, value)
    monkeypatch.setattr(keeper, "code_of", lambda perform: "a")
    monkeypatch.setattr(study, "FILE", tmp_path / "rows.jsonl")
    with pytest.raises(KeyboardInterrupt):
        study.main(["--only", "lidar"])
    names = [fault.name for fault in faults() if "lidar" in fault.name]
    assert played == names[:2]
    measured: list[str] = []

    def play_rest(chain: FakeChain, fault: Fault) -> Row:
        measured.append(fault.name)
        return row(fault)

    monkeypatch.setattr(study, "play", play_rest)
    assert study.main(["--only", "lidar"]) == 0
    assert measured == names[2:]
    out = capsys.readouterr().out
    rows = [text for text in out.splitlines() if text.startswith("| ")][1:]
    assert [text.split(" | ")[0] for text in rows] == [f"| {name}" for name in names]
    assert rows[0].split(" | ")[2] == "at tcp/127.0.0.1:7447"
    assert rows[0].split(" | ")[4] == "**not**"
    assert "walls 2 times" in out.replace("\n", " ")
