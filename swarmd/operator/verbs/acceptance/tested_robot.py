"""The robot of an acceptance test, over the network: sights, runs, stops, recordings, findings."""

from __future__ import annotations

import datetime
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, TypeVar

from swarmd.core.errors import SwarmError
from swarmd.core.finding import Finding, unknown
from swarmd.core.messages import Reason, State, Status
from swarmd.core.values import Platform, Pose
from swarmd.core.verbs import RecordingFile, RecordRequest
from swarmd.daemon.recording.fetch import Ask, fetch, recordings_of
from swarmd.daemon.recording.head import RecordingHead, head_of
from swarmd.daemon.recording.reader import RecordedFile, read_file
from swarmd.operator.acceptance.at_rest import lasting
from swarmd.operator.acceptance.dialogue import Input, Judged, Refused, Sight
from swarmd.operator.acceptance.evidence import Evidence
from swarmd.operator.acceptance.result_file import RECORD, RECORDINGS, recordings_in
from swarmd.operator.acceptance.samples import read_samples
from swarmd.operator.acceptance.step import End, Step, Work
from swarmd.operator.acceptance.stops import LEASE
from swarmd.operator.acceptance.verdict import Verdict, not_shown
from swarmd.operator.calibration.figures import PATTERN
from swarmd.operator.calibration.report import measured_file
from swarmd.operator.session.session import ASK_TIME
from swarmd.operator.session.states import follow_states
from swarmd.operator.session.targets import Targets
from swarmd.operator.texts.doctor import STEPS
from swarmd.operator.verbs.doctor.ask import LISTEN_TIME, findings_of_robot
from swarmd.operator.verbs.run.ask import Run, carry_out
from swarmd.operator.verbs.stop.ask import reset, send_stop

if TYPE_CHECKING:
    from swarmd.operator.session.operator import Operator
    from swarmd.operator.session.session import Session

T = TypeVar("T")
_REASON = "acceptance test"
_NO_HOLD = (None, Reason.PROTECTION, Reason.NO_REQUESTED_COMMAND)
_BATTERY = "battery"  # the reading
_PROBE = "probe"
_PROBE_TIME = 1.5  # s of the recording that tells the robot's platform
_LAST_TIME = 2.0  # s of the recording after a daemon or a link has come back
# s in which a recording that was stopped is on the disk
_FINISH_TIME = 10.0
_POLL = 0.2
_CLOSE_TIME = 3.0  # s in which the watch of the robot ends


class Sessions(Protocol):
    """Opens a session of an operator for one call to robots; several may be open at a time."""

    def __call__(
        self,
        *,
        cancelled: threading.Event | None = None,
        began: float | None = None,
        is_stop: bool = False,
    ) -> AbstractContextManager[Session]:
        """A session. `cancelled`: what it asks for is not wanted any more once this is set.

        `began`: when the person said yes, in s on the clock since boot; None: now. `is_stop`: it
        stops robots, also once the caller no longer waits.
        """


