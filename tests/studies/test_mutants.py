"""Mutants: which places are changed and how, what is drawn, and which tests notice them."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

from studies.mutants import (
    DECIDES,
    ROOT,
    UNCHANGED,
    Mutant,
    drawn,
    files,
    mutate,
    mutated,
    of_commits,
    places,
    touched,
)

SOURCE = """\
ENDS_RUN = frozenset({Kind.WHEEL_DROP, Kind.LIFTED})
LIMIT = 0.5


def far(x):
    return x > LIMIT and x is not None


def near(x):
    return not far(x) or x in (1.0, 2.0)


@final(check=False)
def least(x: Annotated[float, 2.5], y=3.5) -> float:
    if x:
        raise Wrong(f"{x + y}")
    return min(x, y)
"""


def changes(lines: set[int]) -> list[str]:
    """By number of the place, what its mutant changes."""
    found = []
    for number in touched(SOURCE, lines):
        node, function = list(places(ast.parse(SOURCE)))[number]
        found.append(f"{function}: {mutate(node)}")
    return found


def test_a_table_loses_an_entry() -> None:
    assert changes({1}) == [": without Kind.WHEEL_DROP"]


def test_all_of_a_function_is_changed_whose_line_was_touched() -> None:
    assert sorted(changes({6})) == ["far: > to <=", "far: and to or", "far: is not to is"]


def test_other_functions_stay() -> None:
    assert sorted(changes({9})) == [
        "near: 1.0 to 1.5",
        "near: 2.0 to 3.0",
        "near: in to not in",
        "near: not far(x) to far(x)",
        "near: or to and",
    ]
    assert changes({3}) == []


def test_conditions_and_extremes_are_changed_but_neither_texts_nor_types() -> None:
    assert sorted(changes({16})) == [
        ": 3.5 to 5.25",
        "least: min to max",
        "least: x to not x",
    ]


def test_a_mutant_has_the_lines_of_its_file() -> None:
    """Tracebacks and the comparison with the code that runs depend on it."""
    tree, text = mutated(one_of("swarmd/core/token_bucket.py", "take: - to +"))
    assert text == "swarmd/core/token_bucket.py:26 take: - to +"
    assert "self._tokens += amount" in ast.unparse(tree)


def one_of(path: str, change: str) -> Mutant:
    count = len(list(places(ast.parse((ROOT / path).read_text()))))
    found = (Mutant(path, number) for number in range(count))
    return next(one for one in found if change in mutated(one)[1])


def test_each_file_that_is_named_is_there_and_counts_once() -> None:
    named = [f"{folder}/{name}.py" for folder, names in DECIDES.items() for name in names.split()]
    assert [one for one in named if not (ROOT / one).exists()] == []
    assert len(files()) == len({*files()})
    assert {"swarmd/core/hazard.py", "swarmd/robot/ticker.py", "drivers/ros2/driver.py"} < {
        *files()
    }


def test_the_first_part_of_a_draw_is_the_draw_of_that_size() -> None:
    whole = [Mutant("one.py", number) for number in range(100)]
    assert drawn(whole, 20, seed=1) == drawn(whole, 50, seed=1)[:20]
    assert drawn(whole, 20, seed=1) != drawn(whole, 20, seed=2)
    assert {*drawn(whole, 100, seed=1)} == {*whole}


JUDGE = """
import json, sys
from pathlib import Path
from studies.mutant_runs import judge_all
from studies.mutants import Mutant
mutants = [Mutant(*one) for one in json.loads(sys.argv[1])]
verdicts = judge_all(mutants, jobs=2, folders=json.loads(sys.argv[2]), build=Path(sys.argv[3]))
words = (one.test.partition("::")[0] or one.how.split()[0] for one in verdicts)
print(json.dumps([(one.survived, word) for one, word in zip(verdicts, words)]))
"""


@pytest.mark.integration
def test_a_planted_fault_is_noticed_and_the_code_as_it_is_passes(tmp_path: Path) -> None:
    bucket, delay = "swarmd/core/token_bucket.py", "swarmd/core/arrival_delay.py"
    planted = [
        one_of(bucket, "holds: >= to <"),
        one_of(delay, "module: 0.001 to 0.0015"),  # a constant: in a process of its own
        Mutant(delay, UNCHANGED),
        one_of("swarmd/core/goal.py", "encode_goal: > to <="),
    ]
    tests = ["tests/core/test_token_bucket.py", "tests/core/test_arrival_delay.py"]
    asked = json.dumps([(one.path, one.number) for one in planted]), json.dumps(tests)
    command = [sys.executable, "-c", JUDGE, *asked, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1]) == [
        [False, tests[0]],
        [False, tests[1]],
        [True, "passes"],
        [True, "no"],
    ]


def test_commits_that_are_not_there_are_named() -> None:
    with pytest.raises(SystemExit, match=r"no commits 'nowhere\^!'"):
        of_commits("nowhere")
