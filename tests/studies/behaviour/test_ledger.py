"""Parts that change how robots drive, as the ledger has them; what it names, and how."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import date
from pathlib import Path
from random import Random

import msgspec
import numpy as np
import pytest

from studies.behaviour import ledger
from studies.behaviour.__main__ import main
from studies.behaviour.in_worker import simulated_scene
from studies.behaviour.ledger import (
    RENEWAL,
    Drive,
    Ledger,
    by_how_much,
    described,
    differences,
    drives_of,
    read,
    seconds_of,
    write,
)
from studies.behaviour.scenes import SCENES
from swarmd.core.errors import ConfigError, SwarmError
from swarmd.sim.trace import Trace
from tests.support.behaviour import PATTERNS, assert_drives_as_kept
from tests.support.traces import trace_of

DRAWN = 3
ALIGN = 1.2  # rad/s, of the page of flocking


def trace_of_two(seconds: float) -> Trace:
    """Two robots that drive straight on, ten poses a second; the commands are 0.1 m/s."""
    t = np.arange(round(10 * seconds) + 1) / 10.0
    pose = np.zeros((len(t), 2, 3))
    pose[:, 0, 0] = 0.1 * t
    pose[:, 1, 1] = 0.2 * t
    trace = trace_of(pose)
    safe = np.full_like(pose, 0.1)
    return replace(trace, safe=safe, requested=safe)


@pytest.mark.compiled_only(reason="eleven times as dear; the long lane draws three")
@pytest.mark.parametrize("name", [name for name in SCENES if name not in PATTERNS])
def test_robots_drive_as_kept(name: str, tmp_path: Path) -> None:
    assert_drives_as_kept(name, tmp_path)


@pytest.mark.long
def test_scenes_drawn_by_the_date_drive_as_kept_with_interpreted_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled kernels are equal to the bit, so any scene does; the first seconds alone."""
    monkeypatch.setenv("SWARMD_COMPILED", "0")
    for name in Random(date.today().toordinal()).sample([*SCENES], DRAWN):
        assert_drives_as_kept(name, tmp_path, seconds=2.5)


@pytest.mark.evidence
@pytest.mark.parametrize("name", SCENES)
def test_every_scene_drives_as_kept_with_interpreted_kernels(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SWARMD_COMPILED", "0")
    assert_drives_as_kept(name, tmp_path)


def test_every_pattern_has_a_scene() -> None:
    assert set(SCENES) >= PATTERNS
    assert len(PATTERNS) >= 34


def test_a_change_of_a_millionth_of_a_millionth_is_named_by_scene_robot_and_second(
    tmp_path: Path,
) -> None:
    """A gain of flocking; the control is the same run without it."""
    first, again = (drives_of(simulated_scene("flocking", tmp_path, 4.0)) for _ in range(2))
    changes = {"groups.tb3.parameters.align": ALIGN * (1.0 + 1e-12)}
    changed = drives_of(simulated_scene("flocking", tmp_path, 4.0, changes))
    assert [*differences({"flocking": first}, {"flocking": again})] == []
    lines = [described(one) for one in differences({"flocking": first}, {"flocking": changed})]
    assert lines
    assert all(
        re.fullmatch(r"flocking: tb3-0[1-7] drives otherwise from [0-3] s on", line)
        for line in lines
    )


def drive(*seconds: str) -> Drive:
    return Drive("".join(seconds), (0.0, 0.0, 0.0))


A = "a" * 8
B = "b" * 8


@pytest.mark.parametrize(
    ("kept", "now", "wanted"),
    [
        ({"s": {"r": drive(A, A)}}, {"s": {"r": drive(A, A)}}, []),
        ({"s": {"r": drive(A, A)}}, {"s": {"r": drive(A, B)}}, [("s", "r", 1)]),
        ({"s": {"r": drive(B, A)}}, {"s": {"r": drive(A, B)}}, [("s", "r", 0)]),
        # Of a shorter run the first seconds are compared.
        ({"s": {"r": drive(A, B)}}, {"s": {"r": drive(A)}}, []),
        (
            {"s": {"p": drive(A), "r": drive(A)}},
            {"s": {"p": drive(B), "r": drive(A)}},
            [("s", "p", 0)],
        ),
        ({"s": {"r": drive(A)}}, {"s": {}}, [("s", "r", "is gone")]),
        ({"s": {}}, {"s": {"r": drive(A)}}, [("s", "r", "is new")]),
        ({"s": {}}, {"t": {}}, [("s", "", "is gone"), ("t", "", "is new")]),
    ],
)
def test_differences_name_scene_robot_and_second(
    kept: ledger.Scenes, now: ledger.Scenes, wanted: list[tuple[str, str, int | str]]
) -> None:
    found = [*differences(kept, now)]
    assert [one[:2] for one in found] == [one[:2] for one in wanted]
    for (_, _, text), (_, _, what) in zip(found, wanted, strict=True):
        assert re.findall(r"\d+", text) == [str(what)] if isinstance(what, int) else text == what


def test_an_instant_belongs_to_the_second_that_it_ends() -> None:
    found = [rows.tolist() for rows in seconds_of(np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5]))]
    assert found == [[0, 1, 2], [3, 4], [5]]


