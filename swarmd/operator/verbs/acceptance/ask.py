"""Carries out rows of the acceptance test on a robot, for `swarmctl` and Python: no click.

The robot moves only after a yes of the person to the question of the step, which says what moves;
see the rules in `swarmd/operator/acceptance/dialogue.py`. No caller has another way.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from swarmd.core.errors import RequestError
from swarmd.core.finding import Finding
from swarmd.core.messages import Presence, Status
from swarmd.operator.acceptance.dialogue import Dialogue
from swarmd.operator.acceptance.result_file import AcceptanceRecord, record_for
from swarmd.operator.acceptance.steps import steps_of
from swarmd.operator.acceptance.verdict import Result, Verdict
from swarmd.operator.session.exit_codes import FAILED, TIMEOUT
from swarmd.operator.session.targets import check_known
from swarmd.operator.verbs.acceptance.results import (
    Results,
    keep_platform,
    new_record,
    wanted_steps,
    write_report,
)
from swarmd.operator.verbs.acceptance.talk import Answers, Person, Question, Talk
from swarmd.operator.verbs.acceptance.tested_robot import Sessions, TestedRobot

if TYPE_CHECKING:
    from swarmd.operator.session.session import Session


class Accepted(NamedTuple):
    """What a call of an acceptance test has found.

    - `record`: all steps so far, also of the calls before with this folder.
    - `file`: the zip with the report and the recordings.
    - `end`: why the call ended. `told`: what was said since the last question.
    """

    record: AcceptanceRecord
    file: Path
    end: str
    told: tuple[str, ...] = ()

    @property
    def verdicts(self) -> dict[str, Verdict]:
        """The verdicts by the id of the step, such as `B1`."""
        return self.record.verdicts

    @property
    def exit_code(self) -> int:
        """1 if a step has failed, else 0, as of `swarmctl acceptance`."""
        return FAILED if self.record.counts[Result.FAIL] else 0


def status_of(session: Session, robot: str) -> Status:
    """The status of a robot.

    RequestError if it does not answer, or is not known.
    """
    view = session.look()
    check_known(robot, view.members, view.roster)
    member = view.members[robot]
    if member.status is None or member.presence is not Presence.ALIVE:
        raise RequestError(f"{robot} does not answer; see `swarmctl members`", TIMEOUT)
    return member.status


def accept(
    sessions: Sessions,
    robot: str,
    rows: Sequence[str],
    folder: Path,
    person: Person,
    *,
    check: Callable[[], Sequence[Finding]] | None = None,
    keep_names: bool = False,
) -> Accepted:
    """Go through rows of the test with a person, and write the file.

    `rows`: parts and ids of steps, as of `wanted_steps`. `folder`: where the results gather; a test
    in it goes on. `check`: the findings of `swarmd --check` on the robot itself; None: elsewhere.
    `keep_names`: names of hosts and users stay in the file.

    Returns after the last question, or once the person has ended the test. ConfigError for a row
    that is no step, and for a folder with the results of another robot; nothing has moved then.
    SwarmError if the robot does not answer or does not record. Whatever ends the call, a robot that
    may move is stopped first.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with TestedRobot(sessions, robot, folder, check) as tested:
        tested.open()
        steps = steps_of(tested.platform)
        wanted = wanted_steps(steps, rows)
        results = Results(folder, record_for(folder, new_record(tested)), steps)
        keep_platform(results.record.platform, folder / "platform-before.yaml")
        known = results.known
        for row in rows:
            known.pop(row, None)
        talk = Talk(Dialogue(wanted, known), tested, person, results)
        talk.run()
    record = results.record
    return Accepted(record, write_report(folder, record, keep_names=keep_names), talk.end)


def accept_by(
    answer: Callable[[Question], str],
    sessions: Sessions,
    robot: str,
    rows: Sequence[str],
    folder: Path,
    *,
    is_cancelled: Callable[[], bool],
    tell: Callable[[str], object],
) -> Accepted:
    """As `accept`, with the answers of a function, which is called on the thread of the caller.

    `is_cancelled` returns True once the caller no longer waits; the robot is then stopped. `tell`
    takes what was said since the last question if the call fails, such as the answer to a stop.
    """
    person = Answers(is_cancelled)
    with ThreadPoolExecutor(1, "acceptance-talk") as pool:
        work = pool.submit(accept, sessions, robot, rows, folder, person)
        work.add_done_callback(lambda _: person.close())
        try:
            person.answer_all(answer)
            accepted = work.result()
        except BaseException:
            pool.shutdown()  # waits for the stop of a robot that may move
            for line in person.told:
                tell(line)
            raise
    return accepted._replace(told=person.told)
