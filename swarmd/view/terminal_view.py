"""Shows a living swarm on a terminal, and turns keys into commands."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator, Mapping, Sequence

from swarmd.client.input_watch import TOO_LATE, InputWatch
from swarmd.core.clock import boottime
from swarmd.core.messages import STATUS_SILENCE, Presence, Status
from swarmd.network.operator.members_view import Contact, MembersView, SeenMember
from swarmd.texts.values import counted
from swarmd.texts.why import SILENT, absence, lost_base, state_word, stops_text, why
from swarmd.view.commander import LiveCommander
from swarmd.view.controls import KEYS, Command, Controls, Mode, names_of
from swarmd.view.live import LiveSource
from swarmd.view.scene import Area, Place, Scene, area_around
from swarmd.view.screen import KeyDecoder, Screen
from swarmd.view.source import STOPS, CommandProgress
from swarmd.view.terminal import lines_of

PERIOD = 0.5
"""Seconds between two drawings without a key: a drawing takes 8 ms with 50 robots."""
MIN_PERIOD = 0.05
ESCAPE_TIME = 0.05
"""A sequence of a key that is not complete after this time, in s, was the key Escape."""
MAX_ANSWERS, MAX_ANSWER_LINES = 4, 6
ODOMETRY = "each robot's own odometry"


class TerminalView:
    """Draws the swarm of `source` on the terminal `screen` until a key or a signal ends the view.

    Positions are by each robot's own odometry, which begins where the robot was started.
    """

    def __init__(self, source: LiveSource, commander: LiveCommander, screen: Screen) -> None:
        self._source, self._commander, self._screen = source, commander, screen
        self._controls = Controls(patterns=source.patterns)
        self._keys = KeyDecoder()
        self._flush: asyncio.TimerHandle | None = None
        self._changed = asyncio.Event()
        self._answers: dict[int, tuple[str, CommandProgress]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._commands = 0
        self._code: int | None = None
        self._is_warned = False
        self._robots: Sequence[str] = ()
        self._known: Sequence[str] = ()
        self._watch = InputWatch(boottime())

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
                self._watch.look(boottime())
                self._draw()
                await asyncio.sleep(MIN_PERIOD)
                await _wait(self._changed, PERIOD - MIN_PERIOD)
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
        if self._flush is not None:
            self._flush.cancel()
        self._on_keys(self._keys.feed(data))
        if self._keys.is_pending:
            loop = asyncio.get_running_loop()
            self._flush = loop.call_later(ESCAPE_TIME, lambda: self._on_keys(self._keys.flush()))

    def _on_keys(self, keys: Sequence[str]) -> None:
        for key in keys:
            if key == "ctrl-l":
                self._screen.forget()
                continue
            command = self._controls.on_key(key, self._robots, self._known)
            if command is not None:
                self._carry_out(command)
        self._changed.set()

    def _carry_out(self, command: Command) -> None:
        if command.verb == "quit":
            waiting = self._waiting_estops()
            if waiting and not self._is_warned:
                self._is_warned = True
                missing = names_of([name for answer in waiting for name in answer.missing])
                self._controls.note = (
                    f"the estop is still sent, {missing or 'robots'} did not acknowledge it;"
                    " q again ends it"
                )
                return
            self._end(0)
            return
        if command.verb == "estop" and self._waiting_estops():
            self._controls.note = "the estop is still being sent"
            return
        now = boottime()
        if command.verb not in STOPS and not self._watch.is_fresh(now, now):
            self._controls.note = f"{command.verb}: not sent: {TOO_LATE}"
            return
        self._is_warned = False
        self._commands += 1
        task = asyncio.get_running_loop().create_task(self._act(self._commands, command))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _act(self, number: int, command: Command) -> None:
        def tell(answer: CommandProgress) -> None:
            self._answers[number] = command.verb, answer
            self._changed.set()

        to = "all robots" if command.targets is None else names_of(command.targets)
        tell(CommandProgress(f"{command.verb}: sent to {to}, waits for answers"))
        targets = None if command.targets is None else list(command.targets)
        await self._commander.act(command.verb, {**command.fields, "targets": targets}, tell)
        finals = [key for key, (_, answer) in self._answers.items() if answer.is_final]
        for old in finals[:-MAX_ANSWERS]:
            del self._answers[old]

    def _waiting_estops(self) -> list[CommandProgress]:
        return [
            answer
            for verb, answer in self._answers.values()
            if verb == "estop" and not answer.is_final
        ]

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

    def _draw(self) -> None:
        width, height = self._screen.size
        self._screen.paint(lines_of(self._scene(), width, height))

    def _scene(self) -> Scene:
        """All that the screen shows now: robots, map, answers to commands, and prompt.

        Also keeps the cursor on a robot when the order of the shown robots changes.
        """
        view, statuses = self._source.view, self._source.statuses()
        controls = self._controls
        # 1. All known robots. A silent robot has a note in place of its last status; every other
        #    robot is in `present`, with its status.
        self._known = sorted(view.members.keys() | statuses.keys() | view.roster)
        all_notes = {
            name: _note(view.members.get(name), statuses.get(name)) for name in self._known
        }
        notes = {name: note for name, note in all_notes.items() if note}
        present = {name: status for name, (status, _) in statuses.items() if name not in notes}
        # 2. The shown robots, whose text matches the filter.
        search_texts = {
            name: f"{SILENT} {notes[name]}" if name in notes else _searched(present[name])
            for name in self._known
        }
        shown_before = self._robots
        self._robots = controls.shown(search_texts)
        controls.follow(self._robots, shown_before)
        # 3. The poses of shown robots, each by the odometry of its robot: no frame is shared.
        poses, area = self._where()
        located = poses.keys() & present.keys()
        shown_poses = {name: poses[name] for name in self._robots if name in located}
        needs_attention = controls.mode is not Mode.LOOK or bool(controls.note)
        return Scene(
            title=self._title(view, present, notes),
            area=area,
            poses=shown_poses,
            statuses=present,
            robots=self._robots,
            notes=notes,
            cursor=controls.cursor,
            selected=frozenset(controls.selected),
            below=[*self._details(view, statuses, notes), *self._told()],
            footer=controls.prompt,
            footer_style="bold" if needs_attention else "dim",
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
        swarm, controls = self._source.swarm, self._controls
        if not statuses and not notes:
            if not view.seconds:
                return f"{swarm}: looking for robots"
            return f"{swarm}: no robot is heard; start swarmd, or see --swarm and --profile"
        states = [state_word(status) for status in statuses.values()]
        counts = [f"{states.count(state)} {state}" for state in sorted(set(states))]
        counts += [f"{len(notes)} {SILENT}"] if notes else []
        lost = sum(bool(lost_base(status)) for status in statuses.values())
        counts += [f"{lost} WITHOUT THEIR BASE"] if lost else []
        parts = [f"{swarm}: {counted(len(states) + len(notes), 'robot')}: {', '.join(counts)}"]
        if controls.selected:
            hidden = len(controls.selected.difference(self._robots))
            parts.append(f"{len(controls.selected)} selected{f' ({hidden} hidden)' * bool(hidden)}")
        if controls.filter:
            parts.append(f"with '{controls.filter}': {len(self._robots)}")
        return "; ".join(parts)

    def _details(
        self,
        view: MembersView,
        statuses: Mapping[str, tuple[Status, float]],
        notes: Mapping[str, str],
    ) -> Iterator[tuple[str, str]]:
        """Why the robot at the cursor stands, and what a reset would clear."""
        controls = self._controls
        if controls.mode is Mode.RESET:
            for name in controls.targets:
                if name in statuses and (held := statuses[name][0].latches.values()):
                    yield f"{name}: emergency stop{stops_text(held)}", "red"
        name = controls.cursor
        member = view.members.get(name)
        if name in notes or member is None or name not in statuses:
            text = notes.get(name, "")
        else:
            text = why(_with_status(member, statuses[name][0]))
        yield (f"{name}: {text}" if text else ""), ""

    def _told(self) -> Iterator[tuple[str, str]]:
        """The answers to the last commands, and the help on keys if it is open."""
        lines: list[tuple[str, str]] = []
        for verb, answer in self._answers.values():
            style = "green" if answer.is_good else "yellow"
            if not answer.is_good and (answer.is_final or verb == "estop"):
                style = "bold red"
            lines += [(text, style) for text in answer_lines(answer)]
        yield from lines[-MAX_ANSWER_LINES:]
        if self._controls.is_help_shown:
            yield from ((text, "") for text in KEYS)


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


def _with_status(member: SeenMember, status: Status) -> SeenMember:
    from msgspec.structs import replace

    return replace(member, status=status, contact=Contact.ANSWERED)


def _searched(status: Status) -> str:
    return (
        f"{state_word(status)} {status.state} {status.reason or ''} {status.pattern or ''}"
        f" {status.platform}"
    )


async def _wait(event: asyncio.Event, timeout: float) -> None:
    try:
        async with asyncio.timeout(timeout):
            await event.wait()
    except TimeoutError:
        return
