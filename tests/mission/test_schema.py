"""Mission files are checked as a whole: each fault is a line with file, line and key."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.pattern_host.plugin_inspector import check_mission
from swarmd.plugins import pattern_names
from tests.support.mission_parts import PLATFORM, made, mission_of

GOOD = """\
mission: Votes, then drives
parts:
  vote: {pattern: vote_on}
  go: {pattern: go}
map:
  - {from: vote.opinion, to: go.speed, values: [0.3, 0.5, 0.7]}
sequence:
  - {part: vote, until: {timeout: 20}}
  - {parallel: [vote, go], drives: go}
then: stay
"""
PART = "part: vote, until: {timeout: 20}"
VALUES = "values: [0.3, 0.5, 0.7]"
STAY = "then: stay"
WRONG = (  # what is replaced, by what, the line of the fault, and what it must name
    ("mission: Votes, then drives\n", "", 1, "mission"),
    ("pattern: go}", "pattern: og}", 4, "parts.go.pattern", "'og'", "brief, go"),
    ("pattern: go}", "pattern: 3}", 4, "parts.go.pattern", "3"),
    ("pattern: go}", "patern: go}", 4, "parts.go", "'patern'", "'pattern'"),
    ("pattern: go}", "pattern: go, params: {sped: 1}}", 4, "parts.go", "'sped'", "'speed'"),
    ("pattern: go}", "pattern: go, params: {speed: 2}}", 4, "parts.go", "speed", "from 0 to 1 m/s"),
    ("pattern: go}", "pattern: go, private: 1}", 4, "parts.go.private", "1"),
    ("  go: {pattern: go}", "  go: {pattern: go}\n  idle: {pattern: go}", 5, "parts.idle"),
    ("from: vote", "from: vot", 6, "map[0].from", "'vot'", "'vote'"),
    ("vote.opinion, to", "vote.opinon, to", 6, "map[0].from", "'opinon'", "'opinion'"),
    ("go.speed", "go.sped", 6, "map[0]", "'sped'", "'speed'"),
    ("go.speed", "vote.window", 6, "map[0].to", "vote"),
    ("0.3, 0.5, 0.7", "0.3, 0.666, 0.7", 6, "map[0]", "vote.opinion is 1", "not that speed"),
    ("0.3, 0.5, 0.7", "0.3, 0.5, 7", 6, "map[0]", "go.speed to 7 where vote.opinion is 2"),
    ("0.3, 0.5, 0.7", "0.3, 0.5", 6, "map[0].values", "opinion 2"),
    (VALUES, "base: 0.5, step: 0.3", 6, "map[0]", "go.speed to 1.1"),
    (VALUES, "base: 0.5", 6, "map[0].step"),
    (VALUES, "", 6, "map[0]", "values", "base"),
    (VALUES, "base: 0.3, step: 0.1, count: 3.5", 6, "map[0].count", "3.5"),
    (f"to: go.speed, {VALUES}", "to: go.recovery, base: 1, step: 0", 6, "map[0].to", "recovery"),
    ("{timeout: 20}", "{timeout: 20, nearer: 1}", 8, "sequence[0].until", "timeout and nearer"),
    ("{timeout: 20}", "{timeot: 20}", 8, "sequence[0].until", "timeot"),
    ("{timeout: 20}", f"{{timeout: 1{'0' * 400}}}", 8, "sequence[0].until.timeout"),
    ("{timeout: 20}", "{done: voter}", 8, "sequence[0].until.done", "'voter'", "'vote'"),
    ("{timeout: 20}", "{settled: vote.opinon, for: 2}", 8, "until", "'opinon'", "'opinion'"),
    ("{timeout: 20}", "{settled: opinion, for: 2}", 8, "until.settled", "'opinion'"),
    (", until: {timeout: 20}", "", 8, "sequence[0]", "until"),
    (PART, "sequence: [vote], then: stay", 8, "sequence[0]", "until"),
    (PART, f"sequence: [{{{PART}}}], then: repeat", 8, "sequence[0]", "until"),
    ("part: vote,", "part: vot,", 8, "sequence[0].part", "'vot'", "'vote'"),
    ("part: vote,", "part: vote, when: {timeout: 1},", 8, "sequence[0].when", "switch"),
    (", drives: go", "", 9, "sequence[1].drives"),
    ("drives: go", "drives: og", 9, "sequence[1].drives", "'og'", "go, vote"),
    ("[vote, go], drives", "[vote, go, {sequence: [go], then: stay}], drives", 9, "part go twice"),
    ("[vote, go], drives: go}", "[], drives: go}", 9, "sequence[1].parallel", "[]"),
    ("[vote, go], drives", "[{part: vote, name: go}, go], drives", 9, "sequence[1].drives", "two"),
    ("until: {timeout: 20}}", "retry: 2, until: {timeout: 2}}", 8, "sequence[0].retry", "fails"),
    ("until: {timeout: 20}}", "until: {timeout: 2}, fails: {done: voter}}", 8, "fails", "'vote'"),
    (PART, "fallback: [vote, go], until: {timeout: 2}", 8, "sequence[0].fallback[0]", "fails"),
    (PART, "part: vote, fails: {timeout: 2}", 8, "sequence[0]", "until"),
    (PART, f"{PART}, transitions: {{og: {{timeout: 2}}}}", 8, "transitions.og", "no step 'og'"),
    (PART, f"{PART}, transitions: {{go: {{timeot: 2}}}}", 8, "transitions.go", "timeot"),
    (PART, f"{PART}, transitions: {{}}", 8, "sequence[0].transitions", "{}"),
    (PART, f"{PART}, name: both, transitions: {{both: {{done: og}}}}", 8, "both.done", "'og'"),
    (
        "vote, go], drives: go",
        "{part: go, transitions: {go: {timeout: 2}}}], drives: go",
        9,
        "step of",
    ),
    (STAY, "then: stay\ntransitions: {go: {timeout: 2}}", 11, "transitions", "step of a sequence"),
    ("{timeout: 20}", "{not: {probability: 0.5}}", 8, "sequence[0].until.not", "drawn"),
    (
        PART,
        "switch: [{when: {probability: 1}, part: vote}], until: {timeout: 2}",
        8,
        "when",
        "drawn",
    ),
    (STAY, "then: end", 9, "sequence[1]", "until"),
    (STAY, "then: go", 10, "then", "'go'", "stay"),
    (STAY, "", 7, "then", "stay"),
    (STAY, "then: stay\nuntl: 3", 11, "'untl'", "'until'"),
    (STAY, "then: stay\nrecovery: 1", 11, "recovery", "1"),
    (STAY, "then: stay\nreport: {a: go.stps}", 11, "report.a", "'stps'", "'steps'"),
    (STAY, "then: stay\nparameters: {a: go.sped}", 11, "parameters.a", "'sped'", "'speed'"),
    (STAY, "then: stay\nparameters: {a: go.speed}", 11, "parameters.a", "map"),
    (STAY, "then: stay\nparameters: {__init__: vote.window}", 11, "parameters.__init__"),
    (STAY, "then: stay\nparameters: {a: vote.window, b: vote.window}", 11, "parameters.b", "a"),
    (STAY, "then: stay\nparameters: {a: go.recovery}", 11, "parameters.a", "recovery"),
    (STAY, "then: stay\nparameters: {a: go.avoidance}", 11, "parameters.a", "avoidance"),
)


def faults_of(folder: Path, text: str) -> list[str]:
    """The fault for which a robot refuses the mission."""
    try:
        made(folder, text)
    except ConfigError as error:
        return [str(error)]
    return []


def test_a_good_mission_has_no_faults(tmp_path: Path) -> None:
    assert faults_of(tmp_path, GOOD) == []


@pytest.mark.parametrize("row", WRONG, ids=lambda row: f"{row[1][:40]}-{row[3]}")
def test_a_fault_has_file_line_and_key(tmp_path: Path, row: tuple[Any, ...]) -> None:
    old, new, line, *subjects = row
    assert GOOD.count(old) == 1, old
    (fault,) = faults_of(tmp_path, GOOD.replace(old, new))
    assert f"tried.yaml:{line}: " in fault
    assert all(subject in fault for subject in subjects)
    assert "\n" not in fault


LOOP = """\
mission: Drives by turns
parts: {go: {pattern: go}}
sequence:
  - {part: go, name: a, transitions: {c: {timeout: 1}}}
  - {part: go, name: b, until: {timeout: 1}}
  - {part: go, name: c, transitions: {a: {timeout: 1}}}
