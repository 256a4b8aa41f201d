"""Every short sequence of commands and events on the real robot, and the faults that are found."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.messages import State
from tests.histories.invariants import RULES
from tests.sequences.__main__ import main
from tests.sequences.robot import ALPHABETS, Alphabet
from tests.sequences.robot_faults import FAULTS, Fault
from tests.sequences.robot_rules import JUDGES
from tests.sequences.robot_world import ACTIONS, RobotWorld
from tests.sequences.search import Head, Labels, Search, Tally

# By hand: 8 + 64 + 512; and 24 first actions, of which six are hazards, that leave 19 of them.
SEQUENCES = {"commands": 584, "events": 24 + 18 * 24 + 6 * 19, "hands": 10 + 10 * 10}
TESTED = {
    "commands": {"zero", "stopped", "later_run", "late", "answer", "latch", "cause", "exception"},
    "events": {
        *("zero", "stopped", "later_run", "answer", "latch", "cause", "exception"),
        *("lost_base", "hold", "old_goal"),
    },
    "hands": {
        *("zero", "stopped", "later_run", "late", "answer", "latch", "cause", "exception", "hand"),
    },
}


@pytest.mark.parametrize("name", ALPHABETS)
def test_no_short_sequence_breaks_a_rule(name: str) -> None:
    alphabet = ALPHABETS[name]
    total = Search(RobotWorld, alphabet.choices, alphabet.short).run()
    assert total.violations == []
    assert total.sequences == SEQUENCES[name]
    assert {*total.judged} == TESTED[name]


@pytest.mark.parametrize(
    "labels",
    [
        ("run", "clock_set", "clock_set", "obstacle"),
        ("clock_set", "run", "clock_set", "obstacle"),
        ("clock_set", "clock_set", "obstacle", "run"),
        ("clock_set", "clock_set", "obstacle", "raises"),
        ("clock_set", "clock_set", "obstacle", "peer_goal:new"),
        ("clock_set", "peer_goal:new", "clock_set", "obstacle"),
        ("peer_goal:new", "clock_set", "clock_set", "obstacle"),
        ("run", "clock_set", "clock_set", "obstacle", "unknown"),
    ],
    ids=",".join,
)
def test_a_robot_sees_an_obstacle_0_7_s_after_its_clock_was_set_back(labels: Labels) -> None:
    """Sequences of four that broke the rule `hold` when it allowed 0.2 s; the last one waits."""
    total = Tally()
    assert Search(RobotWorld, lambda before: (), 0).replay(labels, total) == 0, total.violations


@pytest.mark.parametrize(
    ("labels", "state"),
    [
        (("battery", "run", "battery", "battery"), State.RUNNING),
        (("battery", "run", "battery", "run", "battery"), State.STOPPED),
    ],
    ids=["no reading of a full battery", "a reading of a full battery"],
)
def test_a_battery_ends_a_later_run_once_it_was_told_as_full(labels: Labels, state: State) -> None:
    """By docs/configuration.md: unless the battery is charged and then low again."""
    total = Tally()
    assert Search(RobotWorld, lambda before: (), 0).replay(labels, total) == 0, total.violations
    world = RobotWorld()
    for label in labels:
        world.act(label)
    assert world.harness.robot.state is state


@pytest.mark.parametrize(
    "labels",
    [
        ("run", "take", "stop", "resume"),
        ("run", "take", "silent", "silent", "resume", "late_word"),
        ("run", "take", "silent", "take", "silent", "release", "resume"),
        ("take", "stop", "copy", "late_word", "run"),
        ("take", "estop", "reset", "late_word", "copy"),
        ("stop", "run", "old_take", "late_word", "release"),
    ],
    ids=",".join,
)
def test_nothing_late_drives_a_robot_that_was_in_a_hand(labels: Labels) -> None:
    """Longer than those of `make test`."""
    total = Tally()
    assert Search(RobotWorld, lambda before: (), 0).replay(labels, total) == 0, total.violations
    assert "hand" in total.judged


def test_each_rule_is_judged_and_each_judge_has_a_rule() -> None:
    judged = {judge.rule for judge in JUDGES}
    assert judged <= RULES.keys()
    assert {name for name, rule in RULES.items() if not rule.functions} <= judged
    assert judged | {"exception"} == {rule for rules in TESTED.values() for rule in rules}


def test_the_alphabets_have_all_actions() -> None:
    assert {name for one in ALPHABETS.values() for name in one.actions} == ACTIONS.keys()
    assert {name: len(one.actions) for name, one in ALPHABETS.items()} == {
        "commands": 8,
        "events": 18,
        "hands": 10,
    }


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_the_shortest_sequence_that_shows_a_fault_is_found(
    monkeypatch: pytest.MonkeyPatch, fault: Fault
) -> None:
    """Among those of the actions of the sequence and of two others."""
    fault.plant(monkeypatch.setattr)
    wanted = {"run", "clock_set", *(label.partition(":")[0] for label in fault.shortest)}
    alphabet = Alphabet(tuple(name for name in ACTIONS if name in wanted), 0, 0)
    found = Search(RobotWorld, alphabet.choices, len(fault.shortest)).shortest()
    assert found is not None
    assert (found.rule, found.labels) == (fault.rule, fault.shortest)


def test_the_faults_break_all_rules_that_are_judged() -> None:
    assert {fault.rule for fault in FAULTS.values()} == {judge.rule for judge in JUDGES}


def test_a_fault_of_the_code_is_one_of_its_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(world: RobotWorld) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(RobotWorld, "copies", broken)
    tally = Tally()
    assert Search(RobotWorld, lambda labels: (), 0).replay(("run", "copy"), tally) == 2
    assert [(one.rule, one.labels) for one in tally.violations] == [("exception", ("run", "copy"))]


def test_a_replay_tells_what_is_broken_by_its_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["robot", "--replay", "run,stop"]) == 0
    FAULTS["keep_run"].plant(monkeypatch.setattr)
    assert main(["robot", "--replay", "run,stop"]) == 1
    assert "--replay run,stop" in capsys.readouterr().out


def test_an_unknown_subject_is_refused() -> None:
    assert main(["robots"]) == 2


class _Counter:
    """A world that counts its actions, and breaks a rule at the third `a`."""

    def __init__(self) -> None:
        self._seen = ""

    def act(self, label: str) -> None:
        self._seen += label
        assert self._seen.count("a") < 3, "three"

    @property
    def tested(self) -> frozenset[str]:
        return frozenset({"zero"} if "a" in self._seen else ())

    @property
    def outcome(self) -> str:
        return self._seen[-1]


class TestSearch:
    """The search itself, on a world of two letters."""

    search = Search(_Counter, lambda labels: "ab", 4)

    def test_it_visits_each_sequence_once_and_continues_none_that_breaks_a_rule(self) -> None:
        """By hand: 2 + 4 + 8 sequences, then two for each of the 7 without a fault."""
        total = self.search.run()
        assert total.sequences == 2 + 4 + 8 + 2 * 7
        broken = sorted("".join(one.labels) for one in total.violations)
        assert broken == ["aaa", "aaba", "abaa", "baaa"]
        assert total.judged == {"zero": (1 + 3 + 6 + 10)}
        assert sum(total.outcomes.values()) == total.sequences - len(broken)

    def test_it_goes_on_after_the_units_of_its_file(self, tmp_path: Path) -> None:
        file, head = tmp_path / "units", Head("letters", 4, "1")
        whole = self.search.run(file=file, head=head)
        lines = file.read_bytes().splitlines(keepends=True)
        assert len(lines) == 1 + 2 + 4
        file.write_bytes(b"".join(lines[:4]) + lines[4][:20])
        heard: list[int] = []
        again = self.search.run(file=file, head=head, tell=lambda done, _: heard.append(done))
        assert (again.sequences, again.judged) == (whole.sequences, whole.judged)
        assert heard == [66, 83, 100]
        self.search.run(
            file=file, head=Head("letters", 4, "2"), tell=lambda done, _: heard.append(done)
        )
        assert len(heard) == 3 + 6

    def test_draws_find_the_same_faults_each_time(self) -> None:
        drawn = self.search.draws(2, 1)
        # Of 16 words 14 are whole, and `aa` begins the other two, which count three parts each.
        assert 2000 <= drawn.sequences <= 3000
        found = sorted(one.labels for one in drawn.violations)
        assert found == sorted(one.labels for one in self.search.draws(2, 1).violations)
        assert found == sorted(one.labels for one in self.search.run().violations)

    def test_the_shortest_is_the_first_one(self) -> None:
        found = self.search.shortest()
        assert found is not None
        assert found.labels == ("a", "a", "a")
