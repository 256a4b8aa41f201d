"""The state machine of one robot: states, triggers, and the full transition table.

`StateMachine.apply` is the only code that changes the state. This table lists every caller:

| trigger     | fired by (module lifecycle unless named)              | reason               |
|-------------|--------------------------------------------------------|----------------------|
| RUN         | the pattern host reports Loaded                        | none: it runs        |
| FINISH      | a step returns `done`; the seconds of the run are over | finished             |
| STOP        | a stop request; the reload of the running pattern      | operator, reloaded   |
|             | (requests); the daemon leaves (robot)                  | leaving              |
|             | a greater goal (goal_handler); a load that peers run   | superseded           |
|             | is refused; the run lease ends                         | lease_ended          |
|             | a roster without this robot                            | roster_changed       |
| HOLD_LASTED | a hold has lasted for MAX_HOLD_TIME                    | the hold             |
| LOAD_FAILED | a load fails or times out; a restart is refused        | load_failed          |
| STALL       | the daemon's loop was late by STALL_TIMEOUT, unless    | loop_stalled         |
|             | the robot is idle and loads and tries nothing          |                      |
| HAZARD      | a wheel drop, or the base is lifted, while the robot   | hazard               |
|             | runs or loads                                          |                      |
| NETWORK     | the network that the daemon speaks on has changed      | network_changed      |
|             | the daemon takes a roster                              | roster_changed       |
| ESTOP       | an estop request; the latch of a peer; a latch on disk | estop                |
| FAULT       | too many failures of a pattern; a second robot has     | pattern_quarantined  |
|             | the same id                                            | duplicate_id         |
| RESET       | a reset request after which no latch is held           | reset                |

Only the trigger RUN leads to `running`, and never from `estopped` or `faulted`. The requests `run`
and `resume`, a reload with a new run, a goal with `on_join: run`, and the restart of a failed
pattern fire it.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

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


_I, _R, _S, _E, _F = State.IDLE, State.RUNNING, State.STOPPED, State.ESTOPPED, State.FAULTED

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


class StateMachine:
    """The state, its one reason, one line of detail, and the time of the last change of state."""

    def __init__(self, now: float) -> None:
        self.state = State.IDLE
        self.reason: Reason | None = Reason.NEVER_ASKED
        self.detail = ""
        self.since = now

    def apply(self, trigger: Trigger, reason: Reason | None, detail: str, now: float) -> None:
        """Carry out a trigger. Without a change of state the older reason stays.

        The triggers of `_RENEWS` replace the reason also without a change of state.
        """
        target = TRANSITIONS[trigger][self.state]
        renews = target is self.state and trigger in _RENEWS.get(target, ())
        if target is self.state and not renews:
            return
        if target is not self.state:
            self.since = now
        self.state, self.reason, self.detail = target, reason, detail


_RENEWS: Mapping[State, tuple[Trigger, ...]] = MappingProxyType(
    {
        _R: (Trigger.RUN,),
        _S: (Trigger.STOP, Trigger.STALL, Trigger.HAZARD),
        _E: (Trigger.ESTOP,),
        _F: (Trigger.FAULT,),
    }
)
