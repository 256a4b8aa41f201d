"""The texts of an acceptance test, for the terminal and for programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from swarmd.operator.acceptance.step import Motion, Step
    from swarmd.operator.acceptance.verdict import Verdict

_DOING = {"measuring": "measures", "moving": "MOVES", "resting": "waits for rest"}


def head(step: Step, place: str, seconds_left: float) -> str:
    """The heading of a step. `place`: such as `7/31`. `seconds_left`: of the test, about."""
    return f"{step.id} {step.name} ({place}, {round(seconds_left / 60.0)} min left)"


def moves(motion: Motion | None, stop: str) -> str:
    """What moves, at most, and what stops it; empty if nothing moves."""
    return "" if motion is None else f"MOVES: {motion.text}; {stop} stops it."


def question(step: Step) -> str:
    """The question of a step; only `y` is a yes."""
    return f"{step.question or 'Ready?'} [y/N]"


def progress(phase: str, doing: str, stop: str) -> str:
    """What the test does now. `doing`: what the robot says that it does; `stop`: what ends it."""
    said = f": {doing}" if doing else ""
    return f"{_DOING.get(phase, 'judges')}{said}; {stop} ends it"


def verdict_line(step: Step, verdict: Verdict) -> str:
    """A step with its verdict."""
    bound = f" (bound {verdict.bound})" if verdict.bound else ""
    figure = f" {verdict.figure}{bound}:" if verdict.figure else ""
    return f"{step.id} {verdict.result.upper()}{figure} {verdict.reason}"


def outdated(step: str) -> str:
    """Why a step does not begin: the pass of another step is too old."""
    return f"the pass of {step} is not of the last day: the same command asks it again"
