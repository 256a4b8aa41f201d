"""Mission files are checked as a whole: each fault is a line with file, line and key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.pattern_host.inspect_mission import check_mission
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
WRONG = (
    ("mission: Votes, then drives\n", "", 1, "mission: is missing"),
    ("pattern: go}", "pattern: og}", 4, "parts.go.pattern: no pattern 'og'; there are: brief, go"),
    ("pattern: go}", "patern: go}", 4, "parts.go.patern: no key 'patern'; did you mean"),
    ("go: {pattern: go}", "go: {pattern: go, params: {sped: 1}}", 4, "no parameter 'sped'"),
    ("go: {pattern: go}", "go: {pattern: go, params: {speed: 2}}", 4, "a float from 0 to 1 m/s"),
    ("go: {pattern: go}", "go: {pattern: go, private: 1}", 4, "parts.go.private: is 1"),
    ("  go: {pattern: go}", "  go: {pattern: go}\n  idle: {pattern: go}", 5, "never stepped"),
    ("from: vote", "from: vot", 6, "map[0].from: no part 'vot'; did you mean 'vote'?"),
    ("vote.opinion, to", "vote.opinon, to", 6, "no report 'opinon'; did you mean 'opinion'"),
    ("go.speed", "go.sped", 6, "no parameter 'sped'; did you mean 'speed'"),
    ("go.speed", "vote.window", 6, "map[0].to: is of vote itself"),
    ("0.3, 0.5, 0.7", "0.3, 0.666, 0.7", 6, "where vote.opinion is 1: not that speed"),
    ("0.3, 0.5, 0.7", "0.3, 0.5, 7", 6, "sets go.speed to 7 where vote.opinion is 2: parameter"),
    ("0.3, 0.5, 0.7", "0.3, 0.5", 6, "no value for opinion 2; vote has 3 opinions"),
    ("values: [0.3, 0.5, 0.7]", "base: 0.5, step: 0.3", 6, "sets go.speed to 1.1"),
    ("values: [0.3, 0.5, 0.7]", "base: 0.5", 6, "map[0].step: is missing"),
    ("values: [0.3, 0.5, 0.7]", "", 6, "wanted either values, or base and step"),
    ("{timeout: 20}", "{timeout: 20, nearer: 1}", 8, "put them under any"),
    ("{timeout: 20}", "{timeot: 20}", 8, "sequence[0].until: says nothing"),
    ("{timeout: 20}", "{done: voter}", 8, "no part 'voter'; did you mean 'vote'?"),
    ("{timeout: 20}", "{settled: vote.opinon, for: 2}", 8, "no report 'opinon'"),
    ("{timeout: 20}", "{settled: opinion, for: 2}", 8, "'opinion' is no PART.KEY"),
    (", until: {timeout: 20}", "", 8, "sequence[0]: never ends, and more steps follow"),
    ("part: vote, until: {timeout: 20}", "sequence: [vote], then: stay", 8, "never ends, and more"),
    (
        "part: vote, until: {timeout: 20}",
        "sequence: [{part: vote, until: {timeout: 20}}], then: repeat",
        8,
        "sequence[0]: never ends, and more steps follow",
    ),
    ("part: vote,", "part: vot,", 8, "sequence[0]: no part 'vot'"),
    (", drives: go", "", 9, "sequence[1].drives: is missing; wanted the part that drives"),
    ("drives: go", "drives: og", 9, "no item 'og'; there are: go, vote (or nobody)"),
    ("[vote, go], drives", "[vote, go, go], drives", 9, "steps part go twice at once"),
    ("[vote, go], drives: go}", "[], drives: go}", 9, "sequence[1].parallel: is []"),
    ("then: stay", "then: end", 9, "sequence[1]: never ends, and then is end"),
    ("then: stay", "then: go", 10, "then: is 'go'; wanted one of end, stay, repeat"),
    ("then: stay", "", 1, "then: is missing; wanted one of end, stay, repeat"),
    ("then: stay", "then: stay\nuntl: 3", 11, "untl: no key 'untl'; did you mean 'until'?"),
    ("then: stay", "then: stay\nparameters: {a: go.sped}", 11, "parameters.a: is of parameter"),
    ("then: stay", "then: stay\nparameters: {a: go.speed}", 11, "is what a map sets"),
    ("then: stay", "then: stay\nreport: {a: go.stps}", 11, "no report 'stps'"),
    ("pattern: go}", "pattern: 3}", 4, "parts.go.pattern: is 3; wanted a pattern's name"),
    ("{timeout: 20}", f"{{timeout: 1{'0' * 400}}}", 8, "wanted a number above 0 and up to"),
    ("values: [0.3, 0.5, 0.7]", "base: 0.3, step: 0.1, count: 3.5", 6, "wanted a whole number"),
    ("[vote, go], drives", "[{part: vote, name: go}, go], drives", 9, "go is the name of two"),
    ("then: stay", "then: stay\nparameters: {__init__: vote.window}", 11, "__init__: is no name"),
    ("then: stay", "then: stay\nparameters: {a: vote.window, b: vote.window}", 11, "what a sets"),
    ("then: stay", "then: stay\nparameters: {a: go.recovery}", 11, "a mission has as a whole"),
    ("to: go.speed, values: [0.3, 0.5, 0.7]", "to: go.recovery, base: 1, step: 0", 6, "as a whole"),
    ("then: stay", "then: stay\nunstick: 1", 11, "recovery: is 1; wanted true or false"),
)


def faults_of(folder: Path, text: str) -> list[str]:
    """All faults, as a robot would tell of the first."""
    try:
        made(folder, text)
    except ConfigError as error:
        return [str(error)]
    return []


def test_a_good_one_has_none(tmp_path: Path) -> None:
    assert faults_of(tmp_path, GOOD) == []


@pytest.mark.parametrize(("old", "new", "line", "words"), WRONG)
def test_a_fault_is_told_with_file_line_and_key(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    assert GOOD.count(old) == 1, old
    (told,) = faults_of(tmp_path, GOOD.replace(old, new))
    assert f"tried.yaml:{line}: " in told
    assert words in told
    assert "\n" not in told


def test_two_parts_do_not_talk_on_one_channel(tmp_path: Path) -> None:
    two = "  vote: {pattern: vote_on}\n  more: {pattern: vote_on}"
    text = GOOD.replace("  vote: {pattern: vote_on}", two).replace("[vote, go]", "[vote, more, go]")
    (told,) = faults_of(tmp_path, text)
    assert "tried.yaml:4: parts.more: talks on vote_on/ballot as vote does" in told
    assert faults_of(tmp_path, text.replace("more: {", "more: {private: true, ")) == []


def test_a_part_does_not_talk_as_one_within_another_does(tmp_path: Path) -> None:
    path = tmp_path / "both.yaml"
    path.write_text(
        "mission: Votes, and disperses by another vote\n"
        "parts:\n  vote: {pattern: majority_rule}\n  move: {pattern: discussed_dispersion}\n"
        "parallel: [vote, move]\ndrives: move\n"
    )
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert "both.yaml:4: parts.move: talks on majority_rule/ballot as vote does" in told


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
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert re.search(r"uses.yaml:2: parts.b(.pattern)?: cannot be \w+: [A-Z]\w+: \S", told)
    assert "\n" not in told


def test_the_first_of_several_says_how_many_more_there_are(tmp_path: Path) -> None:
    text = GOOD.replace("{timeout: 20}", "{timeot: 20}").replace("then: stay", "then: go")
    (told,) = faults_of(tmp_path, text)
    assert told.endswith("(and 1 more; swarmctl mission check shows all)")


def test_what_is_no_yaml_is_told_as_such(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=re.escape("tried.yaml:2:")):
        mission_of(tmp_path, "mission: a\nmission: b\n")


@pytest.mark.parametrize("head", ["\ufeffmission:", "'mission':", "mission :"])
def test_what_is_checked_as_a_mission_is_found_as_one(tmp_path: Path, head: str) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(LOW.replace("mission:", head).replace("0.4", "0.6"), encoding="utf-8")
    assert check_mission(path, PLATFORM, tmp_path) == []
    assert "low" in pattern_names(tmp_path)


ALONE = "mission: a\nparts: {b: {pattern: drive}}\npart: b\n"
IN_BRACES = '{"mission": a, parts: {b: {pattern: drive}}, part: b}'


@pytest.mark.parametrize(("text", "encoding"), [(ALONE, "utf-16"), (IN_BRACES, "utf-8")])
def test_what_is_not_found_as_a_mission_is_a_fault(
    tmp_path: Path, text: str, encoding: str
) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(text, encoding=encoding)
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert "low.yaml:1: mission: is not at the start of a line of UTF-8 text" in told
    assert "low" not in pattern_names(tmp_path)


def test_the_other_of_two_of_one_name_is_named(tmp_path: Path) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text(LOW.replace("0.4", "0.6"))
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert re.search(r"mission: has the name of another pattern \(swarmd [0-9.]+\)", told)


LOW = """\
mission: Distances, one of which protection keeps anyway
parts:
  vote: {pattern: majority_rule}
  move: {pattern: dispersion}