then: repeat
"""


def test_a_step_that_nothing_leads_to_is_a_fault(tmp_path: Path) -> None:
    (fault,) = faults_of(tmp_path, LOOP)
    assert "tried.yaml:5: sequence[1] " in fault
    assert "never reached" in fault
    assert faults_of(tmp_path, LOOP.replace("{a: {t", "{b: {t")) == []
    (twice,) = faults_of(tmp_path, LOOP.replace("name: b", "name: c"))
    assert "tried.yaml:4: sequence[0].transitions.c is c, the name of two steps" in twice


def test_unknown_names_are_faults_beside_others_of_the_same_elements(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text(
        "mission: Drives by turns\n"
        "parts: {go: {pattern: drive}}\n"
        "sequence:\n"
        "  - {part: go, name: a, transitions: {d: {timeot: 1}}}\n"
        "  - {part: og, until: {timeout: 1}}\n"
        "  - {part: go, name: c, until: {timeot: 1}, transitions: {e: {timeout: 1}}}\n"
        "then: repeat\n"
    )
    found = check_mission(path, PLATFORM, tmp_path)
    assert [re.sub(r".*yaml:(\d+): (\S+).*", r"\1 \2", one) for one in found] == [
        "4 sequence[0].transitions.d",
        "4 sequence[0].transitions.d",
        "5 sequence[1].part",
        "6 sequence[2].until",
        "6 sequence[2].transitions.e",
    ]


def test_two_parts_on_one_channel_are_a_fault(tmp_path: Path) -> None:
    two = "  vote: {pattern: vote_on}\n  more: {pattern: vote_on}"
    text = GOOD.replace("  vote: {pattern: vote_on}", two).replace("[vote, go]", "[vote, more, go]")
    (fault,) = faults_of(tmp_path, text)
    assert "tried.yaml:4: parts.more " in fault
    assert "vote_on/" in fault
    assert faults_of(tmp_path, text.replace("more: {", "more: {private: true, ")) == []


def test_a_part_on_the_channel_of_an_inner_part_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "both.yaml"
    path.write_text(
        "mission: Votes, and disperses by another vote\n"
        "parts:\n  vote: {pattern: majority_rule}\n  move: {pattern: discussed_dispersion}\n"
        "parallel: [vote, move]\ndrives: move\n"
    )
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert "both.yaml:4: parts.move " in fault
    assert "majority_rule/" in fault


RAISING = {
    "when it is imported": "raise SystemExit('x')",
    "when its class is looked at": "params_type = 3",
    "when it is made": "def __init__(self, *a):\n        raise ZeroDivisionError('a\\nb')",
}


@pytest.mark.parametrize("when", RAISING)
def test_a_part_that_raises_is_a_fault(tmp_path: Path, when: str) -> None:
    start = "from swarmd.api import *\nclass Bad(Pattern[Params]):\n    "
    head = "" if "imported" in when else start
    (tmp_path / "bad.py").write_text(
        f"{head}{RAISING[when]}\n" + "    def step(self, inputs): return Outputs()\n" * bool(head)
    )
    path = tmp_path / "uses.yaml"
    path.write_text("mission: a\nparts: {b: {pattern: bad}}\npart: b\n")
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert re.search(r"uses.yaml:2: parts.b(.pattern)? cannot be \w+: [A-Z]\w+: \S", fault)
    assert "\n" not in fault


def test_the_first_fault_counts_the_others(tmp_path: Path) -> None:
    text = GOOD.replace("{timeout: 20}", "{timeot: 20}").replace("then: stay", "then: go")
    (fault,) = faults_of(tmp_path, text)
    assert "1 more" in fault


def test_a_file_that_is_not_yaml_is_refused_with_its_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=re.escape("tried.yaml:2:")):
        mission_of(tmp_path, "mission: a\nmission: b\n")


@pytest.mark.parametrize("head", ["\ufeffmission:", "'mission':", "mission :"])
def test_a_checked_mission_is_also_found_by_robots(tmp_path: Path, head: str) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(LOW.replace("mission:", head).replace("0.4", "0.6"), encoding="utf-8")
    assert check_mission(path, PLATFORM, tmp_path) == []
    assert "low" in pattern_names(tmp_path)


ALONE = "mission: a\nparts: {b: {pattern: drive}}\npart: b\n"
IN_BRACES = '{"mission": a, parts: {b: {pattern: drive}}, part: b}'


@pytest.mark.parametrize(("text", "encoding"), [(ALONE, "utf-16"), (IN_BRACES, "utf-8")])
def test_a_mission_that_robots_do_not_find_is_a_fault(
    tmp_path: Path, text: str, encoding: str
) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(text, encoding=encoding)
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert "low.yaml:1: mission " in fault
    assert "low" not in pattern_names(tmp_path)


LOW = """\
mission: Distances, one of which dispersion refuses
parts:
  vote: {pattern: majority_rule}
  move: {pattern: dispersion}
