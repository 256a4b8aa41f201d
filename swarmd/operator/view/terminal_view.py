"""Shows a living swarm on a terminal, and turns keys into stops."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Mapping, Sequence
from contextlib import suppress

from swarmd.core.clock import boottime
from swarmd.core.messages import STATUS_SILENCE, Presence, Status
from swarmd.operator.session.members_view import Contact, MembersView, SeenMember
from swarmd.operator.texts.values import counted
from swarmd.operator.texts.why import SILENT, absence, lost_base, state_word
from swarmd.operator.view.commander import LiveCommander
from swarmd.operator.view.live import LiveSource
from swarmd.operator.view.scene import Area, Place, Scene, area_around
from swarmd.operator.view.screen import Screen, TypedKeys
from swarmd.operator.view.source import CommandProgress
from swarmd.operator.view.terminal import lines_of

PERIOD = 0.5
"""Seconds between two drawings without a key: a drawing takes 8 ms with 50 robots."""
MIN_PERIOD = 0.05
MAX_ANSWER_LINES = 6
ODOMETRY = "each robot's own odometry"
CTRL_E = 0x05
VERBS = {ord("s"): "stop", ord("S"): "stop"} | dict.fromkeys((ord("e"), ord("E"), CTRL_E), "estop")
"""The verb of each key; it goes to all robots. No other key commands robots, so keys that waited
while this program stood still start no motion."""
HELP = "e ESTOP  s stop  q quit  (all robots; more: swarmctl in another terminal)"


class TerminalView:
    """Draws the swarm of `source` on the terminal `screen` until a key or a signal ends the view.

    Positions are by each robot's own odometry, which begins where the robot was started.
    """

    def __init__(self, source: LiveSource, commander: LiveCommander, screen: Screen) -> None:
        self._source = source
        self._commander = commander
        self._screen = screen
        self._keys = TypedKeys()
        self._changed = asyncio.Event()
        self._answers: dict[str, CommandProgress] = {}  # the last answer to each verb
        self._tasks: set[asyncio.Task[None]] = set()
        self._code: int | None = None
        self._is_warned = False  # that an emergency stop is still sent

    async def run(self) -> int:
        """Show the swarm; returns the exit code: 0, or 128 plus the number of an ending signal."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            loop.add_signal_handler(number, self._end, 128 + number)
        loop.add_signal_handler(signal.SIGWINCH, self._changed.set)
        loop.add_signal_handler(signal.SIGTSTP, self._stop_process)
        loop.add_reader(self._screen.input, self._on_input)
        try:
            while self._code is None:
                width, height = self._screen.size
                self._screen.paint(lines_of(self._scene(), width, height))
                await asyncio.sleep(MIN_PERIOD)
                with suppress(TimeoutError):
                    async with asyncio.timeout(PERIOD - MIN_PERIOD):
                        await self._changed.wait()
                self._changed.clear()
        finally:
            loop.remove_reader(self._screen.input)
            for task in self._tasks:
                task.cancel()
        return self._code

    # Input

    def _on_input(self) -> None:
        try:
            data = os.read(self._screen.input, 4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if not data:  # the terminal is gone
            self._end(128 + signal.SIGHUP)
            return
        for key in self._keys.feed(data, boottime()):
            if key == ord("q"):
                self._quit()
            elif key in VERBS:
                self._command(VERBS[key])
        self._changed.set()

    def _quit(self) -> None:
        if self._estop_under_way is None or self._is_warned:
            self._end(0)
        self._is_warned = True

    def _command(self, verb: str) -> None:
        self._is_warned = False
        if verb == "estop" and self._estop_under_way is not None:
            return  # it is repeated until all robots have acknowledged it
        task = asyncio.get_running_loop().create_task(self._act(verb))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _act(self, verb: str) -> None:
        def tell(answer: CommandProgress) -> None:
            self._answers[verb] = answer
            self._changed.set()

        tell(CommandProgress(f"{verb}: sent to all robots, waits for answers"))
        await self._commander.act(verb, {}, tell)

    @property
    def _estop_under_way(self) -> CommandProgress | None:
        """The answers so far to an emergency stop that robots have not acknowledged."""
        answer = self._answers.get("estop")
        return None if answer is None or answer.is_final else answer

    def _end(self, code: int) -> None:
        self._code = code
        self._changed.set()

    def _stop_process(self) -> None:
        """Ctrl-Z: restore the terminal and stop this process; `fg` continues here."""
        self._screen.suspend()
        os.kill(os.getpid(), signal.SIGSTOP)
        self._screen.resume()
        self._changed.set()

    # Output

    def _scene(self) -> Scene:
        """All that the screen shows now: robots, map, answers to commands, and keys."""
        view = self._source.view
        statuses = self._source.statuses()
        # A silent robot has a note in place of its last status; every other robot is in `present`,
        # with its status.
        robots = sorted(view.members.keys() | statuses.keys() | view.roster)
        all_notes = {name: _note(view.members.get(name), statuses.get(name)) for name in robots}
        notes = {name: note for name, note in all_notes.items() if note}
        present = {name: status for name, (status, _) in statuses.items() if name not in notes}
        # The poses are each by the odometry of its robot: no frame is shared.
        poses, area = self._where()
        warning = self._warning()
        return Scene(
            title=self._title(view, present, notes),
            area=area,
            poses={name: poses[name] for name in robots if name in poses and name in present},
            statuses=present,
            robots=robots,
            notes=notes,
            below=self._told(),
            footer=warning or HELP,
            footer_style="bold" if warning else "dim",
            map_note=ODOMETRY,
        )

    def _where(self) -> tuple[Mapping[str, Place], Area]:
        robots = self._source.robots
        _, rows = self._source.frame()
        poses = {robots[int(i)].name: (x, y, yaw) for i, x, y, yaw in rows.tolist()}
        return poses, area_around(poses)

    def _title(
        self, view: MembersView, statuses: Mapping[str, Status], notes: Mapping[str, str]
    ) -> str:
        swarm = self._source.swarm
        if not statuses and not notes:
            if not view.seconds:
                return f"{swarm}: looking for robots"
            return f"{swarm}: no robot is heard; start swarmd, or see --swarm and --profile"
        states = [state_word(status) for status in statuses.values()]
        counts = [f"{states.count(state)} {state}" for state in sorted(set(states))]
        counts += [f"{len(notes)} {SILENT}"] if notes else []
        lost = sum(bool(lost_base(status)) for status in statuses.values())
        counts += [f"{lost} WITHOUT THEIR BASE"] if lost else []
        return f"{swarm}: {counted(len(states) + len(notes), 'robot')}: {', '.join(counts)}"

    def _warning(self) -> str:
        """The question of the first `q` while an emergency stop is under way."""
        estop = self._estop_under_way
        if estop is None or not self._is_warned:
            return ""
        missing = names_of(estop.missing) or "robots"
        return f"the estop is still sent, {missing} did not acknowledge it; q again ends it"

    def _told(self) -> Sequence[tuple[str, str]]:
        """The answers to the last stop and the last emergency stop."""
        lines: list[tuple[str, str]] = []
        for verb, answer in self._answers.items():
            style = "green" if answer.is_good else "yellow"
            if not answer.is_good and (answer.is_final or verb == "estop"):
                style = "bold red"
            lines += [(text, style) for text in answer_lines(answer)]
        return lines[-MAX_ANSWER_LINES:]


def answer_lines(answer: CommandProgress) -> list[str]:
    """The count, then each text with its robots; texts of success are left out."""
    waiting = [] if answer.is_final or not answer.missing else [f"({names_of(answer.missing, 12)})"]
    lines = [" ".join([answer.line, *waiting])]
    by_text: dict[str, list[str]] = {}
    for name, code, text in answer.replies:
        if code != "applied":
            by_text.setdefault(f"{code}: {text}", []).append(name)
    return lines + [f"  {names_of(names)} {text}" for text, names in by_text.items()]


def _note(member: SeenMember | None, known: tuple[Status, float] | None) -> str:
    """The text in place of a robot's state; empty if its status is present."""
    if member is None:
        return "" if known else absence(None)
    is_heard = member.contact in (Contact.ANSWERED, Contact.NO_ANSWER)
    is_present = is_heard and member.presence is Presence.ALIVE
    return "" if is_present and known and known[1] <= STATUS_SILENCE else absence(member)


def names_of(names: Sequence[str], most: int = 4) -> str:
    """The names; for many, their number and the first names."""
    if len(names) <= most:
        return ", ".join(names)
    return f"{len(names)} robots ({', '.join(names[: most - 1])}, ...)"