map:
  - {from: vote.opinion, to: move.distance, values: [0.4, 1.0, 1.4]}
parallel: [vote, move]
drives: move
"""


def test_a_distance_that_protection_keeps_anyway_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "low.yaml"
    path.write_text(LOW)
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert "low.yaml:6: map[0]: sets move.distance to 0.4 where vote.opinion is 0: " in told
    assert "wanted is more than 0.5 m, the distance that the protection of waffle_pi" in told
    path.write_text(LOW.replace("0.4", "0.6"))
    assert check_mission(path, PLATFORM, tmp_path) == []


def test_a_mission_that_holds_itself_is_a_fault(tmp_path: Path) -> None:
    for name, other in (("one", "two"), ("two", "one")):
        text = f"mission: Round\nparts: {{a: {{pattern: {other}}}}}\npart: a\n"
        (tmp_path / f"{name}.yaml").write_text(text)
    (told,) = check_mission(tmp_path / "one.yaml", PLATFORM, tmp_path)
    assert "is a part of itself" in told


def test_a_mission_may_hold_another(tmp_path: Path) -> None:
    (tmp_path / "inner.yaml").write_text(LOW.replace("0.4", "0.6"))
    text = "mission: Outer\nparts: {a: {pattern: inner}}\npart: a\n"
    (tmp_path / "outer.yaml").write_text(text)
    assert check_mission(tmp_path / "outer.yaml", PLATFORM, tmp_path) == []


def test_a_name_that_a_pattern_has_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "drive.yaml"
    path.write_text(LOW.replace("0.4", "0.6"))
    (told,) = check_mission(path, PLATFORM, tmp_path)
    assert "has the name of another pattern" in told
