"""The verdict of a step of an acceptance test."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class Result(StrEnum):
    """The result of a step; `not shown`: the step was not done, or could not measure."""

    PASS = "pass"
    FAIL = "fail"
    NOT_SHOWN = "not shown"


class Verdict(Struct, frozen=True):
    """The verdict of a step.

    - `reason`: what the figure means; of a failure the likely cause, and what to do.
    - `figure`, `bound`: the measured value and what it may be, with units; empty without a figure.
    - `values`: what later steps read, and figures for programs.
    """

    result: Result
    reason: str
    figure: str = ""
    bound: str = ""
    values: dict[str, float | str] = {}


def passed(reason: str, figure: str = "", bound: str = "", **values: float | str) -> Verdict:
    """A pass."""
    return Verdict(Result.PASS, reason, figure, bound, values)


def failed(reason: str, figure: str = "", bound: str = "", **values: float | str) -> Verdict:
    """A failure; `reason` names the likely cause."""
    return Verdict(Result.FAIL, reason, figure, bound, values)


def not_shown(reason: str) -> Verdict:
    """Neither pass nor failure, for this reason."""
    return Verdict(Result.NOT_SHOWN, reason)
