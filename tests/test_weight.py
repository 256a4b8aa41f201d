"""The weight of the project stays within `tests/weights.toml`: see `tests/support/weight.py`."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.weight import (
    PATTERN,
    WEIGHTS,
    as_toml,
    faults,
    lowered,
    measured,
    places,
    read_limits,
)

MANY = ", ".join(f"a{n}" for n in range(9))
FORMS = [  # a module, and the number of its forms
    ("one = 1\nprint(one)\ndef f(found, *, other): ...", {"one": 2, "found": 1, "other": 1}),
    ("a, b, c = 1, 2, 3\nd, e = 1, 2\nf, g, h = i", {"assignments_of_three_values": 1}),
    ('"""A; b; c; d."""', {"docstrings_above_two_semicolons": 1}),
    ('def f():\n    """It ends.\n\n    It runs."""', {}),
    ('class A:\n    """It ends if it\n    runs."""', {"docstrings_with_a_second_it": 1}),
    (f"class A:\n def __init__(self, {MANY}): ...", {"constructors_above_8_arguments": 1}),
    (
        "class A:\n def __init__(self, f: Callable[[], int], *, g: None | Callable[[], A]): ...",
        {"callables_in_constructors": 2},
    ),
    ("def f():\n" + "    pass\n" * 80, {"functions_above_80_lines": 1}),
    ("def f():\n" + "    pass\n" * 79, {}),
    ("class A:\n" + "    a = 1\n" * 600, {"classes_above_600_lines": 1}),
]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small project of three folders with its limits."""
    for name, text in {
        "swarmd/core/short.py": "class Scan: ...\n",
        "swarmd/core/events.py": "from swarmd.core.short import Scan\n"
        + "detections = Scan\n" * 99,
        "sim/world.py": "class Scan: ...\n" * 2,
        "patterns/walk/pattern.py": "detections = 1\n" * 4,
        "patterns/walk/outcome.py": "one = 1\n" * 5,
        "patterns/sit/pattern.py": "a = 1\n" * 6,
        "tests/core/test_events.py": "a = 1\n" * 10,
        "docs/page.md": "text\n\n<!-- keys: from code -->\n\n| a |\n\n<!-- end of keys -->\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "swarmd/sim").symlink_to("../sim")
    limits = lowered(measured({"named": {"detections": (9,)}}, tmp_path), {})
    (tmp_path / WEIGHTS).write_text(as_toml(limits))
    return tmp_path


def faults_of(root: Path) -> list[str]:
    limits = read_limits(root)
    return list(faults(measured(limits, root), limits))


def test_each_number_keeps_its_limit() -> None:
    assert not (lines := faults_of(Path(__file__).resolve().parents[1])), "\n".join(lines)


def test_the_numbers_of_a_small_tree(tree: Path) -> None:
    assert faults_of(tree) == []
    limits = read_limits(tree)
    assert limits["source"] == {PATTERN: (9, 2), "sim": (2, 1), "swarmd/core": (101, 2)}
    assert limits["tests"] == {"tests/core": (10, 1)}
    assert limits["markdown"] == {"docs": (7, 1)}
    assert limits["named"] == {"detections": (1,)}
    counts = {name: row[0] for name, row in limits["counts"].items() if row[0]}
    assert counts == {
        "short_files_with_one_importer": 1,
        "public_classes_named_twice": 1,
        "generated_lines_in_git": 3,
    }


def test_a_pattern_more_is_no_fault(tree: Path) -> None:
    (tree / "patterns/run").mkdir()
    (tree / "patterns/run/pattern.py").write_text("detections = 1\n" * 9)
    assert faults_of(tree) == []


@pytest.mark.parametrize(
    ("file", "text", "subjects"),
    [
        ("swarmd/core/events.py", "\n", ["swarmd/core: 102 lines, limit 101: take 1 out"]),
        ("sim/world.py", "detections = 1\n", ["sim: 3 lines", "detections: 2 source files"]),
        ("swarmd/kit/new.py", "a = 1\n", ["swarmd/kit: 1 lines, no limit", "kit: 1 files, no"]),
        ("sim/world.py", "one = 1\n", ["sim: 3 lines", "name_one: 1 places, limit 0"]),
    ],
)
def test_a_number_above_its_limit_is_a_fault(
    tree: Path, file: str, text: str, subjects: list[str]
) -> None:
    (tree / file).parent.mkdir(exist_ok=True)
    with (tree / file).open("a") as appended:
        appended.write(text)
    lines = faults_of(tree)
    assert [subject in line for subject, line in zip(subjects, lines, strict=True)] == [
        True for _ in subjects
    ], lines


def test_a_number_left_too_high_is_a_fault_and_is_lowered(tree: Path) -> None:
    (tree / "swarmd/core/events.py").write_text("a = 1\n" * 97)  # 98 lines of 101 are enough
    (tree / "tests/core/test_events.py").unlink()
    (tree / "sim/world.py").write_text("a = 1\n" * 9)
    lines = faults_of(tree)
    assert [line.partition(": ")[2] for line in lines if "lower it to 0" in line]
    assert not any("swarmd/core: 98 lines" in line for line in lines)
    limits = read_limits(tree)
    (tree / WEIGHTS).write_text(as_toml(lowered(measured(limits, tree), limits)))
    assert read_limits(tree)["source"] == {  # none is raised
        PATTERN: (9, 2),
        "sim": (2, 1),
        "swarmd/core": (98, 2),
    }
    assert read_limits(tree)["tests"] == {}
    assert ["sim: 9 lines, limit 2" in line for line in faults_of(tree)] == [True]


def test_a_row_without_a_number_for_each_unit_is_named(tree: Path) -> None:
    text = (tree / WEIGHTS).read_text()
    (tree / WEIGHTS).write_text(text.replace("sim = [2, 1]", "sim = 2"))
    with pytest.raises(ValueError, match="sim has 1 numbers; expected 2"):
        faults_of(tree)


@pytest.mark.parametrize(("text", "wanted"), FORMS)
def test_forms_that_are_counted(tmp_path: Path, text: str, wanted: dict[str, int]) -> None:
    (tmp_path / "sim").mkdir()
    (tmp_path / "sim/world.py").write_text(text)
    counts = places((), tmp_path)["counts"]
    assert {name: len(rows) for name, rows in counts.items() if rows} == {
        name if "_" in name else f"name_{name}": number for name, number in wanted.items()
    }
