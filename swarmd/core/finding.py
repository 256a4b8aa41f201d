"""Findings: what `swarmd --check`, the check of a driver and `swarmctl doctor` report."""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class Level(StrEnum):
    """How much a finding matters; `unknown`: it could not be measured."""

    OK = "ok"
    UNKNOWN = "unknown"
    WARNING = "warning"
    FAULT = "fault"


class Finding(Struct, frozen=True):
    """The result of a check: a `text` about a `subject`.

    `is_well` False: the `subject` has a fault, and `remedy` is the next step. `is_minor`: the fault
    is only a warning. `is_measured` False: the check could not measure, so neither health nor a
    fault is known.
    """

    subject: str
    is_well: bool
    text: str
    remedy: str = ""
    is_measured: bool = True
    is_minor: bool = False

    @property
    def level(self) -> Level:
        """The level: unknown if not measured, else ok, warning or fault."""
        if not self.is_well:
            return Level.WARNING if self.is_minor else Level.FAULT
        return Level.OK if self.is_measured else Level.UNKNOWN


def warning(subject: str, text: str, remedy: str, *, is_due: bool = True) -> Finding:
    """A minor finding: not well, with `remedy`, if it `is_due`; else well, without a remedy."""
    return Finding(subject, not is_due, text, remedy if is_due else "", is_minor=is_due)


def unknown(subject: str, text: str) -> Finding:
    """A finding about which nothing could be measured."""
    return Finding(subject, True, text, is_measured=False)