class TestedRobot:
    """One robot of a swarm; what happens to it arrives in `inputs`.

    Nothing here waits for the person: requests and recordings are the work of one thread, in the
    order of the calls, and each stop has a thread of its own.
    """

    __test__ = False  # its name is no name of a test

    def __init__(
        self,
        sessions: Sessions,
        robot: str,
        folder: Path,
        check: Callable[[], Sequence[Finding]] | None = None,
    ) -> None:
        """Not connected. `folder`: of the results.

        `check`: the findings of `swarmd --check`; None: this machine is not the robot.
        """
        self.robot = robot
        self._sessions = sessions
        self._folder = folder
        self._own_check = check
        self.inputs: queue.SimpleQueue[Input] = queue.SimpleQueue()
        self.head: RecordingHead
        self.platform: Platform
        self._targets = Targets((robot,))
        self._lease = ExitStack()  # renews the lease of the present run until its close
        self._closed = threading.Event()
        self._watching: threading.Thread | None = None
        self._cancelled = threading.Event()  # the present run must not begin any more
        self._worker = ThreadPoolExecutor(1, "acceptance")
        self._work: deque[Future[None]] = deque()
        self._stopping: threading.Thread | None = None
        self._answer = ""  # to the last stop
        self._before: Sequence[Finding] = ()  # the findings at the begin of the step
        self._known: frozenset[str] = frozenset()  # recordings before the step

    def __enter__(self) -> TestedRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.shutdown(cancel_futures=True)
        self._end_lease()
        self._closed.set()
        if self._watching is not None:
            self._watching.join(_CLOSE_TIME)

    def open(self, platform: Platform | None = None) -> None:
        """Watch the robot; learn its platform and settings from a short recording before.

        `platform`: of the robot, if that is known; nothing is recorded then. SwarmError if the
        robot does not answer, or does not record.
        """
        try:
            self.platform = self._learn() if platform is None else platform
        except SwarmError:  # the files of two daemons differ
            status = self.status()
            if status is None or status.reason is not Reason.DUPLICATE_ID:
                raise
            text = f"two daemons have its name: {status.detail}; stop one of them"
            raise SwarmError(f"{self.robot}: {text}") from None
        self._watching = threading.Thread(target=self._watch, name="acceptance-watch", daemon=True)
        self._watching.start()

    def _learn(self) -> Platform:
        """Make and read a short recording; the platform in it."""
        if (self._folder / RECORD).exists():  # an interrupted step may still be recorded
            self._record("stop")
        self._start_recording()
        time.sleep(_PROBE_TIME)
        files = self._fetched(_PROBE)
        if not files:
            text = "made no recording, or records already; see swarmctl record list"
            raise SwarmError(f"{self.robot} {text}")
        self.head = head_of(files[-1].about, str(files[-1].path))
        files[-1].path.unlink()
        return self.head.identity.platform

    # What the dialogue wants

    def begin(self, step: Step, said_at: float) -> None:
        """Begin the recording of a step, and its run.

        `said_at`: when the person said yes, in s on the clock since boot: a robot that was stopped
        since then refuses the run.
        """
        self._cancelled.clear()
        self._submit(self._begin, step, said_at)

    def bring(self, end: End) -> None:
        """Bring about the end of a motion."""
        if end is End.SILENCE:
            self._end_lease()
        else:
            self.stop(is_emergency=end is End.ESTOP)

    def stop(self, *, is_emergency: bool = False) -> None:
        """Send a stop, unless the one before is still under way; a run that is asked for ends."""
        self._cancelled.set()
        if self._stopping is None or not self._stopping.is_alive():
            self._stopping = threading.Thread(target=self._stop, args=(is_emergency,))
            self._stopping.start()

    def wait_for_stop(self) -> str:
        """Wait for the answer to the last stop, and return it; empty if none was sent."""
        if self._stopping is not None:
            self._stopping.join()
        return self._answer

    def judge(self, step: Step, verdicts: Mapping[str, Verdict]) -> None:
        """Collect the evidence of a step, and judge it."""
        self._submit(self._judge, step, dict(verdicts))

    def check(self) -> None:
        """Raise the error of the thread of requests that is none of the network or of a file."""
        while self._work and self._work[0].done():
            self._work.popleft().result()

    def status(self) -> Status | None:
        """The present status; None if the robot does not answer."""
        return self._statuses().get(self.robot)

    def _statuses(self) -> dict[str, Status]:
        """The present status of each robot that answers."""
        with self._sessions() as session:
            members = session.operator.members().members
        return {name: one.status for name, one in members.items() if one.status is not None}

    # The thread of requests

    def _submit(self, work: Callable[[Step, T], None], step: Step, more: T) -> None:
        self._work.append(self._worker.submit(self._guarded, work, step, more))

    def _guarded(self, work: Callable[[Step, T], None], step: Step, more: T) -> None:
        """Do a work of the thread; an error of the network or of a file is the step's verdict."""
        try:
            work(step, more)
        except (SwarmError, OSError) as error:
            self.inputs.put(Refused(str(error)))
            self.inputs.put(Judged(not_shown(str(error))))

    def _begin(self, step: Step, said_at: float) -> None:
        if step.work is Work.RECORD:
            self._start_recording()
        elif step.work is Work.DOCTOR:
            self._before = self._doctor()
        if (motion := step.motion) is None:
            return
        self._end_lease()
        run = Run(pattern=motion.pattern, params=motion.params, seconds=motion.seconds, lease=LEASE)
        run.check()
        with ExitStack() as opened:
            session = opened.enter_context(self._sessions(cancelled=self._cancelled, began=said_at))
            targeted = session.target(self._targets, needs_status=run.needs_status)
            outcome = targeted.counted(
                carry_out(run, targeted, self._targets.names, opened).outcome
            )
            if outcome.applied and not session.is_cancelled():
                self._lease = opened.pop_all()  # until then the lease is renewed
        if not outcome.applied:
            reply = outcome.replies.get(self.robot)
            self.inputs.put(Refused("no answer" if reply is None else reply.text))

    def _judge(self, step: Step, verdicts: dict[str, Verdict]) -> None:
        self._end_lease()
        if step.work is Work.RECORD:
            if step.motion is not None and step.motion.end is End.PERSON:
                self._record("start")  # again, if the daemon was killed
                time.sleep(_LAST_TIME)
            self._fetched(step.id)
        findings: Sequence[Finding] = ()
        if step.work is Work.DOCTOR:
            findings = lasting(self._before, self._doctor())
        elif step.motion is not None and step.motion.pattern == PATTERN:
            findings = [one for one in self._doctor(0.0) if one.subject == "load"]
        elif step.work is Work.CHECK:
            findings = self._check()
        elif step.work is Work.RESET:
            with self._sessions() as session:
                reset(session.target(self._targets, needs_status=True), reason=_REASON)
        elif step.work is Work.WRITE:
            findings = [self._write_platform(verdicts)]
        statuses = self._statuses()
        own = statuses.pop(self.robot, None)
        charges = {name: one.readings.get(_BATTERY) for name, one in statuses.items()}
        evidence = Evidence(
            self.platform,
            read_samples(map(read_file, recordings_in(self._folder, step.of or step.id))),
            own,
            findings,
            verdicts,
            {name: one for name, one in charges.items() if isinstance(one, float)},
        )
        self.inputs.put(Judged(step.judge(evidence)))

    def _stop(self, is_emergency: bool) -> None:
        self._answer = "no answer to the stop; use the switch of the base"
        with suppress(SwarmError):
            with self._sessions(is_stop=True) as session:
                if is_emergency:
                    outcome = send_stop(session, "estop", self._targets, _REASON)
                else:
                    outcome = send_stop(session, "stop", self._targets)
            if (reply := outcome.replies.get(self.robot)) is not None:
                self._answer = f"the stop was answered: {reply.text}"

    def _end_lease(self) -> None:
        lease = self._lease
        self._lease = ExitStack()
        lease.close()

    def _watch(self) -> None:
        """Put a sight of the robot for each pose and each change, until the end of the test."""
        while not self._closed.is_set():
            with suppress(SwarmError):
                self._watch_once()
            self._closed.wait(_PROBE_TIME)

    def _watch_once(self) -> None:
        with self._sessions(cancelled=self._closed) as session:
            for state in follow_states(session, self._targets, poses=True):
                pattern = state.pattern if state.state is State.RUNNING else ""
                pose = Pose(state.x, state.y, state.yaw)
                is_estopped = state.state is State.ESTOPPED
                is_held = bool(pattern) and state.reason not in _NO_HOLD
                step = state.report.get("step", "") if pattern else ""  # of this run
                text = f"held: {state.reason}" if is_held else step
                self.inputs.put(Sight(pattern or "", is_estopped, pose, str(text)))

    # Recordings

    def _start_recording(self) -> None:
        """Start a recording; what the robot has recorded before is known from now on."""
        with self._sessions() as session:
            session.operator.members()
            reply = recordings_of(partial(_ask, session.operator), self.robot)
            self._known = frozenset(file.name for file in reply.files)
        self._record("start")

    def _record(self, action: str) -> None:
        with self._sessions() as session:
            targeted = session.target(self._targets, needs_status=False)
            targeted.request(RecordRequest, action=action)

    def _fetched(self, step: str) -> list[RecordedFile]:
        """End the recording, and copy what is new as the files of a step, in place of earlier ones.

        NetworkError if the robot does not answer.
        """
        self._record("stop")
        for path in recordings_in(self._folder, step):
            path.unlink()
        found = []
        with self._sessions() as session:
            session.operator.members()
            ask = partial(_ask, session.operator)
            files = self._finished_files(ask)
            for number, file in enumerate(files, 1):
                copy = fetch(ask, self.robot, file, self._folder / RECORDINGS)
                path = self._folder / RECORDINGS / f"{step}-{number}.mcap"
                copy.path.rename(path)
                found.append(read_file(path))
        return found

    def _finished_files(self, ask: Ask) -> list[RecordingFile]:
        """The new recordings, in their order, once the robot has finished the last one."""
        end = time.monotonic() + _FINISH_TIME
        while True:
            present = sorted(recordings_of(ask, self.robot).files, key=lambda one: one.name)
            files = [one for one in present if one.name not in self._known]
            # A file that is no longer open gets its checksum once its last chunk is written; a file
            # of a killed daemon never does.
            if (files and files[-1].crc is not None) or time.monotonic() > end:
                return files
            time.sleep(_POLL)

    # Findings

    def _doctor(self, listen_time: float = LISTEN_TIME) -> list[Finding]:
        """The findings of the doctor on the robot; beacons are heard for `listen_time` s."""
        with self._sessions() as session:
            view = session.operator.members()
            time.sleep(listen_time)
            return list(findings_of_robot(session.operator, view, self.robot, ASK_TIME))

    def _check(self) -> list[Finding]:
        """The findings of `swarmd --check` on this machine."""
        if self._own_check is None:
            text = "run the test on the robot itself with --daemon-config FILE, or swarmd --check"
            return [unknown("check", text)]
        # The running daemon counts as another node that commands the base: step A6 looks for those.
        # Steps A1 to A4 judge the machine and its network.
        return [one for one in self._own_check() if one.subject not in {*STEPS, "last_word"}]

    def _write_platform(self, verdicts: Mapping[str, Verdict]) -> Finding:
        """Write the platform file that follows from the calibration to the folder."""
        status = self.status()
        if status is None:
            return unknown("platform file", "the robot does not answer")
        path = self._folder / f"{self.robot}.yaml"
        today = datetime.date.today().isoformat()
        values = verdicts["C2"].values
        path.write_text(measured_file(self.robot, status.platform, today, values))
        return Finding("platform file", True, f"written: {path}")


def _ask(operator: Operator, robot: str, name: str, payload: bytes) -> bytes | None:
    return operator.ask(robot, name, payload, timeout=ASK_TIME)
