"""The state machine of one robot; TRANSITIONS is the whole of it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from swarmd.core.messages import Reason, State


class Event(StrEnum):
    """What can change a robot's state."""

    RUN = "run"  # a pattern has been loaded and will be stepped
    FINISH = "finish"  # the pattern is done, or its time is over
    STOP = "stop"  # an operator, or the daemon leaving
    HOLD_LASTED = "hold_lasted"
    LOAD_FAILED = "load_failed"  # the running pattern was to be replaced or reloaded, in vain
    STALL = "stall"  # the guardian's own loop was late
    ESTOP = "estop"
    FAULT = "fault"
    RESET = "reset"  # nothing is latched any more


_I, _R, _S, _E, _F = State.IDLE, State.RUNNING, State.STOPPED, State.ESTOPPED, State.FAULTED

# Every state times every event. Only RUN leads to running, and never from estopped or faulted.
TRANSITIONS: Mapping[Event, Mapping[State, State]] = MappingProxyType(
    {
        Event.RUN: {_I: _R, _R: _R, _S: _R, _E: _E, _F: _F},
        Event.FINISH: {_I: _I, _R: _I, _S: _S, _E: _E, _F: _F},
        Event.STOP: {_I: _S, _R: _S, _S: _S, _E: _E, _F: _F},
        Event.HOLD_LASTED: {_I: _I, _R: _S, _S: _S, _E: _E, _F: _F},
        Event.LOAD_FAILED: {_I: _I, _R: _S, _S: _S, _E: _E, _F: _F},
        Event.STALL: {_I: _S, _R: _S, _S: _S, _E: _E, _F: _F},
        Event.ESTOP: {_I: _E, _R: _E, _S: _E, _E: _E, _F: _E},
        Event.FAULT: {_I: _F, _R: _F, _S: _F, _E: _E, _F: _F},
        Event.RESET: {_I: _I, _R: _R, _S: _I, _E: _I, _F: _I},
    }
)


class StateMachine:
    """State, the one reason for it, one line of detail, and since when."""

    def __init__(self, now: float) -> None:
        self.state = State.IDLE
        self.reason: Reason | None = Reason.NEVER_ASKED
        self.detail = ""
        self.since = now

    def apply(self, event: Event, reason: Reason | None, detail: str, now: float) -> None:
        """Carry out an event; one that changes nothing keeps the older reason.

        Stop, stall and estop renew their reason where the state allows them at all.
        """
        target = TRANSITIONS[event][self.state]
        renews = target is self.state and event in _RENEWS.get(target, ())
        if target is self.state and not renews:
            return
        if target is not self.state:
            self.since = now
        self.state, self.reason, self.detail = target, reason, detail


_RENEWS: Mapping[State, tuple[Event, ...]] = MappingProxyType(
    {
        _R: (Event.RUN,),
        _S: (Event.STOP, Event.STALL),
        _E: (Event.ESTOP,),
        _F: (Event.FAULT,),
    }
)
