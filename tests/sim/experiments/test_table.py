"""runs.csv gives back the same bits, and damage is named by line."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.sim.experiments.plan import Plan, Variant
from swarmd.sim.experiments.store import NAME, Row, header, line_of, lines, read_table

PLAN = Plan(
    "duo", (4, 2), (Variant('law="a,b"', {"x.law": "a,b"}), Variant("law=1.5", {"x.law": 1.5})),
    sweep={"x.law": ["a,b", 1.5]},
)  # fmt: skip
METRICS = ("gap", "time")


def written(folder: Path, *rows: Row) -> Path:
    path = folder / NAME
    path.write_text(lines([header(PLAN, METRICS)]) + "".join(map(line_of, rows)))
    return path


def row(number: int, gap: float | None, time: float | None) -> Row:
    return Row(PLAN.runs[number], {"gap": gap, "time": time}, 0.125)


def test_rows_come_back_with_the_same_bits_in_the_order_of_the_plan(tmp_path: Path) -> None:
    third, first = row(2, 0.1 + 0.2, -0.0), row(0, None, 5e-324)
    written(tmp_path, third, first)
    metrics, found = read_table(tmp_path, PLAN)
    assert metrics == METRICS
    assert list(found.values()) == [first, third]
    assert str(found[third.run.id].metrics["time"]) == "-0.0"


def test_a_row_names_run_variant_values_and_seed(tmp_path: Path) -> None:
    assert header(PLAN, METRICS) == ("run", "variant", "x.law", "seed", "gap", "time", "wall")
    assert row(3, 1.0, 2.0).plain() == {
        "run": "law=1.5_s0002", "variant": "law=1.5", "x.law": 1.5, "seed": 2,
        "gap": 1.0, "time": 2.0, "wall": 0.125,
    }  # fmt: skip


def test_a_torn_last_line_is_left_out(tmp_path: Path) -> None:
    path = written(tmp_path, row(0, 1.0, 2.0))
    with path.open("a") as file:
        file.write(line_of(row(1, 1.0, 2.0))[:-4])
    assert list(read_table(tmp_path, PLAN)[1]) == [PLAN.runs[0].id]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (b"gap,", b"", "runs.csv:2: damaged: it is not about run"),
        (b"gap,time", b"gap,gap", "runs.csv:1: damaged: the columns are not those"),
        (b"run,variant", b"name,variant", "runs.csv:1: damaged: the columns are not those"),
        (b",4,", b",5,", "runs.csv:2: damaged: it is not about run"),
        (b"_s0004", b"_s0009", "runs.csv:2: damaged: no run of its manifest: "),
        (b",1.0,", b",one,", "runs.csv:2: damaged: could not convert string to float: 'one'"),
        (b",1.0,", b",inf,", "runs.csv:2: damaged: a number is not finite"),
        (b",1.0,", b",1.0,3.0,", "runs.csv:2: damaged: it is not about run"),
        (b",1.0,", b",\xff,", "runs.csv:1: damaged: it is no UTF-8 text"),
        (b",1.0,", b',"1.0,', "runs.csv:1: damaged: "),
        (b",0.125", b",", "runs.csv:2: damaged: could not convert"),
    ],
)
def test_damage_is_one_line(tmp_path: Path, old: bytes, new: bytes, fault: str) -> None:
    path = written(tmp_path, row(0, 1.0, 2.0))
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    with pytest.raises(ConfigError) as caught:
        read_table(tmp_path, PLAN)
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_run_that_stands_twice_is_damage(tmp_path: Path) -> None:
    written(tmp_path, row(0, 1.0, 2.0), row(0, 1.0, 2.0))
    with pytest.raises(ConfigError, match=r"runs\.csv:3: damaged: run .* stands twice"):
        read_table(tmp_path, PLAN)


@pytest.mark.parametrize("text", ["", "\n", "run"])
def test_an_empty_file_is_damage(tmp_path: Path, text: str) -> None:
    (tmp_path / NAME).write_text(text)
    with pytest.raises(ConfigError, match=r"runs\.csv:1: damaged"):
        read_table(tmp_path, PLAN)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is missing; restore it"):
        read_table(tmp_path, PLAN)
