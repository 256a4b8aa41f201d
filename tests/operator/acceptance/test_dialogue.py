"""The dialogue: what it asks, what it lets move, and what ends a motion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from swarmd.core.values import Pose
from swarmd.operator.acceptance.dialogue import (
    GIVE_UP,
    SETTLE,
    SILENCE,
    SOON,
    Action,
    Ask,
    Await,
    Begin,
    Bring,
    Closed,
    Dialogue,
    Finish,
    Input,
    Judge,
    Judged,
    Keep,
    Key,
    Line,
    Phase,
    Refused,
    Sight,
    Stop,
    Tell,
    Tick,
)
from swarmd.operator.acceptance.step import End, Motion, Step, Work
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown, passed

WELL = passed("as it should be")
MOTION = Motion("drive", {"speed": 0.1}, 4.0, 0.1, 0.0, reach=0.6)


def make_step(id: str, **fields: object) -> Step:
    return replace(Step(id, id, "", lambda evidence: WELL), **fields)  # type: ignore[arg-type]


LOOK = make_step("A1", seconds=2.0)
DRIVE = make_step("B1", motion=MOTION)
STOPPED = make_step("B2", motion=MOTION._replace(end=End.STOP, end_after=1.0), needs=("B1",))


class Talk:
    """A dialogue, and the clock and the actions of a test."""

    def __init__(self, *steps: Step, verdicts: dict[str, Verdict] | None = None) -> None:
        self.now = 100.0
        self.dialogue = Dialogue(steps, verdicts or {})
        self.actions: list[Action] = list(self.dialogue.begin(self.now))

    def take(self, input: Input, after: float = 0.0) -> Sequence[Action]:
        self.now += after
        found = self.dialogue.take(input, self.now)
        self.actions += found
        return found

    def rest(self, seconds: float = 2.0, *, is_estopped: bool = False) -> Sequence[Action]:
        """Sights of a robot at rest for so long; the actions."""
        return self.move(0.0, seconds, "", is_estopped=is_estopped)

    def move(
        self,
        speed: float,
        seconds: float,
        pattern: str = "drive",
        *,
        x: float = 0.0,
        is_estopped: bool = False,
    ) -> Sequence[Action]:
        """Sights of a robot that moves ahead from `x` on; the actions."""
        before = len(self.actions)
        for tenth in range(round(10.0 * seconds)):
            sight = Sight(pattern, is_estopped, Pose(x + 0.1 * tenth * speed, 0.0, 0.0))
            self.take(sight, 0.1)
            self.take(Tick())
        return self.actions[before:]

    def under_way(self) -> Talk:
        """After a yes to the step that is asked, with a robot that drives."""
        self.rest()
        assert self.take(Line("y")) == (Begin(self.dialogue.step),)
        assert not self.move(0.1, 0.5)
        return self


def test_a_look_begins_by_itself_and_a_drive_only_after_a_yes() -> None:
    talk = Talk(LOOK, DRIVE)
    assert talk.actions == [Begin(LOOK)]
    assert talk.rest(3.0) == [Judge(LOOK)]
    assert talk.take(Judged(WELL)) == (Keep(LOOK, WELL), Ask(DRIVE))
    assert not talk.rest(60.0)
    assert talk.take(Line(" Y ")) == (Begin(DRIVE),)


def test_a_drone_is_judged_once_its_landing_is_over_or_at_once_after_a_key() -> None:
    step = make_step("B1", motion=MOTION._replace(end=End.STOP, end_after=1.0, rest=10.0))
    talk = Talk(step).under_way()
    assert talk.move(0.1, 1.0) == [Bring(End.STOP)]
    assert not talk.rest(9.5)
    assert talk.rest(1.0) == [Judge(step)]
    talk = Talk(step).under_way()
    assert talk.take(Key()) == (Stop(),)
    assert Judge(step) in talk.rest(2.0)


@pytest.mark.parametrize("word", ["", "n", "No"])
def test_a_no_is_kept_and_asks_on(word: str) -> None:
    talk = Talk(DRIVE)
    talk.rest()
    kept, finish = talk.take(Line(word))
    assert isinstance(kept, Keep)
    assert kept.verdict.result is Result.NOT_SHOWN
    assert isinstance(finish, Finish)
    assert finish.is_whole


@pytest.mark.parametrize(
    "word", ["x", "yes", "Yes", "yy", "y y", "ja", "0", "99", "-1", "٣ ", "\x1b[A"]
)
def test_another_word_is_no_answer(word: str) -> None:
    talk = Talk(DRIVE)
    talk.rest()
    (told,) = talk.take(Line(word))
    assert isinstance(told, Tell)
    assert talk.dialogue.phase is Phase.ASKED


@pytest.mark.parametrize(
    ("sights", "why"),
    [
        ([], "not heard"),
        ([Sight("drive", False, Pose())] * 30, "drive"),
        ([Sight("", True, Pose())] * 15, "emergency"),
        ([Sight("", False, Pose(0.02 * n)) for n in range(30)], "moves"),
    ],
)
def test_nothing_begins_with_a_robot_that_does_not_rest(sights: list[Sight], why: str) -> None:
    talk = Talk(DRIVE)
    for sight in sights:
        talk.take(sight, 0.1)
    talk.now += 0.0 if sights else 5.0
    told, asked = talk.take(Line("y"))
    assert isinstance(told, Tell)
    assert why in told.text
    assert asked == Ask(DRIVE)


def test_a_yes_that_was_typed_ahead_does_not_count() -> None:
    talk = Talk(LOOK, DRIVE)
    talk.rest(3.0)
    talk.take(Judged(WELL))
    assert Ask(DRIVE) in talk.take(Line("y"), 0.5 * SOON)
    assert talk.dialogue.phase is Phase.ASKED


@pytest.mark.parametrize("input", [Key(), Line("y"), Line(""), Refused("busy")])
def test_a_key_stops_and_the_stop_is_repeated_until_it_rests(input: Input) -> None:
    talk = Talk(DRIVE).under_way()
    assert talk.take(input) == (Stop(),)
    assert talk.move(0.1, 1.3, x=0.05) == [Stop(), Stop()]
    assert talk.move(0.0, SETTLE + 0.3, "", x=0.2)[-1] == Judge(DRIVE)
    kept = talk.take(Judged(WELL))[0]
    assert isinstance(kept, Keep)
    assert kept.verdict.result is Result.NOT_SHOWN


def test_a_key_right_after_the_yes_is_watched_for_a_second() -> None:
    """Found by a random history: a late base began to move when the step was judged already."""
    talk = Talk(DRIVE)
    talk.rest(3.0)
    talk.take(Line("y"))
    assert talk.take(Key(), 0.1) == (Stop(),)
    assert Judge(DRIVE) not in talk.rest(0.8 * SETTLE)
    assert Judge(DRIVE) in talk.rest(0.5)


def test_a_drive_ends_by_itself() -> None:
    talk = Talk(DRIVE).under_way()
    assert not talk.move(0.1, 3.5, x=0.05)
    assert talk.move(0.0, 1.5, "", x=0.4) == [Judge(DRIVE)]
    assert talk.take(Judged(WELL))[0] == Keep(DRIVE, WELL)


def test_a_stop_is_brought_about_at_its_time_and_only_once() -> None:
    talk = Talk(STOPPED, verdicts={"B1": WELL}).under_way()
    found = [*talk.move(0.1, 1.0, x=0.05), *talk.move(0.0, 1.5, "", x=0.15)]
    assert found == [Bring(End.STOP), Judge(STOPPED)]


def test_a_robot_beyond_its_bound_is_stopped_and_fails() -> None:
    talk = Talk(DRIVE).under_way()
    found = talk.move(0.3, 2.5, x=0.05)
    assert found[0] == Stop()
    talk.move(0.0, 1.5, "", x=0.8)
    kept = talk.take(Judged(WELL))[0]
    assert isinstance(kept, Keep)
    assert kept.verdict.result is Result.FAIL
    assert kept.verdict.bound == "0.60 m"


def test_what_the_evidence_says_of_a_broken_step_is_told_too() -> None:
    talk = Talk(DRIVE).under_way()
    talk.move(0.3, 2.5, x=0.05)
    talk.move(0.0, 1.5, "", x=0.8)
    kept = talk.take(Judged(failed("it ignores zero", "5 m")))[0]
    assert isinstance(kept, Keep)
    assert "ignores zero" in kept.verdict.reason
    assert "farther" in kept.verdict.reason


def test_a_robot_that_falls_silent_is_stopped() -> None:
    talk = Talk(DRIVE).under_way()
    assert not talk.take(Tick(), 0.9 * SILENCE)
    assert talk.take(Tick(), 0.2 * SILENCE) == (Stop(),)


def test_silence_that_is_part_of_a_step_is_waited_for_until_the_person_is_back() -> None:
    step = make_step("B7", motion=MOTION._replace(end=End.PERSON, absence=60.0))
    talk = Talk(step).under_way()
    assert not talk.take(Tick(), 40.0)
    assert [type(action) for action in talk.rest(3.0)] == [Await]
    assert talk.take(Key()) == (Judge(step),)


@pytest.mark.parametrize("seconds", [0.3, 0.0])
def test_an_emergency_stop_of_another_ends_the_test(seconds: float) -> None:
    talk = Talk(DRIVE, STOPPED)
    if seconds:
        talk.under_way()
    talk.rest(4.0, is_estopped=True)
    talk.take(Judged(WELL))
    assert isinstance(talk.actions[-1], Finish)
    assert not any(isinstance(action, Ask) for action in talk.actions[1:])


def test_a_run_of_another_ends_the_test() -> None:
    talk = Talk(DRIVE, STOPPED).under_way()
    assert talk.move(0.1, 0.1, "flocking") == [Stop()]
    talk.rest(2.0)
    assert isinstance(talk.take(Judged(WELL))[-1], Finish)


def test_a_base_that_never_rests_ends_the_test() -> None:
    talk = Talk(DRIVE, STOPPED).under_way()
    talk.take(Key())
    found = talk.move(0.01, GIVE_UP + 1.0)
    assert found[-1] == Judge(DRIVE)
    finish = talk.take(Judged(WELL))[-1]
    assert isinstance(finish, Finish)
    assert "does not rest" in finish.text


def test_a_base_that_is_not_heard_any_more_is_not_said_to_move() -> None:
    talk = Talk(DRIVE, STOPPED).under_way()
    assert talk.take(Tick(), SILENCE + 0.1) == (Stop(),)
    assert talk.take(Tick(), GIVE_UP + 0.1) == (Stop(), Judge(DRIVE))
    finish = talk.take(Judged(WELL))[-1]
    assert isinstance(finish, Finish)
    assert "is not heard, and may move" in finish.text


@pytest.mark.parametrize("result", [not_shown("no"), failed("bad")])
def test_what_a_step_needs_must_have_passed(result: Verdict) -> None:
    talk = Talk(STOPPED, verdicts={"B1": result})
    kept = talk.actions[0]
    assert isinstance(kept, Keep)
    assert kept.verdict.result is Result.NOT_SHOWN


def test_a_test_goes_on_with_what_has_no_result() -> None:
    known = {"A1": WELL, "B1": failed("bad")}
    third = make_step("B3", motion=MOTION)
    assert Talk(LOOK, DRIVE, third, verdicts=known).actions == [Ask(third)]
    assert Talk(LOOK, verdicts={"A1": not_shown("a key")}).actions == [Begin(LOOK)]


def test_a_no_is_asked_again_only_if_another_step_needs_it() -> None:
    hand = make_step("A12", prepare="Hold a hand.")
    first = Talk(hand, DRIVE, STOPPED)
    first.rest()
    first.take(Line("n"))
    first.take(Line("n"))
    said_no = {id: first.dialogue.verdicts[id] for id in ("A12", "B1")}
    assert Talk(hand, DRIVE, STOPPED, verdicts=said_no).actions == [Ask(DRIVE)]
    assert Talk(hand, verdicts={"A12": not_shown("a key ended it")}).actions == [Ask(hand)]


def test_a_step_that_is_repeated_is_judged_with_all_that_read_its_recording() -> None:
    drive = make_step("C2", prepare="Put it down.", seconds=1.0)
    figure = make_step("C3", needs=("C2",), work=Work.NOTHING)
    other = make_step("C4", of="C2", work=Work.NOTHING)
    asked = make_step("C5", needs=("C2",), prepare="Read it.")
    known = dict.fromkeys(("C2", "C3", "C4", "C5"), WELL)
    talk = Talk(drive, figure, other, asked, verdicts=known)
    assert isinstance(talk.actions[-1], Finish)
    del known["C2"]
    talk = Talk(drive, figure, other, asked, verdicts=known)
    talk.take(Line("y"), 1.0)
    assert talk.rest(1.5) == [Judge(drive)]
    assert talk.take(Judged(WELL))[-1] == Begin(figure)
    assert talk.take(Tick()) == (Judge(figure),)
    assert talk.take(Judged(WELL))[-1] == Begin(other)
    talk.take(Tick())
    assert isinstance(talk.take(Judged(WELL))[-1], Finish)


def test_a_number_asks_for_its_step_again() -> None:
    talk = Talk(LOOK, DRIVE, verdicts={"A1": WELL})
    assert talk.take(Line("1"), 1.0) == (Begin(LOOK),)


@pytest.mark.parametrize("word", ["q", "Quit"])
def test_q_ends_and_keeps_the_step_open(word: str) -> None:
    talk = Talk(DRIVE)
    assert talk.take(Line(word), 1.0) == (Finish("interrupted", is_whole=False),)
    assert "B1" not in talk.dialogue.verdicts


def test_a_closed_terminal_stops_and_ends() -> None:
    talk = Talk(DRIVE).under_way()
    stop, finish = talk.take(Closed())
    assert stop == Stop()
    assert isinstance(finish, Finish)
    assert not finish.is_whole
    assert Talk(DRIVE).take(Closed()) == (Finish("interrupted", is_whole=False),)


def test_the_time_left_falls() -> None:
    talk = Talk(LOOK, DRIVE)
    left = talk.dialogue.seconds_left
    talk.rest(3.0)
    talk.take(Judged(WELL))
    assert 0.0 < talk.dialogue.seconds_left < left
    assert talk.dialogue.place == "2/2"
    assert math.isfinite(left)


def test_a_robot_that_falls_silent_is_not_seen_to_rest() -> None:
    """Found by a random history: with no pose for a second it had seemed to rest."""
    talk = Talk(DRIVE).under_way()
    talk.take(Key())
    talk.take(Sight("", False, Pose(0.3)), 0.1)
    assert not [one for one in talk.take(Tick(), 1.2) if isinstance(one, Judge)]


def test_the_end_says_that_the_robot_stays_emergency_stopped() -> None:
    talk = Talk(make_step("B3", prepare="Restart it.", is_latched=True))
    talk.rest(4.0, is_estopped=True)
    (finish,) = talk.take(Line("q"))
    assert isinstance(finish, Finish)
    # Not by B4: a B4 that has passed is not asked again when the latch of B2 stands.
    assert "swarmctl reset ROBOT" in finish.text
    assert "B4" not in finish.text
    talk = Talk(DRIVE)
    talk.rest()
    (finish,) = talk.take(Line("q"))
    assert finish == Finish("interrupted", is_whole=False)
