"""Whether the answers of `swarmctl` are true over a radio with a delay and losses, verb by verb.

The robots and the laptop `far` hear each other with the delay and the losses of a cell. The laptop
`near` hears all robots at once and without loss: what it sees after an answer is what was true,
and so is what the bodies were commanded meanwhile.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

from tests.support.field_swarm import FieldSwarm
from tests.support.processes import wait_until
from tests.support.swarmctl import Finished

FAR, NEAR = "far", "near"
TRUE = "true"
VERBS: dict[str, tuple[str, ...]] = {
    "members": ("members",),
    "run": ("run", "drive", "--all"),
    "stop": ("stop",),
    "estop": ("estop",),
    "reset": ("reset", "--all", "--yes"),
}
LATEST, UNSEEN = 3.0, 20.0  # s
PREPARE_TIMEOUT = 60.0
STANDING = ("idle", "stopped", "estopped", "faulted")
_LEADS_TO = {"idle": ("stop", "reset"), "running": ("reset", "run"), "estopped": ("estop",)}
# The states that an applied request leaves, as the near laptop sees them.
_LEFT_BY = {"stop": STANDING, "estop": ("estopped",), "reset": ("idle",)}


@dataclass(frozen=True, slots=True, repr=False)
class Judged:
    """An answer beside the truth. `verdict` is `true`, or what is wrong.

    `counted`: the robots that the answer says have applied it (`members`: that have answered);
    `named`: the robots that it says have not. `states`: what the near laptop saw afterwards.
    """

    answer: Finished
    counted: set[str]
    named: set[str]
    states: dict[str, str]
    verdict: str

    def __repr__(self) -> str:
        """Exit code, counts, seconds, states and what was printed, without the JSON."""
        counts = f"{len(self.counted)} counted, not {sorted(self.named)}"
        answer = f"exit code {self.answer.code} after {self.answer.seconds:.1f} s: {self.text}"
        return f"{self.verdict}; {counts}; {answer}; truth: {self.states}"

    @property
    def text(self) -> str:
        """The end of what was printed apart from JSON, on one line."""
        out = self.answer.out if self.answer.json is None else ""
        return " / ".join(f"{out}\n{self.answer.err}".split("\n")).strip(" /")[-300:]


@dataclass(frozen=True, slots=True)
class Row:
    """One verb in one cell; `rtt` in s."""

    rtt: float
    loss: float
    verb: str
    judged: Judged

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of the columns of `HEAD`."""
        judged, answer = self.judged, self.judged.answer
        counts = f"{len(judged.counted)} + {len(judged.named)}"
        return (
            *(f"{1000 * self.rtt:.0f}", f"{100 * self.loss:.0f}", self.verb, str(answer.code)),
            *(counts, f"{answer.seconds:.1f}", judged.verdict),
        )


HEAD = ("RTT ms", "loss %", "verb", "exit code", "counted + named", "s", "true")


def cell(swarm: FieldSwarm, rtt: float, loss: float) -> Iterator[Row]:
    """Every verb in one cell, by the far laptop. The daemons run; they are idle afterwards."""
    radio = (*swarm.robots, FAR)
    prepare(swarm, "idle")
    for verb, words in VERBS.items():
        if verb in ("stop", "estop"):
            prepare(swarm, "running")
        elif verb == "reset":
            prepare(swarm, "estopped")
        swarm.field.set_between(radio, radio, delay=rtt / 2, loss=loss)
        swarm.moved()
        answer = swarm.ctl(FAR, *words, "-o", "json")
        yield Row(rtt, loss, verb, judge(swarm, verb, answer))
    prepare(swarm, "idle")


def prepare(swarm: FieldSwarm, state: str) -> None:
    """Clear the radio, and bring all robots into a state by the near laptop."""
    swarm.field.clear()
    tried: list[str] = []

    def try_it() -> bool:
        states = swarm.states(NEAR)
        if states == dict.fromkeys(swarm.robots, state):
            return True
        answers = [swarm.ctl(NEAR, *VERBS[verb]) for verb in _LEADS_TO[state]]
        tried[:] = [f"{states}, then:", *(one.out + one.err for one in answers)]
        return False

    try:
        wait_until(try_it, f"all robots {state} by the near laptop", PREPARE_TIMEOUT)
    except AssertionError as error:
        raise AssertionError("\n".join((str(error), *tried))) from None


def judge(swarm: FieldSwarm, verb: str, answer: Finished, targets: Collection[str] = ()) -> Judged:
    """What an answer says beside what the near laptop sees, and the bodies are told, after it.

    `targets`: the robots that are meant, none for all. Call `swarm.moved()` before the request.
    A robot that moves after its stop was counted makes the answer untrue. A state may reach the
    near laptop `LATEST` s later, and that of a robot that it does not see at all `UNSEEN` s later.
    """
    moved_before = swarm.moved()
    read = _members if verb == "members" else _outcome
    said, counted, named = read(answer.json)
    meant = set(targets or swarm.robots)
    states: dict[str, str] = {}
    moved: set[str] = set()

    def is_true(robot: str) -> bool:
        state = states.get(robot)
        if verb == "members":
            return said[robot] == state
        if verb == "run":
            return state == "running" or robot in moved_before | moved
        return state in _LEFT_BY[verb] and not (verb in ("stop", "estop") and robot in moved)

    began = time.monotonic()
    while True:
        states.update(swarm.states(NEAR))
        moved |= swarm.moved()
        wrong = [f"{r} is {states.get(r)}" for r in sorted(counted) if not is_true(r)]
        patience = LATEST if counted <= states.keys() else UNSEEN
        if not wrong or time.monotonic() > began + patience:
            break
    silent = sorted(meant - counted - named)
    if wrong:
        verdict = f"untrue: {', '.join(wrong)}"
    elif answer.code == 0 and counted != meant:
        verdict = f"untrue: exit code 0 without {', '.join(sorted({*named, *silent}))}"
    else:
        verdict = f"not named: {', '.join(silent)}" if silent else TRUE
    return Judged(answer, counted, named, states, verdict)


def ask(swarm: FieldSwarm, verb: str, *targets: str, options: Collection[str] = ()) -> Judged:
    """The far laptop's answer to a verb; AssertionError unless it is true."""
    words = VERBS[verb]
    if targets:
        words = tuple(word for word in words if word != "--all") + targets
    swarm.moved()
    judged = judge(swarm, verb, swarm.ctl(FAR, *words, *options, "-o", "json"), targets)
    assert judged.verdict == TRUE, judged
    return judged


def check_all_alive(swarm: FieldSwarm) -> None:
    """The far laptop sees every robot by itself, and no daemon has ended."""
    wait_until(lambda: swarm.states(FAR).keys() == set(swarm.robots), "all robots are seen again")
    assert all(swarm.is_alive(robot) for robot in swarm.robots)


def _members(shown: Any) -> tuple[dict[str, str], set[str], set[str]]:
    """The states shown, the robots that answered, and those that are named all the same."""
    members = {one["robot"]: one for one in (shown or {}).get("members", ())}
    said = {
        robot: one["status"]["state"]
        for robot, one in members.items()
        if one["presence"] == "alive" and one["status"] is not None
    }
    return said, set(said), members.keys() - said.keys()


def _outcome(shown: Any) -> tuple[dict[str, str], set[str], set[str]]:
    shown = shown or {}
    named = {name for key in ("refused", "failed", "missing") for name in shown.get(key, ())}
    return {}, set(shown.get("applied", ())), named
