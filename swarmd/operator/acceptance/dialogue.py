"""The dialogue of an acceptance test, as a state machine. Pure: the time is an argument.

The shell calls `take(input, now)` for each line, key and sight of the robot, and 10 times a second
with a `Tick`, and carries out the returned actions.

1. A step with a motion, or with something to prepare, begins only after a yes to its own question.
   Only `y` is a yes.
2. A step with a motion begins only if the robot was heard within SILENCE, rests, runs no pattern
   and is not emergency-stopped. A yes within SOON of the question was typed before the question
   could be read, and does not count.
3. During a motion any key stops the robot, and so do: a pose near the end of the announced `reach`
   (`stop_at`), the end of the announced time, another pattern, no word of the robot for SILENCE (or
   `absence`), and the end of the terminal.
4. A stop is repeated each REPEAT s until the robot rests, for at most GIVE_UP. Then the test ends:
   only the switch of the base is left.
5. An emergency stop that the test has not sent ends the test.
6. A step counts as not shown if a step that it needs has not passed.
7. Each verdict is kept at once. A test that goes on begins with the first step that has neither
   passed nor failed; a step that was under way is asked again. A step that was answered by no is
   asked again only if another step needs it.
8. After a step, the steps that read its recording are judged again.

                  yes              event, key, fault          rests          verdict
    ASKED ------------> MOVING ----------------------> RESTING -----> JUDGED -------> ASKED ...
      |    yes, no motion          time over, key                       ^               ENDED
      +---------------> MEASURING --------------------------------------+
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum

from msgspec import Struct
from msgspec.structs import replace

from swarmd.core.values import Pose
from swarmd.operator.acceptance.step import End, Motion, Step
from swarmd.operator.acceptance.verdict import Result, Verdict, failed, not_shown

SILENCE = 1.5
"""Seconds without a word of the robot, which tells its pose 10 times a s: it is not heard."""
SOON = 0.7
"""Seconds after a question in which a yes does not count."""
REPEAT = 0.5
"""Seconds between two stops."""
GIVE_UP = 15.0
"""Seconds after the first stop in which the robot must rest."""
START_TIME = 10.0
"""Seconds in which a run must start: the pattern is loaded first."""
SETTLE = 1.0
"""Seconds in which the pose of a robot at rest changes by less than STILL and STILL_TURN."""
# m, rad
STILL = 0.005
STILL_TURN = 0.02
_LATE = 2.0  # s after a question: an emergency stop that was reset may be told until then

YES = frozenset({"y"})
NO = frozenset({"", "n", "no"})
QUIT = frozenset({"q", "quit"})
DECLINED = "the answer was no"
"""The reason of a step that was answered by no."""


class Phase(StrEnum):
    """Where the dialogue is."""

    ASKED = "asked"
    MEASURING = "measuring"
    MOVING = "moving"
    RESTING = "resting"
    JUDGED = "judged"
    ENDED = "ended"


# Inputs


class Line(Struct, frozen=True):
    """The person typed a line."""

    text: str


class Key(Struct, frozen=True):
    """The person pressed a key while no line was asked for."""


class Closed(Struct, frozen=True):
    """The terminal is closed, or the person pressed Ctrl-C."""


class Sight(Struct, frozen=True):
    """What the robot says of itself.

    `pattern`: what it runs; empty: nothing. `text`: what it does, or why it is held; for the
    person.
    """

    pattern: str
    is_estopped: bool
    pose: Pose
    text: str = ""


class Refused(Struct, frozen=True):
    """The run of the step did not begin."""

    text: str


class Judged(Struct, frozen=True):
    """The evidence of the step was judged."""

    verdict: Verdict


class Tick(Struct, frozen=True):
    """Time has passed."""


Input = Line | Key | Closed | Sight | Refused | Judged | Tick


# Actions


class Ask(Struct, frozen=True):
    """Show the step and its question; lines that were typed before are discarded."""

    step: Step


class Tell(Struct, frozen=True):
    """Show a text."""

    text: str


class Await(Struct, frozen=True):
    """Ask the person for a key, once all is as before this step."""

    step: Step
    text: str


class Begin(Struct, frozen=True):
    """Begin the measurement of the step, and its run if it has a motion."""

    step: Step


class Bring(Struct, frozen=True):
    """Bring about what ends the motion of the step."""

    end: End


class Stop(Struct, frozen=True):
    """Stop the robot."""


class Judge(Struct, frozen=True):
    """Collect the evidence of the step, and judge it."""

    step: Step


class Keep(Struct, frozen=True):
    """Keep the verdict of a step."""

    step: Step
    verdict: Verdict


class Finish(Struct, frozen=True):
    """The dialogue has ended, for this reason. `is_whole`: no step is left."""

    text: str
    is_whole: bool


Action = Ask | Tell | Await | Begin | Bring | Stop | Judge | Keep | Finish


class Dialogue:
    """The dialogue of one test; `verdicts` by the id of the step."""

    def __init__(self, steps: Sequence[Step], verdicts: Mapping[str, Verdict]) -> None:
        """Not begun. `verdicts`: of an earlier part of the test."""
        self.steps = tuple(steps)
        self.verdicts = dict(verdicts)
        self.phase = Phase.ENDED
        self._index = -1
        self._since = 0.0  # s at which the phase began
        self._heard = -math.inf  # s, when the robot was last heard
        self._sight: Sight | None = None
        self._still: Pose | None = None  # the pose from which the robot has hardly moved
        self._still_since = math.inf
        self._place: Pose | None = None  # where the motion began
        self._ran_at: float | None = None  # s at which the run of the step was first seen
        self._repeated_at = -math.inf  # s of the last stop
        self._awaits_person = False  # to restore what the person ended
        self._broken: Verdict | None = None  # the verdict of a step that was broken off
        self._last_word = ""  # why the dialogue ends after this step

    @property
    def step(self) -> Step:
        """The step that is asked, under way or judged."""
        return self.steps[self._index]

    @property
    def place(self) -> str:
        """Where the dialogue is, such as `7/31`."""
        return f"{self._index + 1}/{len(self.steps)}"

    @property
    def seconds_left(self) -> float:
        """About how many s the steps from the present one on take."""
        return sum(step.duration for step in self.steps[max(self._index, 0) :])

    def begin(self, now: float) -> tuple[Action, ...]:
        """Ask for the first step that is left."""
        return tuple(self._ask_next(0, now))

    def take(self, input: Input, now: float) -> tuple[Action, ...]:
        """Take an input; returns what the shell has to do, in order."""
        if self.phase is Phase.ENDED:
            return ()
        if isinstance(input, Sight):
            self._see(input, now)
        if isinstance(input, Closed):
            return tuple(self._close(now))
        match self.phase:
            case Phase.ASKED:
                return tuple(self._while_asked(input, now))
            case Phase.MEASURING:
                return tuple(self._while_measuring(input, now))
            case Phase.MOVING:
                return tuple(self._while_moving(input, now))
            case Phase.RESTING:
                return tuple(self._while_resting(input, now))
        return tuple(self._while_judged(input, now))

    # The robot

    def _see(self, sight: Sight, now: float) -> None:
        self._sight = sight
        self._heard = now
        if self._still is None or not _is_near(sight.pose, self._still, STILL, STILL_TURN):
            self._still = sight.pose
            self._still_since = now

    def _is_heard(self, now: float) -> bool:
        return now - self._heard <= SILENCE

    def _is_at_rest(self, now: float) -> bool:
        """True if the robot was heard, runs nothing, and has not moved for SETTLE."""
        sight = self._sight
        if sight is None or sight.pattern or not self._is_heard(now):
            return False
        # By what was heard: a robot that falls silent is not seen to rest.
        return self._heard - self._still_since >= SETTLE

    def _hindrance(self, now: float) -> str:
        """Why the motion of the step must not begin; empty if it may."""
        if self._sight is None or not self._is_heard(now):
            return "the robot is not heard"
        if self._sight.is_estopped:
            return "the robot is emergency-stopped"
        if self._sight.pattern:
            return f"the robot runs {self._sight.pattern}"
        return "" if self._is_at_rest(now) else "the robot moves, or was not watched for a second"

    # Phases

    def _ask_next(self, first: int, now: float) -> list[Action]:
        """Ask for the first step from `first` on that is left and possible."""
        actions: list[Action] = []
        for index in range(first, len(self.steps)):
            step = self.steps[index]
            known = self.verdicts.get(step.id)
            if known is not None and not self._is_open(step, known):
                continue
            if lacking := [name for name in step.needs if not self._has_passed(name)]:
                why = f"it needs {', '.join(lacking)} to pass: see --only {lacking[0]}"
                actions += self._keep(step, not_shown(why))
                continue
            self._index = index
            if not step.is_asked:
                self._enter(Phase.MEASURING, now)
                return [*actions, Begin(step)]
            self._enter(Phase.ASKED, now)
            return [*actions, Ask(step)]
        return [*actions, *self._finish("all steps of this call were asked", is_whole=True)]

    def _is_open(self, step: Step, verdict: Verdict) -> bool:
        """True if a step with this verdict is to be asked again."""
        if verdict.result is not Result.NOT_SHOWN:
            return False
        return verdict.reason != DECLINED or any(step.id in one.needs for one in self.steps)

    def _has_passed(self, name: str) -> bool:
        verdict = self.verdicts.get(name)
        return verdict is not None and verdict.result is Result.PASS

    def _while_asked(self, input: Input, now: float) -> list[Action]:
        sight = self._sight
        step = self.step
        is_stopped = sight is not None and sight.is_estopped and not step.is_latched
        if isinstance(input, Sight) and is_stopped and now - self._since > _LATE:
            return self._finish("the robot is emergency-stopped")
        if not isinstance(input, Line):
            return []
        word = input.text.strip().lower()
        if word in QUIT:
            return self._finish("interrupted")
        if word.isdecimal() and 1 <= int(word) <= len(self.steps):
            self._index = int(word) - 1
            self.verdicts.pop(self.step.id, None)
            return self._ask_next(self._index, now)
        if word in NO:
            verdict = not_shown(DECLINED)
            return [*self._keep(step, verdict), *self._ask_next(self._index + 1, now)]
        if word not in YES:
            return [Tell("y, n, q to end, or the number of a step")]
        return self._start(now)

    def _start(self, now: float) -> list[Action]:
        """Begin the step after a yes, or tell why not."""
        step = self.step
        if step.motion is None:
            self._enter(Phase.MEASURING, now)
            return [Begin(step)]
        is_early = now - self._since < SOON
        if why := "the question came just now" if is_early else self._hindrance(now):
            self._enter(Phase.ASKED, now)
            return [Tell(f"not yet: {why}"), Ask(step)]
        assert self._sight is not None
        self._place = self._sight.pose
        self._ran_at = None
        self._enter(Phase.MOVING, now)
        return [Begin(step)]

    def _while_measuring(self, input: Input, now: float) -> list[Action]:
        if isinstance(input, Key):
            return self._judge(now, not_shown("a key ended the measurement"))
        if isinstance(input, Refused):
            return self._judge(now, not_shown(input.text))
        sight = self._sight
        if isinstance(input, Sight) and sight is not None and sight.pattern:
            why = f"the robot began to run {sight.pattern}, by someone else"
            return self._judge(now, not_shown(why))
        return self._judge(now) if now - self._since >= self.step.seconds else []

    def _while_moving(self, input: Input, now: float) -> list[Action]:
        motion = self.step.motion
        assert motion is not None
        if isinstance(input, Key | Line):
            return self._break_off(not_shown("a key stopped the robot"), now)
        if isinstance(input, Refused):
            return self._break_off(not_shown(f"the run did not begin: {input.text}"), now)
        if isinstance(input, Sight):
            if broken := self._breach(input, motion):
                return self._break_off(broken, now)
            if input.pattern == motion.pattern and self._ran_at is None:
                self._ran_at = now
            elif not input.pattern and self._ran_at is not None:
                return self._rest(now)  # the run has ended
        if now - self._heard > max(SILENCE, motion.absence):
            return self._break_off(not_shown("the robot was not heard any more"), now)
        ran_at = self._ran_at
        if ran_at is None:
            is_late = now - self._since > START_TIME
            return self._break_off(not_shown("the run did not begin"), now) if is_late else []
        if motion.end not in (End.RUN, End.PERSON) and now - ran_at >= motion.end_after:
            return [Bring(motion.end), *self._rest(now)]
        if now - ran_at > motion.seconds + SILENCE + motion.absence:
            return self._break_off(failed("the run did not end by itself"), now)
        return []

    def _breach(self, sight: Sight, motion: Motion) -> Verdict | None:
        """The verdict if the robot does what was not announced."""
        assert self._place is not None
        if sight.is_estopped and not self.step.is_latched:
            self._last_word = "an emergency stop ended the test"
            return not_shown("an emergency stop ended the step")
        way = math.hypot(sight.pose.x - self._place.x, sight.pose.y - self._place.y)
        if way > motion.stop_at:
            bound = f"{motion.reach:.2f} m"
            return failed("it moved farther than announced", f"{way:.2f} m", bound)
        if sight.pattern not in ("", motion.pattern):
            self._last_word = f"someone else runs {sight.pattern} on the robot"
            return not_shown(self._last_word)
        return None

    def _rest(self, now: float) -> list[Action]:
        """Wait for the rest of a robot whose motion ends as planned."""
        self._enter(Phase.RESTING, now)
        motion = self.step.motion
        if motion is None or motion.end is not End.PERSON:
            return []
        self._awaits_person = True
        return [Await(self.step, "press Enter once all is as before")]

    def _break_off(self, verdict: Verdict, now: float) -> list[Action]:
        """Stop the robot; the step has this verdict."""
        self._broken = verdict
        self._awaits_person = False
        self._repeated_at = now
        self._enter(Phase.RESTING, now)
        return [Stop()]

    def _while_resting(self, input: Input, now: float) -> list[Action]:
        motion = self.step.motion
        assert motion is not None
        if self._broken is None:
            if isinstance(input, Sight) and (broken := self._breach(input, motion)):
                return self._break_off(broken, now)
            if isinstance(input, Key | Line):
                if not self._awaits_person:
                    return self._break_off(not_shown("a key stopped the robot"), now)
                self._awaits_person = False
        # A base that is late may not have begun to move when the stop comes.
        least = SETTLE if self._broken is not None else max(SETTLE, motion.rest)
        is_over = now - self._since >= least
        if self._is_at_rest(now) and is_over and not self._awaits_person:
            return self._judge(now, self._broken)
        patience = GIVE_UP if self._broken is not None else GIVE_UP + motion.absence
        if now - self._since > patience:
            what = "does not rest" if self._is_heard(now) else "is not heard, and may move"
            self._last_word = f"the robot {what}: use the switch of its base"
            self._broken = self._broken or failed("it did not come to rest")
            return [Stop(), *self._judge(now, self._broken)]
        # A planned end is waited for; the stop of a broken step is repeated.
        if self._broken is not None and now - self._repeated_at >= REPEAT:
            self._repeated_at = now
            return [Stop()]
        return []

    def _judge(self, now: float, broken: Verdict | None = None) -> list[Action]:
        self._broken = broken
        self._enter(Phase.JUDGED, now)
        return [Judge(self.step)]

    def _while_judged(self, input: Input, now: float) -> list[Action]:
        if not isinstance(input, Judged):
            return []
        broken = self._broken
        verdict = input.verdict
        if broken is not None:
            # Both failed: the evidence tells the cause of what broke the step off.
            have_failed = broken.result is verdict.result is Result.FAIL
            reason = f"{broken.reason}: {verdict.reason}" if have_failed else broken.reason
            verdict = replace(verdict if have_failed else broken, reason=reason)
        actions = self._keep(self.step, verdict)
        self._broken = None
        if self._last_word:
            return [*actions, *self._finish(self._last_word)]
        return [*actions, *self._ask_next(self._index + 1, now)]

    def _close(self, now: float) -> list[Action]:
        """Stop a robot that may move; the step is asked again when the test goes on."""
        may_move = self.phase in (Phase.MOVING, Phase.RESTING)
        return [*([Stop()] if may_move else []), *self._finish("interrupted")]

    def _enter(self, phase: Phase, now: float) -> None:
        self.phase = phase
        self._since = now

    def _keep(self, step: Step, verdict: Verdict) -> list[Action]:
        self.verdicts[step.id] = verdict
        for one in self.steps:
            if one.reads(step.id):
                self.verdicts.pop(one.id, None)
        return [Keep(step, verdict)]

    def _finish(self, text: str, *, is_whole: bool = False) -> list[Action]:
        self.phase = Phase.ENDED
        if self._sight is not None and self._sight.is_estopped:
            text += "; it stays emergency-stopped until you reset it (swarmctl reset ROBOT)"
        return [Finish(text, is_whole)]


def _is_near(pose: Pose, other: Pose, distance: float, turn: float) -> bool:
    way = math.hypot(pose.x - other.x, pose.y - other.y)
    return way <= distance and abs(math.remainder(pose.yaw - other.yaw, math.tau)) <= turn
