"""Whether the answers of `swarmctl` are true over a radio with a delay and losses, verb by verb.

The robots and the laptop `far` hear each other with the delay and the losses of a cell. The laptop
`near` hears all robots at once and without loss: what it sees after an answer is what was true,
and so is what the bodies were commanded meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from tests.support.field import Field
from tests.support.field_swarm import Answer, FieldSwarm
from tests.support.processes import wait_until

ROBOTS = tuple(f"r{number:02d}" for number in range(1, 7))
FAR, NEAR = "far", "near"
TRUE = "true"
VERBS: dict[str, tuple[str, ...]] = {
    "members": ("members",),
    "run": ("run", "drive", "--all"),
    "stop": ("stop",),
    "estop": ("estop",),
    "reset": ("reset", "--all", "--yes"),
}
STANDING = ("idle", "stopped", "estopped", "faulted")
# The states that an applied request leaves, as the near laptop sees them.
_LEFT_BY = {"run": ("running",), "stop": STANDING, "estop": ("estopped",), "reset": ("idle",)}


@dataclass(frozen=True, slots=True)
class Row:
    """One verb in one cell. `rtt` and `seconds` in s; `verdict` is `true`, or what is wrong.

    `counted`: the robots that the answer says have applied it (`members`: that have answered);
    `named`: the robots that it says have not. `states`: the near laptop's truth afterwards.
    """

    rtt: float
    loss: float
    verb: str
    code: int
    counted: tuple[str, ...]
    named: tuple[str, ...]
    states: dict[str, str]
    seconds: float
    verdict: str
    text: str

    @property
    def cells(self) -> tuple[str, ...]:
        """The texts of the columns of `HEAD`."""
        counts = f"{len(self.counted)} + {len(self.named)} of {len(ROBOTS)}"
        return (
            *(f"{1000 * self.rtt:.0f}", f"{100 * self.loss:.0f}", self.verb, str(self.code)),
            *(counts, f"{self.seconds:.1f}", self.verdict),
        )


HEAD = ("RTT ms", "loss %", "verb", "exit code", "counted + named", "s", "true")


def field() -> Field:
    """Six robots and two laptops."""
    return Field((*ROBOTS, FAR, NEAR))


def rows(swarm: FieldSwarm, rtt: float, loss: float) -> Iterator[Row]:
    """Every verb in one cell, by the far laptop. The daemons run; they are idle afterwards."""
    swarm.field.clear()
    prepare(swarm, "reset", "idle")
    radio = (*ROBOTS, FAR)
    for verb, words in VERBS.items():
        if verb in ("stop", "estop"):
            prepare(swarm, "run", "running")
        elif verb == "reset":
            prepare(swarm, "estop", "estopped")
        swarm.field.set_between(radio, radio, delay=rtt / 2, loss=loss)
        swarm.moved()
        answer = swarm.ctl(FAR, *words, "-o", "json")
        yield judge(swarm, rtt, loss, verb, answer)
    swarm.field.clear()
    prepare(swarm, "reset", "idle")


def prepare(swarm: FieldSwarm, verb: str, state: str) -> None:
    """Bring all robots into a state from the near laptop."""

    def try_it() -> bool:
        if set(swarm.states(NEAR).values()) == {state} and len(swarm.states(NEAR)) == len(ROBOTS):
            return True
        swarm.ctl(NEAR, *VERBS[verb])
        return False

    wait_until(try_it, f"all robots {state} by the near laptop")


def judge(swarm: FieldSwarm, rtt: float, loss: float, verb: str, answer: Answer) -> Row:
    """The row of an answer: what the far laptop was told beside what the near one sees."""
    began_moving = swarm.moved()
    states = swarm.states(NEAR)
    if len(states) < len(ROBOTS):
        states = swarm.states(NEAR)
    moved = swarm.moved()
    read = _members if verb == "members" else _outcome
    said, counted, named = read(answer.json)
    wrong = []
    if verb == "members":
        wrong += [f"{r} {said[r]}, is {states[r]}" for r in said if said[r] != states.get(r)]
    else:
        for robot in counted:
            is_right = states.get(robot) in _LEFT_BY[verb]
            if verb == "run":
                is_right |= robot in began_moving | moved
            elif verb in ("stop", "estop"):
                is_right &= robot not in moved
            if not is_right:
                has_moved = ", moves" if robot in moved else ""
                wrong.append(f"{robot} counted, is {states.get(robot, 'unseen')}{has_moved}")
    verdict = f"untrue: {'; '.join(wrong)}" if wrong else TRUE
    unnamed = [r for r in ROBOTS if r not in counted and r not in named]
    if unnamed and not wrong:
        claim = "untrue: exit code 0, and" if answer.code == 0 else "not named:"
        verdict = f"{claim} {', '.join(unnamed)}"
    elif not wrong and answer.code == 0 and named:
        verdict = f"untrue: exit code 0 without {', '.join(named)}"
    text = " / ".join((answer.out if answer.json is None else "", answer.err)).strip(" /\n")
    return Row(
        rtt, loss, verb, answer.code, tuple(sorted(counted)), tuple(sorted(named)), states,
        answer.seconds, verdict, text,
    )  # fmt: skip


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


Report = Callable[[Row], None]


def matrix(
    swarm: FieldSwarm, rtts: tuple[float, ...], losses: tuple[float, ...], report: Report
) -> list[Row]:
    """All rows of all cells, each reported as it comes."""
    found = []
    for rtt in rtts:
        for loss in losses:
            for row in rows(swarm, rtt, loss):
                report(row)
                found.append(row)
    return found