map:
  - {from: vote.opinion, to: move.distance, values: [0.4, 1.0, 1.4]}
parallel: [vote, move]
drives: move
"""


def test_a_map_value_that_its_target_refuses_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(LOW)
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert "low.yaml:6: map[0] sets move.distance to 0.4 where vote.opinion is 0: " in fault
    assert "0.5 m" in fault
    path.write_text(LOW.replace("0.4", "0.6"))
    assert check_mission(path, PLATFORM, tmp_path) == []


MANY = """\
mission: Two parameters, the target of a map, an item and a key are wrong
parts:
  vote: {pattern: majority_rule}
  move: {pattern: dispersion, params: {distance: -1, sped: 0.1}}
map:
  - {from: vote.opinion, to: move.distanc, values: [0.6, 1.0, 1.4]}
parallel: [vote, move]
drives: mov
"""


def test_all_faults_are_found_each_once(tmp_path: Path) -> None:
    path = tmp_path / "many.yaml"
    path.write_text(MANY)
    faults = check_mission(path, PLATFORM, tmp_path)
    places = [line.partition("many.yaml:")[2].split()[:2] for line in faults]
    assert places == [
        ["4:", "parts.move.params.distance"],
        ["4:", "parts.move.params.sped"],
        ["6:", "map[0].to"],
        ["8:", "drives"],
    ]
    hints = [re.findall(r"did you mean '(\w+)'", line) for line in faults]
    assert hints == [[], ["speed"], ["distance"], ["move"]]


def test_a_mistyped_kind_of_element_gets_a_hint(tmp_path: Path) -> None:
    path = tmp_path / "kind.yaml"
    path.write_text("mission: a\nparts: {b: {pattern: drive}}\nsequnce: [b]\n")
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert "kind.yaml:3: " in fault
    assert "'sequence'" in fault


def test_a_mission_that_contains_itself_is_a_fault(tmp_path: Path) -> None:
    for name, other in (("one", "two"), ("two", "one")):
        text = f"mission: Round\nparts: {{a: {{pattern: {other}}}}}\npart: a\n"
        (tmp_path / f"{name}.yaml").write_text(text)
    (fault,) = check_mission(tmp_path / "one.yaml", PLATFORM, tmp_path)
    assert "itself" in fault


def test_a_mission_may_contain_another(tmp_path: Path) -> None:
    (tmp_path / "inner.yaml").write_text(LOW.replace("0.4", "0.6"))
    text = "mission: Outer\nparts: {a: {pattern: inner}}\npart: a\n"
    (tmp_path / "outer.yaml").write_text(text)
    assert check_mission(tmp_path / "outer.yaml", PLATFORM, tmp_path) == []


def test_the_name_of_another_pattern_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text(LOW.replace("0.4", "0.6"))
    (fault,) = check_mission(path, PLATFORM, tmp_path)
    assert re.search(r"mission .* another pattern \(swarmd [0-9.]+\)", fault)
