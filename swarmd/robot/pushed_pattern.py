"""The versions of one pushed pattern on one robot, and the rules for the current version. Pure.

::

    push that passed its trial               -> provisional: current, but on trial
    60 s of runs without a fault             -> held: current, and kept after a fault
    fault of a provisional version           -> returned: the version before is current again
    3 ends of the daemon during runs of a    -> returned: the version before is current again
      provisional version
    removal                                  -> no version of the pattern is left

The end of the daemon during a run counts like a fault, since the code may have caused that end. A
fault of a held version changes no version: the robot restarts the pattern, and quarantines the
pattern after several faults.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from msgspec import Meta, Struct
from msgspec.structs import replace

from swarmd.core.bounds import Line, Seconds
from swarmd.core.pattern_manifest import Entry, Signed

HOLD_TIME = 60.0
"""Seconds of runs without a fault after which a version is held."""
MAX_ENDS = 3
"""Ends of the daemon in runs of a provisional version after which the robot returns from it."""


class Standing(StrEnum):
    """Whether the newest push of a pattern is on trial, kept, or was given up on a robot."""

    PROVISIONAL = "provisional"
    HELD = "held"
    RETURNED = "returned"


class Version(Struct, frozen=True, kw_only=True):
    """A version of a pushed pattern on this robot: manifest, source, and a record of its runs."""

    signed: Signed
    digest: Annotated[bytes, Meta(max_length=32)]
    label: Line
    source: Line  # the operator or robot that sent the version
    ran: Seconds = 0.0  # s of runs without a fault
    ends: Annotated[int, Meta(ge=0, le=1000)] = 0  # of the daemon during a run of this version
    is_held: bool = False

    @classmethod
    def of(cls, entry: Entry, source: str) -> Version:
        """The provisional version of `entry`, handed over by `source`."""
        manifest = entry.manifest
        return cls(signed=entry.signed, digest=manifest.digest, label=manifest.label, source=source)


class PushedPattern(Struct, frozen=True, kw_only=True):
    """The versions of one pattern that operators pushed to one robot."""

    current: Version | None = None
    before: Version | None = None  # the robot returns to it if the provisional `current` fails
    failed: Version | None = None  # failed on this robot, in a run or in its trial
    fault: Line = ""  # why `failed` failed
    is_running: bool = False  # a run of the current version has begun and not ended
    is_damaged: bool = False
    """The files of the current version differ from the pushed files: the robot runs no version
    until it accepts a new version."""

    @property
    def is_provisional(self) -> bool:
        """True while the current version has not been held."""
        return self.current is not None and not self.current.is_held

    @property
    def standing(self) -> Standing:
        """RETURNED if the newest push failed here, else whether the current version is held."""
        if self.failed is not None:
            return Standing.RETURNED
        return Standing.PROVISIONAL if self.is_provisional else Standing.HELD

    def lacks(self, entry: Entry) -> bool:
        """True if the version of this manifest is neither current nor failed on this robot."""
        known = (self.current, self.failed)
        return not any(v is not None and v.signed.content == entry.content for v in known)

    def accept(self, version: Version) -> PushedPattern:
        """The state of the pattern after `version` has passed its trial.

        If the code of `version` equals the current code, only the manifest is replaced.
        """
        current = self.current
        if current is not None and current.digest == version.digest:
            kept = replace(current, signed=version.signed, label=version.label)
            return replace(self, current=kept, failed=None, fault="")
        # A held version stays `before` over several provisional versions, as known good code.
        is_known = current is not None and (current.is_held or self.before is None)
        before = current if is_known else self.before
        return PushedPattern(current=version, before=before)

    def refuse(self, version: Version, fault: str) -> PushedPattern:
        """The state after a failed trial of `version`: the same code is not tried again."""
        return replace(self, failed=version, fault=fault[:300])

    def ran(self, seconds: float) -> PushedPattern:
        """The state after the current version ran for `seconds` more."""
        if self.current is None or self.current.is_held:
            return self
        total = self.current.ran + max(seconds, 0.0)
        is_held = total >= HOLD_TIME
        current = replace(self.current, ran=min(total, HOLD_TIME), is_held=is_held)
        return replace(self, current=current, before=None if is_held else self.before)

    def begin(self) -> PushedPattern:
        """The state after the begin of a run of the current version."""
        return replace(self, is_running=True)

    def end(self) -> PushedPattern:
        """The state after the end of the run."""
        return replace(self, is_running=False)

    def failed_with(self, fault: str) -> PushedPattern:
        """The state after a fault of the current version; a provisional version is given up."""
        if not self.is_provisional:
            return self
        return PushedPattern(current=self.before, failed=self.current, fault=fault[:300])

    def restarted(self) -> PushedPattern:
        """The state at a start of the daemon; an unfinished run counts against the version."""
        if not self.is_running or self.current is None:
            return self
        current = replace(self.current, ends=min(self.current.ends + 1, 1000))
        state = replace(self, current=current, is_running=False)
        if current.ends < MAX_ENDS:
            return state
        return state.failed_with(f"the daemon ended {current.ends} times while it ran")
