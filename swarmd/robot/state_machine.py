"""The state of one robot, and the transitions between states. Pure.

A kernel (see `core/kernels.py`), compiled into one unit with ticker.py, which reads the state at
each tick. state.py fires the triggers, and says when.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from swarmd.core import cython_shadow as cython
from swarmd.core.messages import Reason, State


class Trigger(StrEnum):
    """The causes of a state change."""

    RUN = "run"
    FINISH = "finish"
    STOP = "stop"
    HOLD_LASTED = "hold_lasted"
    LOAD_FAILED = "load_failed"
    STALL = "stall"
    HAZARD = "hazard"
    NETWORK = "network"
    ESTOP = "estop"
    FAULT = "fault"
    RESET = "reset"


_I = State.IDLE
_R = State.RUNNING
_S = State.STOPPED
_E = State.ESTOPPED
_F = State.FAULTED

# Every state times every trigger.
TRANSITIONS: Mapping[Trigger, Mapping[State, State]] = MappingProxyType(
    {
        Trigger.RUN: {_I: _R, _R: _R, _S: _R, _E: _E, _F: _F},
        Trigger.FINISH: {_I: _I, _R: _I, _S: _S, _E: _E, _F: _F},
        Trigger.STOP: {_I: _S, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.HOLD_LASTED: {_I: _I, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.LOAD_FAILED: {_I: _I, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.STALL: {_I: _S, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.HAZARD: {_I: _S, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.NETWORK: {_I: _I, _R: _S, _S: _S, _E: _E, _F: _F},
        Trigger.ESTOP: {_I: _E, _R: _E, _S: _E, _E: _E, _F: _E},
        Trigger.FAULT: {_I: _F, _R: _F, _S: _F, _E: _E, _F: _F},
        Trigger.RESET: {_I: _I, _R: _R, _S: _I, _E: _I, _F: _I},
    }
)
_RENEWS: Mapping[State, tuple[Trigger, ...]] = MappingProxyType(
    {
        _R: (Trigger.RUN,),
        _S: (Trigger.STOP, Trigger.STALL, Trigger.HAZARD),
        _E: (Trigger.ESTOP,),
        _F: (Trigger.FAULT,),
    }
)


@cython.cclass
class StateMachine:
    """The state, its one reason, one line of detail, and the time of the last change of state."""

    state: State
    reason: Reason | None
    detail: str
    since: float  # s on the robot's clock

    def __init__(self, now: float) -> None:
        self.state = State.IDLE
        self.reason = Reason.NEVER_ASKED
        self.detail = ""
        self.since = now

    def apply(self, trigger: Trigger, reason: Reason | None, detail: str, now: float) -> None:
        """Change state, reason and detail by a trigger.

        If the trigger leads to the present state, the present reason stays, unless `_RENEWS` lists
        the trigger for this state, such as STOP for a stopped robot.
        """
        target = TRANSITIONS[trigger][self.state]
        renews = target is self.state and trigger in _RENEWS.get(target, ())
        if target is self.state and not renews:
            return
        if target is not self.state:
            self.since = now
        self.state = target
        self.reason = reason
        self.detail = detail