def test_each_field_of_a_second_counts_for_its_robot_alone() -> None:
    """A command of the second robot at 1.5 s: its second 1, and nothing else."""
    trace = trace_of_two(3.0)
    safe = trace.safe.copy()
    at = int(np.argmin(np.abs(trace.t - 1.5)))
    safe[at, 1, 0] = np.nextafter(safe[at, 1, 0], 9.0)
    was = drives_of(trace)
    now = drives_of(replace(trace, safe=safe))
    one, other = trace.ids
    assert now[one] == was[one]
    equal = [a == b for a, b in zip(was[other].hashes, now[other].hashes, strict=True)]
    assert equal == [True, False, True]


def test_how_much_is_the_distance_at_the_end_and_the_mean_speeds() -> None:
    trace = trace_of_two(2.0)
    pose = trace.pose.copy()
    pose[-1, 0, 0] += 0.0008
    text = by_how_much(trace, replace(trace, pose=pose), trace.ids[0])
    assert text.startswith("0.8 mm ")
    assert "0.100 ->" in text


def test_a_ledger_is_read_as_it_was_written_and_names_other_software(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ledger, "FILE", tmp_path / "ledger.json")
    with pytest.raises(ConfigError, match=r"ledger\.json"):
        read()
    made = Ledger(ledger.note(), {"s": {"r": Drive(A, (0.5, None, -1.0))}})
    write(made)
    assert read() == made
    assert made.other_software() == ""
    old = msgspec.structs.replace(made, made_with={**made.made_with, "mujoco": "1.0"})
    assert old.other_software().startswith("mujoco: 1.0, here ")


def test_the_ledger_was_made_with_the_versions_that_this_checkout_installs() -> None:
    """With others each comparison would be skipped, and the gate would pass without it."""
    made = read().made_with
    lines = Path("constraints.txt").read_text().splitlines()
    installed = dict(line.split("==") for line in lines if "==" in line)
    wanted = {name: installed[name] for name in ("numpy", "scipy")}
    wanted["mujoco"] = installed["mujoco-core"]
    assert {**made, **wanted, "pinned": "yes"} == made, f"`{RENEWAL}` writes it again"


def test_a_process_that_is_not_pinned_writes_no_ledger(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.behaviour.__main__.note", lambda: {"pinned": "no"})
    with pytest.raises(SwarmError, match="not pinned"):
        main([])


def test_an_unknown_scene_or_commit_is_refused() -> None:
    with pytest.raises(ConfigError, match="'flocking'"):
        main(["--only", "floking"])
    with pytest.raises(ConfigError, match="no-such-commit"):
        main(["--against", "no-such-commit"])
