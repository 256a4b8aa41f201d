"""A load and a trial of a pattern, with the wish behind them; `pattern_run.py` has the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from msgspec import Struct

from swarmd.core.goal import Goal
from swarmd.core.host_messages import Loaded
from swarmd.core.values import Scalar
from swarmd.core.verbs import ReloadRequest, ResumeRequest, RunRequest


class Wish(Struct, frozen=True):
    """When a run was asked for, in s on the own clock, and the name of the issuer.

    For a run of a goal that was found: when the goal was set. A reload with a new run counts from
    its request. A restart after a fault keeps the wish of the run. A stop that was issued before
    does not end the run.
    """

    at: float
    by: str


@dataclass(frozen=True, slots=True, eq=False)
class Loading:
    """A pattern that is being loaded; the running one stays, without steps, until then.

    `until`: conditions of which any ends the run. `request` is answered when it runs.
    `goal`: the goal of the run. `start_at`: s on the own clock before which it does not begin;
    `loaded`: the host's answer, which waits for that time.
    """

    generation: int
    pattern: str
    params: Mapping[str, Scalar | None]
    seconds: float | None
    since: float
    request: RunRequest | ReloadRequest | ResumeRequest | None
    wish: Wish
    until: tuple[str, ...] = ()
    goal: Goal | None = None
    start_at: float | None = None
    loaded: Loaded | None = None

    @property
    def is_restart(self) -> bool:
        """True if it restarts a pattern that failed: no request and no goal asks for it."""
        return self.request is None and self.goal is None


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A trial of new code, under way for a reload request; `wish`: of the run that may follow."""

    generation: int
    since: float
    request: ReloadRequest
    wish: Wish
