"""A swarm from Python: the verbs of `swarmctl` as methods, with the same answers."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from swarmd.core.clock import boottime
from swarmd.core.closing import Closing, is_program_on
from swarmd.core.errors import ConfigError, ForkedError, RequestError, SwarmError
from swarmd.core.numbers import python_value
from swarmd.operator.client.loop_life import LoopLife
from swarmd.operator.session.exit_codes import NO_TARGET, TIMEOUT
from swarmd.operator.session.session import Session
from swarmd.operator.session.states import Pose, RobotState, follow_states, read_poses
from swarmd.operator.session.targets import (
    Targets,
    Words,
    check_time,
    check_words,
    make_targets,
    no_target,
    plain_params,
    robots_of,
)
from swarmd.operator.verbs.members.ask import Description, Members

if TYPE_CHECKING:
    from swarmd.link.keys.identity import Identity
    from swarmd.operator.client.operator_pool import OperatorPool
    from swarmd.operator.session.members_view import MembersView
    from swarmd.operator.session.outcome import Outcome
    from swarmd.operator.texts.assignments import Value
    from swarmd.operator.verbs.acceptance.ask import Accepted
    from swarmd.operator.verbs.acceptance.talk import Question
    from swarmd.operator.verbs.drive.ask import Hand
    from swarmd.operator.verbs.events.feed import EventLine
    from swarmd.operator.verbs.goal.words import Difference
    from swarmd.operator.verbs.incidents.ask import Incidents, MarkOutcome
    from swarmd.operator.verbs.push.ask import PushOutcome
    from swarmd.operator.verbs.record.ask import Fetched

Tell: TypeAlias = Callable[[str], object]

Places: TypeAlias = Callable[[], Mapping[str, Pose]]
"""Where robots are in one frame, if something outside of them knows it."""


class Swarm(Closing):
    """A swarm, as `swarmd.connect` gives it in a `with` block; each method waits for its answer.

    `robots`: names, globs such as `tb3-*` and ranges such as `tb3-[01-07]`, as one text or several.
    None means all robots, and an empty list no robot. `labels` adds robots with any of these
    labels, `exclude` leaves robots out. `timeout`: the longest time in s that the method takes.

    Methods that change robots return an `Outcome`: `applied`, `refused`, `failed` and `missing`
    name robots, `replies` has the code and text of each robot, `line` and `exit_code` are those of
    `swarmctl`. A robot that refuses or does not answer raises no error. If nothing was sent, a
    method raises RequestError (with the exit code of swarmctl) because no robot is targeted,
    NetworkError because no daemon is reached, or ConfigError because a value is wrong. A method
    raises SwarmError, the base of these errors, if the connection is closed or 8 requests are under
    way. Several threads may use one object; a stop waits for no other method. A process that was
    forked after a method of its parent used Zenoh may stop robots; other methods raise ForkedError.
    """

    def __init__(
        self,
        pool: OperatorPool,
        *,
        timeout: float | None = None,
        tell: Tell = lambda text: None,
        places: Places | None = None,
        cancelled: threading.Event | None = None,
    ) -> None:
        self._pool_of_parent = pool  # its own, unless this process was forked
        self._timeout = timeout
        self._tell = tell
        self._places = places
        self._cancelled = cancelled or threading.Event()
        self._parents: tuple[threading.Event, ...] = ()
        self._began: float | None = None  # when the call began; None: when it takes an operator

    @property
    def _pool(self) -> OperatorPool:
        return self._pool_of_parent.here()

    def close(self) -> None:
        """Leave the network, within a second; robots go on, except those of runs with a lease."""
        self._cancelled.set()
        self._pool.close()

    # Look

    def members(self, *, poses: bool = False, timeout: float | None = None) -> Members:
        """The robots of the swarm; with `poses` also where each is, by its own odometry.

        Robots that did not answer are in `missing`.
        """
        if not poses:
            view, identity = self._look(timeout)
            return Members(view, asker=identity)
        timeout = check_time("timeout", timeout)

        def look() -> Members:
            with self._session(timeout) as session:
                view = session.look()
                if self._places is not None:
                    return Members(view, self._places(), "true positions")
                identity = session.operator.identity
                places = read_poses(session.operator, view.answered)
                return Members(view, places, asker=identity)

        return self._pool.looks.share(("poses", timeout), look, timeout)

    def describe(self, robot: str, *, timeout: float | None = None) -> Description:
        """One robot in detail, and why it does not move."""
        if not isinstance(robot, str):
            raise ConfigError(f"robot is {robot!r}; expected the name of a robot")
        return self.members(timeout=timeout).describe(robot)

    def goal(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> tuple[Difference, ...]:
        """What each robot is to do beside what it does; `is_as_desired` tells whether it does."""
        from swarmd.operator.session.session import signed_goals
        from swarmd.operator.verbs.goal.words import differences

        targets = _targets(robots, labels, exclude)
        view = signed_goals(*self._look(timeout))
        return tuple(differences(view, robots_of(view, targets)))

    def params(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> dict[str, dict[str, Any]]:
        """The parameters in force on each robot that has answered; empty if no pattern runs."""
        from swarmd.operator.verbs.param.ask import params_of

        targets = _targets(robots, labels, exclude)
        view, _ = self._look(timeout)
        names = [name for name in robots_of(view, targets) if name in view.answered]
        by_robot = {name: params_of(view.members[name]).items() for name in names}
        return {name: {key: one.value for key, one in some} for name, some in by_robot.items()}

    def events(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        since: float = 0.0,
    ) -> Generator[EventLine, None, None]:
        """What happens to robots, as it comes, until the iterator is closed.

        `since`: s; also events of this time before the call. Each robot keeps its last 10 events.
        """
        from swarmd.operator.verbs.events.ask import follow_events
        from swarmd.operator.verbs.events.feed import EventFeed

        targets = _targets(robots, labels, exclude)
        if since != 0.0:
            since = check_time("since", since)
        with self._session(None) as session:
            chosen = session.named_now(targets)
            for lines in follow_events(session, EventFeed(since), chosen):
                yield from lines

    def incidents(self, *, timeout: float | None = None) -> Incidents:
        """What went wrong on robots lately, and which robots keep their last minute of it."""
        from swarmd.operator.verbs.incidents.ask import ask_incidents

        with self._session(timeout) as session:
            return ask_incidents(session)

    def fetch_incident(
        self,
        incident: str,
        folder: str | Path | None = None,
        *,
        timeout: float | None = None,
    ) -> Fetched:
        """Copy what robots keep of an incident to this machine; each copy becomes a recording.

        `incident`: its id, or the beginning of its id. `folder`: where to copy to, with a folder
        for each robot; by default incidents/ID below the current folder. A fetch that was
        interrupted continues where it ended. `timeout`: for each answer of a robot. Raises
        RequestError if no robot keeps it, ConfigError if several begin so, PluginError without
        `pip install 'swarmd[record]'`, SwarmError if a copy cannot be written.
        """
        from swarmd.operator.verbs.incidents.ask import ask_incidents, fetch, incident_named

        if not isinstance(incident, str) or not incident:
            raise ConfigError(f"incident is {incident!r}; expected an id, or its beginning")
        if folder is not None and not isinstance(folder, str | Path):
            raise ConfigError(f"folder is {folder!r}; expected a path")
        with self._session(timeout) as session:
            found = ask_incidents(session)
            chosen = incident_named(found, incident)
            return fetch(session, found, chosen, None if folder is None else Path(folder))

    def states(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        seconds: float | None = None,
        poses: bool = False,
    ) -> Generator[RobotState, None, None]:
        """How robots are: a state on each change and each second, with `poses` ten times a second.

        The iterator ends after `seconds`, or when the caller closes it.
        """

        seconds = check_time("seconds", seconds)
        targets = _targets(robots, labels, exclude)
        with self._session(None) as session:
            yield from follow_states(session, targets, seconds=seconds, poses=poses)

    def frame(self, states: Iterable[RobotState] | None = None) -> Any:
        """A pandas DataFrame with a row for each of `states`.

        `states` None: a row for each robot, with its present state. Reports and readings are
        columns `report.NAME` and `reading.NAME`. PluginError without pandas (`pip install
        'swarmd[table]'`).
        """
        from swarmd.operator.client.frames import members_frame, states_frame

        return members_frame(self.members(poses=True)) if states is None else states_frame(states)

    # Command

    def run(
        self,
        pattern: str,
        robots: Words | None = None,
        *,
        params: Mapping[str, Value] | None = None,
        seconds: float | None = None,
        until: Words = (),
        at: float | None = None,
        canary: int | str | None = None,
        canary_time: float | None = None,
        lease: float | None = None,
        on_join: Literal["offer", "run"] = "offer",
        valid: float | None = None,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Start a pattern on robots; the run becomes the goal of these robots.

        A robot answers `applied` once the pattern is loaded and will be stepped. Times are in s.

        `robots`, `labels`, `exclude`: the targets; without these all robots. `seconds`: duration of
        the run; None: until a stop. `until`: conditions as in `swarmctl run --until`; the first
        condition that is met ends the run. `at`: the time from now at which all robots start at one
        moment. `canary`: the robot, or the number of robots, that run first, for `canary_time` s
        (default 10); the other robots follow if the canaries run well. `lease`: robots stop `lease`
        s after this connection was closed, or after its program or the event loop that it belongs
        to has ended. `on_join` "run": robots that join within `valid` s run the goal, too.
        `timeout`: the longest wait for answers.
        """
        from swarmd.operator.verbs.run.ask import Run, carry_out, goal_targets

        values = {
            "pattern": pattern,
            "seconds": seconds,
            "valid": valid,
            "at": at,
            "canary": canary,
            "canary_time": canary_time,
            "lease": lease,
        }
        run = Run(
            params=plain_params(params or {}),
            conditions=check_words(until, "until"),
            on_join=on_join,
            **python_value(values),
        )
        run.check()
        targets = _targets(robots, labels, exclude)
        # With a lease this session stays open during the run, to renew the lease; it counts as one
        # of the 8 requests that may be under way until the robots have answered.
        with self._pool.requests.request(), ExitStack() as opened:
            life = None if lease is None else self._life_of_call(opened)
            session = opened.enter_context(self._session(timeout, life=life))
            targeted = session.target(targets, needs_status=run.needs_status)
            started = carry_out(run, targeted, goal_targets(targets, targeted.names), opened)
            outcome = started.outcome
            if lease is not None and outcome.applied and not session.is_cancelled():
                # The pool closes `opened` with the connection; until then the lease is renewed.
                self._pool.keep_lease(outcome.applied, opened.pop_all())
            return targeted.counted(outcome)

    def _life_of_call(self, opened: ExitStack) -> LoopLife | None:
        """The loop to which the lease of a run belongs; None: to the main thread.

        It is the loop that runs the caller, else that on which the connection was opened, as far as
        that is not over. `opened`: ends the watch of the caller's loop.
        """
        if (own := LoopLife.of_caller()) is not None:
            return opened.enter_context(own)
        return self._life_of_connection()

    def _life_of_connection(self) -> LoopLife | None:
        """The loop on which the connection was opened; None without one, or once it is over."""
        life = self._pool.life
        return None if life is None or life.is_over else life

    def drive(self, robot: str, *, timeout: float | None = None) -> Hand:
        """Take one robot by hand: a run beneath waits, and goes on when the hand releases it.

        ::

            with swarm.drive("tb3-03") as hand:
                hand.move(0.1, 0.5)  # m/s ahead, rad/s to the left, for 0.7 s
                time.sleep(0.5)

        The end of the block releases the robot. If the block raises or the program ends, the robot
        stands instead, and holds its run until `resume` or a new run. Protection bounds all that
        the hand asks. RequestError if the robot refuses: it is estopped, or another hand has it.
        """
        from swarmd.operator.verbs.drive.ask import take

        if not isinstance(robot, str):
            raise ConfigError(f"robot is {robot!r}; expected the name of a robot")
        # The session stays open until the hand is closed, as long as its connection is.
        with self._pool.requests.request(), ExitStack() as opened:
            session = opened.enter_context(self._session(timeout))
            targeted = session.target(make_targets((robot,), (), ()), needs_status=False)
            if len(targeted.names) != 1:
                names = ", ".join(targeted.names)
                raise RequestError(f"drive takes one robot; {robot!r} is {names}", NO_TARGET)
            hand = take(
                session.operator,
                targeted.view,
                targeted.names[0],
                timeout=targeted.time_left,
                issued=session.began,
                is_wanted=lambda: session.is_owned() and not session.is_cancelled(),
            )
            hand.on_close = opened.pop_all().close
            return hand

    def stop(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Stop robots at once; they need a `run` to move again."""
        return self._stop("stop", _targets(robots, labels, exclude), "", False, timeout)

    def estop(
        self,
        robots: Words | None = None,
        *,
        reason: str = "",
        until_all: bool = False,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Emergency-stop robots; the stop survives restarts, until a `reset`.

        `until_all`: the stop is repeated until every expected robot has acknowledged it.
        """
        targets = _targets(robots, labels, exclude)
        return self._stop("estop", targets, str(reason), until_all, timeout)

    def reset(
        self,
        robots: Words | None = None,
        *,
        reason: str = "",
        findings: bool = False,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Clear emergency stops and faults of robots. The robots become idle, and do not move.

        Only emergency stops and faults that the robots report now are cleared; a later emergency
        stop stays. With `findings`, also clear the violated assumptions of protection, for which
        robots drive slower, so that the robots may drive at full speed again.
        """
        from swarmd.operator.verbs.stop.ask import reset

        targets = _targets(robots, labels, exclude)
        with self._session(timeout, is_request=True) as session:
            targeted = session.target(targets, needs_status=True)
            return targeted.counted(reset(targeted, reason=str(reason), findings=findings))

    def param(
        self,
        values: Mapping[str, Value],
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Change parameters of running patterns, until the next run."""
        from swarmd.operator.verbs.param.ask import set_params

        plain = plain_params(values)
        targets = _targets(robots, labels, exclude)
        if not plain:
            raise ConfigError("param needs values, such as {'speed': 0.15}")
        with self._session(timeout, is_request=True) as session:
            targeted = session.target(targets, needs_status=False)
            return targeted.counted(set_params(targeted, plain))

    def label(
        self,
        changes: Words,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Give robots labels, and take others away: `"+red -blue"`."""
        from swarmd.operator.verbs.label.ask import change_labels
        from swarmd.operator.verbs.label.words import read_changes

        words = changes.split() if isinstance(changes, str) else check_words(changes, "changes")
        added, removed = read_changes(words)
        targets = _targets(robots, labels, exclude)
        with self._session(timeout, is_request=True) as session:
            targeted = session.target(targets, needs_status=True)
            return targeted.counted(change_labels(targeted, added, removed))

    def mark(
        self,
        words: str,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> MarkOutcome:
        """Begin an incident with these words: robots keep their last minute. It moves nothing.

        The outcome has the id `incident`, for `fetch_incident` after 10 s.
        """
        from swarmd.operator.verbs.incidents.ask import check_mark, mark

        check_mark(words)
        targets = _targets(robots, labels, exclude)
        with self._session(timeout, is_request=True) as session:
            return mark(session.target(targets, needs_status=False), words)

    def push(
        self,
        file: str | Path,
        robots: Words | None = None,
        *,
        version: str = "",
        canary: int | str | None = None,
        canary_time: float | None = None,
        replace: bool = False,
        rerun: bool = False,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> PushOutcome:
        """Send a pattern to robots, which try it and use it in the next run; starts no run.

        `file`: a .py, the folder of a pattern, or a wheel of pure Python; at most 1 MiB. `version`:
        shown beside the hash. `canary`: the robot, or the number of robots, that get the code
        first; the others follow once these hold it, which takes a run of 60 s, after `canary_time`
        s (default 90), or at once if no canary runs the pattern. `replace`: also in place of a
        pattern that a robot has itself. `rerun`: a robot that runs the pattern stops, and runs it
        again with the new code. `robots`, `labels`, `exclude`: the targets, also of robots that
        join later. `timeout`: for each answer.

        The outcome names the robots that have `taken` the code and those that `had` it already.
        Raises ConfigError for a file that cannot be pushed; nothing was sent then. Raises
        RequestError if a canary fails; the other robots then keep the code that they had.
        """
        from swarmd.operator.verbs.push.ask import Push, push_to, source_at

        if canary is not None:
            canary = python_value(canary)
        targets = _targets(robots, labels, exclude)
        push = Push(source_at(file), version, canary, python_value(canary_time), replace, rerun)
        push.check()
        with self._session(timeout, is_request=True) as session:
            return push_to(push, session.target(targets, needs_status=False), targets)

    def acceptance(
        self,
        robot: str,
        rows: Words | None = None,
        *,
        answer: Callable[[Question], str],
        folder: str | Path | None = None,
        timeout: float | None = None,
    ) -> Accepted:
        """Carry out rows of the acceptance test on one robot, with the answers of a person.

        `rows`: a part or step, such as "A" or "B1", or several; None: all. `answer` gets each
        `Question` and returns what the person says: `y`, `n`, `q`, or the number of a step. Show
        the person `question.text`: it says what to prepare and what moves, how far, how fast and
        for how long. A robot moves only after a `y` to the question of this motion, as with
        `swarmctl acceptance`; a `y` within 0.7 s does not count. Ctrl-C, an error of `answer`, and
        a stop from anywhere end the motion. `folder`: where the results gather, by default
        acceptance-ROBOT; a test in it goes on. `timeout`: for the first answer of the robot.

        The result has the `verdicts` by step, `record` and `file`. Raises ConfigError for a row
        that is no step, for an answer that is no text, and for a folder with the results of another
        robot; RequestError if the robot is not known or does not answer.
        """
        from swarmd.operator.verbs.acceptance.ask import accept_by, status_of

        if not isinstance(robot, str) or not robot:
            raise ConfigError(f"robot is {robot!r}; expected the name of a robot")
        if not callable(answer):
            raise ConfigError(f"answer is {answer!r}; expected a function of a question")
        if folder is not None and not isinstance(folder, str | Path):
            raise ConfigError(f"folder is {folder!r}; expected a path")
        words = () if rows is None else check_words(rows, "rows")
        if rows is not None and not words:
            raise ConfigError("the list of rows is empty; expected such as 'B1', or None for all")
        with self._session(timeout) as session:
            status_of(session, robot)
            is_cancelled = session.is_cancelled
        return accept_by(
            answer,
            self._sessions,
            robot,
            words,
            Path(f"acceptance-{robot}" if folder is None else folder),
            is_cancelled=is_cancelled,
            tell=self._tell,
        )

    def resume(
        self,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> Outcome:
        """Let robots run the goal that they were offered, or whose run has ended."""
        from swarmd.operator.verbs.goal.ask import resume_on

        targets = _targets(robots, labels, exclude)
        with self._session(timeout, is_request=True) as session:
            targeted = session.target(targets, needs_status=True)
            wait = targeted.time_left
            names = targeted.names
            return targeted.counted(resume_on(session, targeted.view, names, timeout=wait))

    def undo(self, *, timeout: float | None = None) -> Outcome:
        """Set the goal before the present one again; robots run it at once."""
        from swarmd.operator.verbs.goal.ask import undo

        with self._session(timeout, is_request=True) as session:
            return undo(session)

    def wait(
        self,
        conditions: Words,
        robots: Words | None = None,
        *,
        labels: Words = (),
        exclude: Words = (),
        timeout: float | None = None,
    ) -> tuple[str, ...]:
        """Wait until robots meet all conditions, at most `timeout` s (default 30).

        `conditions`: `state=STATE`, `pattern=PATTERN`, `presence=PRESENCE`, `goal`, `count=NUMBER`,
        as in `swarmctl wait --for`. `robots`, `labels`, `exclude`: the robots; without these all
        robots. Returns the names of the robots that meet the conditions. Raises RequestError with
        exit code 5 after the timeout; its text names each robot that does not meet the
        conditions.
        """
        from swarmd.operator.verbs.wait.ask import wait_for
        from swarmd.operator.verbs.wait.words import read_awaited

        words = check_words(conditions, "conditions")
        targets = _targets(robots, labels, exclude)
        if not words:
            raise ConfigError("wait needs a condition, such as 'state=running'")
        awaited = read_awaited(words, "conditions")
        with self._session(timeout) as session:
            done = wait_for(session, targets, awaited)
            if session.is_cancelled():
                raise SwarmError("the wait was cancelled")
            if done.missing:
                raise RequestError(done.text, TIMEOUT)
            return done.met

    def _repr_html_(self) -> str:
        return self.members(poses=True)._repr_html_()

    def _look(self, timeout: float | None) -> tuple[MembersView, Identity | None]:
        """A look that calls may share, and the identity of its operator."""
        timeout = check_time("timeout", timeout)

        def look() -> tuple[MembersView, Identity | None]:
            with self._session(timeout) as session:
                return session.look(), session.operator.identity

        return self._pool.looks.share(("look", timeout), look, timeout)

    def _stop(
        self,
        verb: Literal["stop", "estop"],
        targets: Targets,
        reason: str,
        until_all: bool,
        timeout: float | None,
    ) -> Outcome:
        from swarmd.operator.verbs.stop.ask import send_stop

        with self._session(timeout, is_stop=True) as session:
            return send_stop(session, verb, targets, reason, until_all=until_all)

    def _cancellable(self, cancelled: threading.Event, began: float | None = None) -> Swarm:
        """The same connection, for one call that ends when `cancelled` is set.

        `began`: when the call was made, in s on the clock since boot; None: now.
        """
        one = Swarm(
            self._pool_of_parent,
            timeout=self._timeout,
            tell=self._tell,
            places=self._places,
            cancelled=cancelled,
        )
        one._parents = (self._cancelled, *self._parents)
        one._began = boottime() if began is None else began
        return one

    def _sessions(
        self,
        *,
        cancelled: threading.Event | None = None,
        began: float | None = None,
        is_stop: bool = False,
    ) -> AbstractContextManager[Session]:
        """A session of a call that opens several, without lines for the user.

        See `Sessions` of `swarmd/operator/verbs/acceptance/tested_robot.py`. It is cancelled with
        the call, unless it `is_stop`: a stop is sent also once the connection is closed, which a
        cancelled task may close before the robot is told to stop.
        """
        one = Swarm(self._pool_of_parent, cancelled=cancelled)
        one._parents = () if is_stop else (self._cancelled, *self._parents)
        one._began = began
        life = self._life_of_connection()
        return one._session(None, is_stop=is_stop, also_closed=is_stop, life=life)

    @contextmanager
    def _session(
        self,
        timeout: float | None,
        *,
        is_request: bool = False,
        is_stop: bool = False,
        also_closed: bool = False,
        life: LoopLife | None = None,
    ) -> Iterator[Session]:
        """A session for one call; it is cancelled once the call commands for nobody.

        A session that `is_stop` is not. `also_closed`: a closed connection gives one, too. `life`:
        of the event loop to which a lease belongs; None: to the main thread.
        """
        timeout = check_time("timeout", timeout)
        began = boottime() if self._began is None else self._began
        events = (self._cancelled, *self._parents)
        process = os.getpid()
        pool = self._pool
        caller = threading.current_thread()

        def is_cancelled() -> bool:
            if os.getpid() != process:
                raise ForkedError(
                    f"this iterator began in process {process}, of which this process is a fork;"
                    " call the method again here"
                )
            if any(event.is_set() for event in events):
                return True
            return pool.is_over_for(caller) and not is_stop

        lent = (
            self._pool.lend_for_request()
            if is_request
            else self._pool.lend(also_closed=also_closed)
        )
        with lent as operator:
            yield Session(
                operator,
                self._timeout if timeout is None else timeout,
                self._tell,
                is_cancelled,
                began,
                lambda: is_program_on() and (life is None or not life.is_over),
            )


def _targets(robots: Words | None, labels: Words, exclude: Words) -> Targets:
    names = () if robots is None else check_words(robots, "robots")
    labels = check_words(labels, "labels")
    exclude = check_words(exclude, "exclude")
    if robots is not None and not names and not labels:
        raise no_target("the list of robots is empty")
    return make_targets(names, exclude, labels)
