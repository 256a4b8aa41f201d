"""A function that answers the questions of an acceptance test in place of a terminal."""

from __future__ import annotations

from typing import Any

import pytest

from swarmd.core.errors import ConfigError
from swarmd.operator.acceptance.dialogue import SOON, Closed, Key, Line
from swarmd.operator.verbs.acceptance import talk
from swarmd.operator.verbs.acceptance.talk import MAX_HASTY, Answers, Question

QUESTION = Question(
    id="B1", head="B1 stop (1/1)", why="A reason.", prepare="", moves="MOVES: 2 m", asks="Free?"
)


class Clock:
    """The clock since boot, which a test winds."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(talk, "boottime", made)
    return made


def answered(person: Answers, text: Any, clock: Clock, seconds: float) -> None:
    """The function takes `seconds` for an answer, while the dialogue looks at it."""

    def answer(question: Question) -> Any:
        for _ in range(10):
            clock.now += seconds / 10.0
            assert person.read(True, 0.0) is None
        return text

    person.close()  # after this question
    person.answer_all(answer)


def test_an_answer_is_given_at_its_return(clock: Clock) -> None:
    """A robot that was stopped since then refuses the run."""
    person = Answers()
    person.ask(QUESTION)
    answered(person, "y", clock, 3.0)
    clock.now += 0.05
    assert person.read(True, 0.0) == Line("y")
    assert person.said_at == pytest.approx(103.0)


@pytest.mark.parametrize("wrong", [True, None, 1, b"y"])
def test_what_is_no_text_is_no_answer_and_ends_the_dialogue(clock: Clock, wrong: Any) -> None:
    person = Answers()
    person.ask(QUESTION)
    with pytest.raises(ConfigError, match="B1"):
        answered(person, wrong, clock, 3.0)
    assert person.read(True, 0.0) == Closed()


def test_an_error_of_the_function_ends_the_dialogue(clock: Clock) -> None:
    person = Answers()
    person.ask(QUESTION)

    def fail(question: Question) -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        person.answer_all(fail)
    assert person.read(False, 0.0) == Closed(), "it stops a robot that moves"


def test_a_caller_that_waits_no_longer_ends_the_dialogue() -> None:
    assert Answers(lambda: True).read(False, 0.0) == Closed()


def test_a_program_that_says_yes_unread_is_refused(clock: Clock) -> None:
    person = Answers()
    for _ in range(MAX_HASTY):
        person.ask(QUESTION)
        answered(person, "y", clock, 0.5 * SOON)
        assert person.read(True, 0.0) == Line("y")  # which the dialogue does not take
    person.ask(QUESTION)
    answered(person, "y", clock, 0.5 * SOON)
    with pytest.raises(ConfigError, match="B1"):
        person.read(True, 0.0)


def test_an_answer_to_a_program_that_stood_still_is_asked_again(clock: Clock) -> None:
    """As a line at a terminal: nobody knows how long it waited."""
    person = Answers()
    person.ask(QUESTION)

    def answer(question: Question) -> str:
        clock.now += 30.0  # as after SIGCONT
        return "y"

    person.close()
    person.answer_all(answer)
    assert person.read(True, 0.0) is None
    again = person._questions.get_nowait()
    assert again is not None
    assert again.id == "B1"
    assert again.told
    answered(person, "y", clock, 3.0)


def test_a_question_is_asked_again_after_an_answer_that_the_dialogue_does_not_know(
    clock: Clock,
) -> None:
    person = Answers()
    person.ask(QUESTION)
    answered(person, "sure", clock, 3.0)
    assert person.read(True, 0.0) == Line("sure")
    person.tell("y, n, q")
    assert person.read(True, 0.0) is None
    again = person._questions.get_nowait()
    assert again is not None
    assert (again.id, again.told) == ("B1", ("y, n, q",))


def test_an_answer_to_a_question_that_was_withdrawn_is_dropped(clock: Clock) -> None:
    person = Answers()
    person.ask(QUESTION)
    answered(person, "y", clock, 3.0)
    assert person.read(False, 0.0) is None
    assert person.read(True, 0.0) is None


def test_an_answer_to_a_question_for_a_key_is_a_key(clock: Clock) -> None:
    """Steps B6 to B9 wait for it; without a key they fail."""
    person = Answers()
    person.ask_for_key(QUESTION)
    person.close()
    person.answer_all(lambda question: "")
    assert person.read(False, 0.0) == Key()


def test_a_late_answer_to_a_question_for_a_key_is_no_yes_to_the_next_one(clock: Clock) -> None:
    person = Answers()
    person.ask_for_key(QUESTION)

    asked: list[Question] = []

    def answer(question: Question) -> str:
        asked.append(question)
        if len(asked) > 1:
            return "n"
        person.ask(QUESTION)  # the dialogue waited no longer
        person.close()
        return "y"

    person.answer_all(answer)
    assert person.read(True, 0.0) is None
    assert person.read(True, 0.0) == Line("n")


def test_a_question_has_what_was_said_since_the_one_before(clock: Clock) -> None:
    person = Answers()
    person.tell("A1 PASS")
    person.ask(QUESTION)
    question = person._questions.get_nowait()
    assert question is not None
    assert question.text.splitlines() == [
        "A1 PASS",
        "B1 stop (1/1)",
        "A reason.",
        "MOVES: 2 m",
        "Free?",
    ]
    assert person.told == ()
