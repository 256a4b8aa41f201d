"""The part of the driver contract that is about ends: zero comes last, and nothing is left."""

from __future__ import annotations

import asyncio
import os
import time
import uuid
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from swarmd.testing.driver_stage import Heard, Mortal, Rig, Stage, on_stage
from swarmd.testing.processes import is_running
from swarmd.values import Twist

SETTLE = 0.3
"""Seconds in which what was sent arrives, and what should not have been sent as well."""

_MARK = "SWARMD_DRIVER_CONTRACT"
_MANY = 200
_AT_ONCE = 2.0


def mortal_of(stage: Stage) -> Mortal:
    """The rig, if its base can be taken away; else the test is skipped."""
    if not isinstance(stage.rig, Mortal):
        pytest.skip("this rig is not Mortal")
    return stage.rig


async def moving(stage: Stage) -> list[Twist]:
    """Command until the base moves; what has reached it."""
    taken: list[Twist] = []

    def moves() -> bool:
        stage.driver.send(Twist(0.1), 1, 1)
        taken.extend(stage.rig.commands())
        return bool(taken) and not taken[-1].is_zero

    await stage.until(moves, speaking=True)
    return taken


async def ends_with_zero(stage: Stage, taken: list[Twist]) -> None:
    """The last that reaches the base is zero, and stays so."""

    def stands() -> bool:
        taken.extend(stage.rig.commands())
        return bool(taken) and taken[-1].is_zero

    await stage.until(stands)
    await asyncio.sleep(SETTLE)
    taken.extend(stage.rig.commands())
    assert taken[-1].is_zero


def marked(mark: str) -> list[int]:
    """The living processes that were started with this mark in their environment."""
    wanted, found = f"{_MARK}={mark}".encode(), []
    for environ in Path("/proc").glob("[0-9]*/environ"):
        try:
            if wanted in environ.read_bytes().split(b"\0"):
                found.append(int(environ.parent.name))
        except OSError:  # it has ended meanwhile, or is somebody else's
            continue
    return [pid for pid in found if is_running(pid)]


def open_files() -> int:
    """How many files, sockets and pipes this process holds."""
    return len(os.listdir("/proc/self/fd"))


class Broken(Heard):
    """A sink that cannot bear the loss of its base."""

    def state(self, is_up: bool, text: str) -> None:
        """Remember it, and fail if the base was there before."""
        was_up = self.is_up
        super().state(is_up, text)
        if was_up and not is_up:
            raise RuntimeError("this sink is broken")


class DriverEnds:
    """Inherited by `DriverContract`."""

    def rig(self) -> Rig:
        """A fresh base, not yet speaking."""
        raise NotImplementedError

    def play(self, story: Callable[[Stage], Awaitable[None]], *, connected: bool = True) -> None:
        """Run a story on a stage whose driver has found its base (or not yet)."""

        async def run() -> None:
            async with on_stage(self.rig()) as stage:
                if connected:
                    await stage.connect()
                await story(stage)

        asyncio.run(run())

    def test_the_last_command_is_zero_and_nothing_follows(self) -> None:
        """Every way out sends zero."""

        async def story(stage: Stage) -> None:
            taken = await moving(stage)
            await stage.end()
            stage.driver.send(Twist(0.1), 2, 2)
            await ends_with_zero(stage, taken)

        self.play(story)

    def test_a_command_just_before_the_end_does_not_outlive_it(self) -> None:
        """The zero of the way out comes after all that was sent, however shortly before."""

        async def story(stage: Stage) -> None:
            for seq in range(5):
                stage.driver.send(Twist(0.1), seq, seq)
            await stage.end()
            await ends_with_zero(stage, [])

        self.play(story)

    def test_a_base_that_falls_silent_is_told_to_stand(self) -> None:
        """Its sensors may be gone and its wheels may not."""

        async def story(stage: Stage) -> None:
            taken = await moving(stage)
            await stage.until(lambda: not stage.heard.is_up)
            stage.driver.send(Twist(0.1), 2, 2)
            await ends_with_zero(stage, taken)

        self.play(story)

    def test_the_last_command_is_zero_though_its_sink_fails(self) -> None:
        """An exception is a way out like any other."""

        async def story(stage: Stage) -> None:
            await stage.end()
            heard = Broken()
            task = asyncio.create_task(stage.driver.run(heard))
            again = Stage(stage.rig, stage.driver, heard, task)
            await again.connect()
            taken = await moving(again)
            await again.until(lambda: not heard.is_up)
            await again.end()
            await ends_with_zero(again, taken)

        self.play(story)

    def test_nobody_waits_for_a_base_that_is_gone(self) -> None:
        """A command that cannot be sent is dropped at once: the tick must go on."""

        async def story(stage: Stage) -> None:
            await moving(stage)
            mortal_of(stage).die()
            began = time.monotonic()
            for seq in range(_MANY):
                stage.driver.send(Twist(0.1), seq, seq)
            assert time.monotonic() - began < _AT_ONCE
            mortal_of(stage).rise()

        self.play(story)

    def test_runs_again_after_it_has_ended(self) -> None:
        """`run` leaves nothing behind that would keep a second one from working."""

        async def story(stage: Stage) -> None:
            await stage.end()
            await self._run_once(stage)

        self.play(story)

    def test_leaves_no_task_file_or_process_behind(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Neither a session nor a helper outlives `run`, but for what says zero a little longer."""
        mark = uuid.uuid4().hex

        async def story(stage: Stage) -> None:
            await stage.end()
            monkeypatch.setenv(_MARK, mark)
            tasks = asyncio.all_tasks()
            await self._run_once(stage)
            await asyncio.sleep(SETTLE)
            before = open_files()
            for _ in range(3):
                await self._run_once(stage)
            await stage.until(lambda: asyncio.all_tasks() <= tasks)
            await stage.until(lambda: open_files() <= before)
            await stage.until(lambda: not marked(mark))

        self.play(story)

    async def _run_once(self, stage: Stage) -> None:
        heard = Heard()
        task = asyncio.create_task(stage.driver.run(heard))
        again = Stage(stage.rig, stage.driver, heard, task)
        await again.connect()
        stage.driver.send(Twist(0.1), 1, 1)
        assert (await again.command()).is_zero
        await again.end()
