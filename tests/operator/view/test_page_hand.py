"""The stick of a page: which words count, and how a hand ends. With fakes, and the server's own."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Mapping
from typing import Any

import pytest
from websockets.asyncio.client import ClientConnection, connect

from swarmd.core.errors import RequestError
from swarmd.core.messages import Code, Reply
from swarmd.operator.session.outcome import Outcome
from swarmd.operator.view.access import Access
from swarmd.operator.view.page_hand import MAX_AGE, SILENCE, STICK_TIME, PageHand
from tests.operator.view.test_server import serving


class FakeHand:
    """A robot in a hand, which notes what it is told."""

    def __init__(self) -> None:
        self.moves: list[tuple[float, float, float]] = []
        self.slides: list[float] = []
        self.ends: list[str] = []
        self.over = ""

    def move(
        self, forward: float, turn: float = 0.0, left: float = 0.0, *, seconds: float = 0.0
    ) -> None:
        if self.over:
            raise RequestError(self.over, 1)
        self.moves.append((forward, turn, seconds))
        self.slides.append(left)

    def release(self) -> Outcome:
        self.ends.append("released")
        reply = Reply(id="h", robot="r1", code=Code.APPLIED)
        return Outcome({"r1": reply})

    def close(self) -> None:
        self.ends.append("closed")


class Rig:
    """The hand of a page, and the time of its server."""

    def __init__(self, refusal: str = "") -> None:
        self.now = 100.0
        self.robot = FakeHand()
        self.told: list[Mapping[str, Any]] = []
        self._refusal = refusal
        self.page = PageHand(self._take, self.told.append, lambda: self.now)
        self._order = 0

    def _take(self, robot: str) -> FakeHand:
        if self._refusal:
            raise RequestError(self._refusal, 1)
        return self.robot

    async def take(self, age: float | None = 0.1) -> None:
        self.page.on_word({"do": "take", "robot": "r1"}, age)
        await until(lambda: bool(self.told))

    def move(
        self, forward: float = 0.1, *, order: int | None = None, age: float | None = 0.1
    ) -> None:
        self._order += 1
        number = self._order if order is None else order
        self.page.on_word({"do": "move", "order": number, "forward": forward, "turn": 0.2}, age)

    async def ended(self) -> str:
        """How the hand ended, and what the page was told."""
        await until(lambda: bool(self.robot.ends) and not self.told[-1]["is_held"])
        return self.robot.ends[-1]


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(60.0):
        while not holds():
            await asyncio.sleep(0.005)


def test_words_drive_until_the_button_releases() -> None:
    async def drive() -> None:
        rig = Rig()
        await rig.take()
        assert rig.told == [{"kind": "hand", "robot": "r1", "is_held": True, "text": ""}]
        rig.move(0.1)
        rig.move(0.2)
        assert rig.robot.moves == [(0.1, 0.2, STICK_TIME), (0.2, 0.2, STICK_TIME)]
        rig.page.on_word({"do": "move", "order": 3, "left": "fast"}, 0.1)
        rig.page.on_word({"do": "move", "order": 4, "forward": 0.1, "left": -0.3}, 0.1)
        assert rig.robot.slides == [0.0, 0.0, -0.3]  # a base that moves sideways
        rig.page.on_word({"do": "release"}, 0.1)
        rig.move(0.3)
        assert await rig.ended() == "released"
        assert len(rig.robot.moves) == 3
        assert rig.told[-1]["text"] == "released"

    asyncio.run(drive())


def test_words_of_an_old_picture_or_out_of_order_do_not_count() -> None:
    async def drive() -> None:
        rig = Rig()
        await rig.take()
        rig.move(0.1, order=5)
        for order, age in ((4, 0.1), (5, 0.1), (6, MAX_AGE + 0.01), (7, None)):
            rig.move(0.9, order=order, age=age)
        rig.page.on_word({"do": "move", "order": 8, "forward": "fast"}, 0.1)
        rig.page.on_word({"do": "move", "order": None, "forward": 0.9}, 0.1)
        assert [forward for forward, _, _ in rig.robot.moves] == [0.1]
        rig.page.close()

    asyncio.run(drive())


@pytest.mark.parametrize("age", [None, MAX_AGE + 0.01])
def test_a_take_that_waited_on_its_way_takes_nothing(age: float | None) -> None:
    async def drive() -> None:
        rig = Rig()
        await rig.take(age)
        assert not rig.told[-1]["is_held"]
        rig.move()
        assert rig.robot.moves == []

    asyncio.run(drive())


@pytest.mark.parametrize("how", ["silence", "old words", "lost", "closed", "over"])
def test_a_hand_that_is_lost_is_closed_and_never_released(how: str) -> None:
    async def drive() -> None:
        rig = Rig()
        await rig.take()
        rig.move()
        if how == "silence":
            rig.now += SILENCE + 0.01
        elif how == "old words":
            for _ in range(20):
                rig.now += 0.1
                rig.move(age=MAX_AGE + 0.5)
        elif how == "lost":
            rig.page.on_word({"do": "lost"}, None)
        elif how == "closed":
            rig.page.close()
        else:
            rig.robot.over = "estop"
        await until(lambda: bool(rig.robot.ends))
        assert rig.robot.ends == ["closed"]
        if not rig.robot.over:
            assert rig.robot.moves[-1] == (0.0, 0.0, STICK_TIME)

    asyncio.run(drive())


def test_a_refusal_is_told_and_another_take_is_free() -> None:
    async def drive() -> None:
        rig = Rig("r1: driven by bob")
        await rig.take()
        assert rig.told[-1]["text"] == "r1: driven by bob"
        rig._refusal = ""
        rig.page.on_word({"do": "take", "robot": "r1"}, 0.1)
        await until(lambda: rig.told[-1]["is_held"])
        rig.page.on_word({"do": "take", "robot": "r2"}, 0.1)
        assert not rig.told[-1]["is_held"]
        rig.move()
        assert len(rig.robot.moves) == 1
        rig.page.close()

    asyncio.run(drive())


class DrivingCommander:
    """A commander that gives one robot into the hands of pages."""

    def __init__(self) -> None:
        self.robot = FakeHand()
        self.taken: list[str] = []

    async def act(self, verb: str, fields: Mapping[str, Any], tell: Any) -> None:
        """Nothing is commanded."""

    def end_estop(self) -> None:
        """There is none."""

    def take(self, robot: str) -> FakeHand:
        self.taken.append(robot)
        return self.robot


async def taken(page: ClientConnection) -> dict[str, Any]:
    """The answer to a take, asked again while it comes too late; and the picture that it quoted."""
    is_asked = False
    seen = 0
    while True:
        received = await page.recv()
        if isinstance(received, bytes):
            seen = int.from_bytes(received[4:8], "little")
            await page.send(json.dumps({"kind": "ack"}))
            if not is_asked:
                is_asked = True
                take = {"kind": "hand", "do": "take", "robot": "r1", "seen": seen}
                await page.send(json.dumps(take))
            continue
        answer = json.loads(received)
        if answer["kind"] == "hand" and "too late" not in answer["text"]:
            return {**answer, "seen": seen}
        is_asked = is_asked and answer["kind"] != "hand"


@pytest.mark.parametrize(("token", "is_taken"), [("operators", True), ("only-viewers", False)])
def test_a_page_of_an_operator_alone_takes_a_robot_and_loses_it_when_it_closes(
    token: str, is_taken: bool
) -> None:
    async def drive() -> None:
        commander = DrivingCommander()
        access = Access("operators", "only-viewers")
        async with serving(None, commander, access) as (_, address):
            socket = f"{address.replace('http', 'ws')}socket?token={token}"
            async with connect(socket, max_size=2**24) as page:
                answer = await taken(page)
                assert answer["is_held"] is is_taken
                if is_taken:
                    word = {"kind": "hand", "do": "move", "order": 1, "forward": 0.1}
                    await page.send(json.dumps(word | {"seen": answer["seen"]}))
            if is_taken:
                await until(lambda: commander.robot.ends == ["closed"])
            assert commander.taken == (["r1"] if is_taken else [])

    asyncio.run(drive())
