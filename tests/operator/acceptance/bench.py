"""A simulated Burger with at most one fault, on which the dialogue is carried out in virtual time.

The person answers as asked: holds a hand, restarts the daemon, kills it, cuts the link. Lifted
wheels are a free floor: their motion is that of odometry.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np
from msgspec.structs import replace as replace_struct

from swarmd.core.events import (
    DriverInput,
    LeaseInput,
    OdometryInput,
    ReadingsInput,
    RequestInput,
    ScanInput,
    SensorInput,
)
from swarmd.core.goal import Goal
from swarmd.core.messages import Code
from swarmd.core.values import Array, Odometry, Platform, Pose, Scan
from swarmd.core.verbs import EstopRequest, Request, ResetRequest, RunRequest, StopRequest
from swarmd.operator.acceptance.dialogue import (
    Action,
    Ask,
    Await,
    Begin,
    Bring,
    Dialogue,
    Finish,
    Input,
    Judge,
    Judged,
    Keep,
    Key,
    Line,
    Phase,
    Refused,
    Sight,
    Stop,
    Tell,
    Tick,
)
from swarmd.operator.acceptance.evidence import Evidence, Samples, TimedDecision
from swarmd.operator.acceptance.step import End, Step, Work
from swarmd.operator.acceptance.stops import LEASE
from swarmd.operator.acceptance.verdict import Verdict
from swarmd.sim.lockstep.lockstep import Lockstep
from swarmd.sim.lockstep.shell import RobotShell
from swarmd.sim.scenarios.scenariofile import scenario_of
from swarmd.sim.world.faults import fault_of

PERIOD = 0.1  # s between two looks of the operator
ANSWER_TIME = 3.0  # s
HAND = 0.3  # m
HAND_AT = 3.0  # s after the answer
ACT_AT = 2.5  # s of motion until the person kills or cuts
ABSENT = 6.0  # s until it is restored
SEEN_AFTER = 1.5  # s after which the person sees that it is
BASE_TIMEOUT = 0.5  # s, of the base's own commands
LIGHT_NOISE: dict[str, Any] = {"preset": "realistic", "lidar": {"bias": 0.0}}
ROOM: dict[str, Any] = {
    "size": [2.8, 2.3],
    "boxes": [{"name": "crate", "at": [1.2, 0.9], "size": [0.3, 0.3]}],
}
HALL: dict[str, Any] = {"size": [7.0, 3.0]}

ScanFault = Callable[[Scan], Scan | None]
_HANDS = {"A12": 0.0, "A13": 90.0, "A14": 180.0, "A15": -90.0}


class Bench:
    """One robot `r`, its base and its person; `verdicts` has the results."""

    def __init__(
        self,
        platform: Platform,
        steps: Sequence[Step],
        *,
        verdicts: dict[str, Verdict] | None = None,
        arena: dict[str, Any] = ROOM,
        realism: dict[str, Any] = LIGHT_NOISE,
        faults: Sequence[dict[str, Any]] = (),
        scan_fault: ScanFault = lambda scan: scan,
        odometry_burst: float = 0.0,
        has_watchdog: bool = True,
        has_button: bool = True,
        reading: float | None = None,
        charges: Mapping[str, float] | None = None,
    ) -> None:
        self.platform = platform
        self.scan_fault = scan_fault
        self.has_watchdog, self.reading = has_watchdog, reading
        self.charges = charges or {}
        self.has_button, self.is_pressed = has_button, False
        self.odometry_burst = odometry_burst  # s between two deliveries; 0: at once
        scenario = scenario_of(
            {
                "duration": 3000.0,
                "realism": realism,
                "arena": arena,
                "groups": {"all": {"platform": "burger", "robots": ["r"]}},
                "start": {"layout": "row"},
            }
        )
        self.sim = Lockstep(replace(scenario, robots={"r": platform}), 3)
        for fault in faults:
            self.sim.world.change_fault(fault_of(fault, "bench"), [0], is_on=True)
        self.inputs: list[tuple[Any, float]] = []
        self.decisions: list[TimedDecision] = []
        self.kept: dict[str, Samples] = {}
        self.last_odometry: list[Odometry] = []
        self.hand: float | None = None  # deg
        self.cut_until = self.lost_until = -1.0
        self.dead_until: float | None = None
        self.renewed: str | None = None  # the id of the goal whose lease is renewed
        self.count = 0
        self.farthest: dict[str, float] = {}  # m by step, true
        self.place = np.zeros(2)
        self.act_at = math.inf
        self.answer_at = math.inf
        self.reads_on = math.inf
        self.is_over = ""
        self.has_told = False
        self.back_since = 0.0  # s
        self._wrap_world()
        self._wrap_shell()
        self.sim.advance(2.0)
        self.dialogue = Dialogue(steps, verdicts or {})
        self.carry_out(self.dialogue.begin(self.now))

    @property
    def now(self) -> float:
        return float(self.sim.world.time)

    @property
    def verdicts(self) -> dict[str, Verdict]:
        return self.dialogue.verdicts

    @property
    def shell(self) -> RobotShell | None:
        return self.sim.shells[0]

    # The base

    def _wrap_world(self) -> None:
        world = self.sim.world
        measure, obey, send = world.odometry, world.set_commands, world._send

        def odometry(rows: Any = None) -> list[Odometry]:
            readings = measure(rows)
            if self.now < self.lost_until:
                return self.last_odometry  # repeats, of which the robot takes none
            self.last_odometry = readings
            if self.shell is not None:
                burst, at = self.odometry_burst, self.now
                at = burst * math.ceil(at / burst) if burst else at
                self.inputs += [(OdometryInput(one), at) for one in readings]
            return readings

        def set_commands(commands: Array) -> None:
            is_lost = self.now < self.lost_until
            given = np.zeros_like(commands) if is_lost and self.has_watchdog else commands
            if self.is_pressed and self.has_button:
                given = np.zeros_like(commands)
            if is_lost and not self.has_watchdog:
                return
            obey(given)

        world.odometry = odometry  # type: ignore[method-assign, assignment]
        world.set_commands = set_commands  # type: ignore[method-assign, assignment]
        # The hand is before the lidar, and so before its faults.
        world._send = lambda row, scan: send(row, self._with_hand(scan))  # type: ignore[method-assign]

    def _wrap_shell(self) -> None:
        shell = self.shell
        assert shell is not None
        sense = shell.sense

        def seen(input: SensorInput, now: float) -> None:
            if self.now < self.lost_until:
                return
            if isinstance(input, ScanInput):
                scan = self.scan_fault(input.scan)
                if scan is None:
                    return
                input = ScanInput(scan)
                self._note_decision(now)
            self.inputs.append((input, now))
            sense(input, now)

        shell.sense = seen  # type: ignore[method-assign]

    def _note_decision(self, now: float) -> None:
        assert self.shell is not None
        decision = self.shell.robot.decision
        gap = math.nan if decision.min_gap is None else decision.min_gap
        self.decisions.append(TimedDecision(now, decision.safe, gap, decision.speed_share))

    def _with_hand(self, scan: Scan) -> Scan:
        if self.hand is None:
            return scan
        apart = np.abs(np.remainder(np.degrees(scan.bearings) - self.hand + 180.0, 360.0) - 180.0)
        return replace_struct(scan, ranges=np.where(apart < 6.0, HAND, scan.ranges))

    # Time

    def run(self, longest: float = 1500.0) -> Self:
        """Carry the dialogue out to its end."""
        end = self.now + longest
        while not self.is_over and self.now < end:
            self.advance()
        assert self.is_over, (self.dialogue.phase, self.dialogue.step.id)
        return self

    def advance(self) -> None:
        self.sim.advance(PERIOD, self._on_step)
        now, shell = self.now, self.shell
        if self.dead_until is not None and now >= self.dead_until:
            self.dead_until = None
            self.sim.start([0])
            self._wrap_shell()
        if shell is not None and 0.0 < self.lost_until <= now:
            self.lost_until = -1.0
            shell.step(DriverInput(True, "simulated"), now)
        if shell is not None and self.renewed and now >= self.cut_until:
            self.count += 1
            lease = LeaseInput(self.renewed, self.count)
            self.inputs.append((lease, now))
            shell.step(lease, now)
        if shell is not None and now >= self.cut_until:
            robot = shell.robot
            motion = robot.motion(now)
            assert motion is not None
            pattern = str(robot.status(now).pattern) if robot.is_running else ""
            pose = Pose(motion.x, motion.y, motion.yaw)
            self.take(Sight(pattern, bool(robot.latches), pose))
        self.take(Tick())
        if not self.is_over:
            self.person(now)
        self._watch()

    def _on_step(self, now: float) -> None:
        self.sim.has_new_commands = True

    def _watch(self) -> None:
        """Note the true way of the base from the place where the step began."""
        name = self.dialogue.step.id
        way = float(np.hypot(*(self.sim.world.poses()[0, :2] - self.place)))
        if self.dialogue.phase in (Phase.MOVING, Phase.RESTING):
            self.farthest[name] = max(self.farthest.get(name, 0.0), way)

    def take(self, input: Input) -> None:
        self.carry_out(self.dialogue.take(input, self.now))

    def carry_out(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case Ask(step=step):
                    self.prepare(step)
                    self.answer_at = self.now + ANSWER_TIME
                case Begin(step=step):
                    self.begin(step)
                case Bring(end=End.SILENCE):
                    self.renewed = None
                case Bring(end=End.ESTOP):
                    self.request(EstopRequest, scope="robots")
                case Stop() | Bring():
                    self.request(StopRequest)
                case Tell() | Await():
                    self.has_told = True
                case Judge(step=step):
                    self.hand = None
                    self.renewed = None
                    self.take(Judged(step.judge(self.evidence(step))))
                case Keep():
                    pass
                case Finish(text=text):
                    self.is_over = text

    def evidence(self, step: Step) -> Evidence:
        self.kept[step.id] = Samples(tuple(self.inputs), tuple(self.decisions))
        if step.work is Work.RESET:
            assert self.shell is not None
            latches = self.shell.robot.status(self.now).latches
            self.request(ResetRequest, ids=tuple(latches))
        status = None if self.shell is None else self.shell.robot.status(self.now)
        samples = self.kept.get(step.of or step.id, Samples())
        return Evidence(self.platform, samples, status, earlier=self.verdicts, charges=self.charges)

    def begin(self, step: Step) -> None:
        self.inputs = [(DriverInput(True, "simulated"), self.now)]
        if self.reading is not None:
            self.inputs.append((ReadingsInput({"battery": self.reading}), self.now))
        self.decisions = []
        self.has_told = False
        if step.id in _HANDS:
            self.act_at = self.now + HAND_AT
        if (motion := step.motion) is None:
            return
        self.place = self.sim.world.poses()[0, :2].copy()
        self.count = 0
        self.renewed = f"run-{self.now:.1f}"
        goal = Goal(
            id=self.renewed,
            generation=round(10.0 * self.now),
            issuer="o",
            targets=("r",),
            pattern=motion.pattern,
            params=dict(motion.params),
            seconds=motion.seconds,
            lease=LEASE,
        )
        refused = self.request(
            RunRequest,
            pattern=motion.pattern,
            params=dict(motion.params),
            seconds=motion.seconds,
            goal=goal,
        )
        if refused:
            self.take(Refused(refused))
        elif motion.end is End.PERSON:
            self.act_at = self.now + ACT_AT

    def request(self, kind: Callable[..., Request], **fields: Any) -> str:
        """Send a request; why it was refused, empty if it was applied."""
        shell = self.shell
        if shell is None or self.now < self.cut_until:
            return "no answer"
        self.count += 1
        id = f"{self.now:.2f}-{self.count}"
        one = kind(id=id, operator="o", targets={"r": shell.robot.epoch}, **fields)
        self.inputs.append((RequestInput(one), self.now))
        reply = shell.request(one, self.now)
        assert reply is not None
        return "" if reply.code is Code.APPLIED else reply.text

    # The person

    def prepare(self, step: Step) -> None:
        if step.id == "B3":
            self.sim.end(0, in_order=True)
            self.sim.start([0])
            self._wrap_shell()

    def person(self, now: float) -> None:
        step = self.dialogue.step
        if self.dialogue.phase is Phase.ASKED and now >= self.answer_at:
            self.answer_at = math.inf
            self.take(Line("y"))
        if now >= self.act_at:
            self.act_at = math.inf
            self.act(step)
        if self.shell is None or now < max(self.cut_until, self.lost_until):
            self.back_since = now
        is_back = now - self.back_since > SEEN_AFTER
        if self.has_told and is_back and self.dialogue.phase is Phase.RESTING:
            self.has_told = self.is_pressed = False
            self.take(Key())

    def act(self, step: Step) -> None:
        now = self.now
        match step.id:
            case "B6":
                self.cut_until = now + ABSENT
            case "B7":
                self.sim.end(0, in_order=False)
                if not self.has_watchdog:
                    self.sim._silent_at.clear()
                self.dead_until = now + ABSENT
            case "B8":
                assert self.shell is not None
                self.lost_until = now + ABSENT
                self.shell.step(DriverInput(False, "no base"), now)
            case "B9":
                self.is_pressed = True
            case _:
                self.hand = _HANDS[step.id]
