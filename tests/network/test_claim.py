"""One owner for each robot id."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Awaitable, Callable, Iterator

import pytest
import zenoh

from swarmd.core.errors import NetworkError
from swarmd.network.claim import MAX_RIVALS, Claim, Rivals, claim_id
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings

Until = Callable[[Callable[[], bool]], Awaitable[None]]

SETTLE = 0.1


def rivals(own: str = "m") -> Rivals:
    return Rivals(own=own, started=0.0)


def test_a_claim_without_rivals_wins_after_settling() -> None:
    assert rivals().holder is None
    assert rivals().settles_at(SETTLE) == pytest.approx(0.1)


def test_a_new_link_restarts_settling() -> None:
    table = rivals()
    table.on_link(0.05)
    assert table.settles_at(SETTLE) == pytest.approx(0.15)


def test_new_links_extend_settling_within_bounds() -> None:
    table = rivals()
    table.on_link(30.0)
    assert table.settles_at(SETTLE) == pytest.approx(1.0)
    table.on_token("claim", "z", True, 30.0)
    assert table.settles_at(SETTLE) == pytest.approx(30.1)


def test_a_smaller_claimer_goes_first() -> None:
    table = rivals()
    table.on_token("claim", "a", True, 0.05)
    assert table.holder == "a"


def test_a_larger_claimer_only_restarts_settling() -> None:
    table = rivals()
    table.on_token("claim", "z", True, 0.05)
    assert table.holder is None
    assert table.settles_at(SETTLE) == pytest.approx(0.15)


def test_an_owner_blocks_the_claim_until_it_vanishes() -> None:
    table = rivals()
    table.on_token("alive", "z", True, 0.05)
    assert table.holder == "z"
    table.on_token("alive", "z", False, 3.0)
    assert table.holder is None
    assert table.settles_at(SETTLE) == pytest.approx(3.1)


def test_a_rival_that_became_owner_is_no_leftover() -> None:
    table = rivals()
    table.on_token("claim", "a", True, 0.01)
    assert not table.has_lost
    table.on_token("claim", "a", False, 0.1)
    table.on_token("alive", "a", True, 0.1)
    assert table.has_lost


def test_the_own_tokens_are_no_rivals() -> None:
    table = rivals()
    table.on_token("claim", "m", True, 0.0)
    table.on_token("alive", "m", True, 0.0)
    assert table.holder is None
    assert table.settles_at(SETTLE) == pytest.approx(0.1)


def test_a_flood_of_rivals_is_bounded() -> None:
    table = rivals()
    for number in range(10_000):
        table.on_token("claim", f"n{number}", True, 0.0)
        table.on_token("alive", f"n{number}", True, 0.0)
    assert len(table.alive) == len(table.claiming) == len(table.claimed) == MAX_RIVALS


async def claim(
    session: zenoh.Session,
    settings: NetworkSettings,
    instance: str,
    on_duplicate: Callable[[str], object] = print,
) -> Claim:
    return await claim_id(
        session,
        swarm=settings.swarm,
        robot="tb3-01",
        instance=instance,
        settle=settings.settle,
        lease=0.2,
        on_duplicate=on_duplicate,
    )


class Sessions:
    """Opens sessions, and closes them all."""

    def __init__(self) -> None:
        self._open: list[zenoh.Session] = []

    def __call__(self, settings: NetworkSettings) -> zenoh.Session:
        self._open.append(open_session(settings))
        return self._open[-1]

    def close(self) -> None:
        while self._open:
            self._open.pop().close()


@pytest.fixture
def sessions() -> Iterator[Sessions]:
    made = Sessions()
    yield made
    made.close()


@pytest.mark.parametrize("gap", [0.0, 0.01, 0.05, 0.09, 0.11])
def test_two_at_once_have_exactly_one_owner(
    settings: NetworkSettings, sessions: Sessions, gap: float
) -> None:
    """Starting `gap` seconds apart: together, while the first settles, and just after.

    Each trial has its own sessions, as daemons have: Zenoh 1.10 may leave a token that is taken
    back while another session asks in that session's tables, until the owner's session closes.
    """

    async def trial() -> None:
        one = await asyncio.to_thread(sessions, settings)
        other = await asyncio.to_thread(sessions, settings)

        async def late() -> Claim:
            await asyncio.sleep(gap)
            return await claim(other, settings, random.randbytes(6).hex())

        ends = await asyncio.gather(
            claim(one, settings, random.randbytes(6).hex()), late(), return_exceptions=True
        )
        owners = [end for end in ends if isinstance(end, Claim)]
        refused = [end for end in ends if isinstance(end, NetworkError)]
        assert (len(owners), len(refused)) == (1, 1), ends
        owners[0].release()
        await asyncio.to_thread(sessions.close)

    async def steps() -> None:
        for _ in range(3):
            await trial()

    asyncio.run(steps())


def test_five_fresh_sessions_at_once_have_exactly_one_owner(
    settings: NetworkSettings, sessions: Sessions
) -> None:
    async def start() -> Claim:
        session = await asyncio.to_thread(sessions, settings)
        return await claim(session, settings, random.randbytes(6).hex())

    async def steps() -> list[Claim | BaseException]:
        return await asyncio.gather(*(start() for _ in range(5)), return_exceptions=True)

    ends = asyncio.run(steps())
    assert sum(isinstance(end, Claim) for end in ends) == 1, ends
    assert sum(isinstance(end, NetworkError) for end in ends) == 4, ends


def test_a_held_id_is_refused_in_one_line_that_names_the_holder(
    settings: NetworkSettings, sessions: Sessions
) -> None:
    async def steps() -> None:
        first = await claim(sessions(settings), settings, "aaaaaaaaaaaa")
        with pytest.raises(NetworkError) as caught:
            await claim(sessions(settings), settings, "000000000000")
        assert "'tb3-01'" in str(caught.value)
        assert "aaaaaaaaaaaa" in str(caught.value)
        assert "\n" not in str(caught.value)
        first.release()

    asyncio.run(steps())


def test_a_claim_waits_for_a_token_that_vanishes_soon(
    settings: NetworkSettings, sessions: Sessions
) -> None:
    """What is left of a machine that lost power goes with its lease."""

    async def steps() -> None:
        first = await claim(sessions(settings), settings, "aaaaaaaaaaaa")
        second = asyncio.create_task(claim(sessions(settings), settings, "bbbbbbbbbbbb"))
        await asyncio.sleep(3 * settings.settle)
        assert not second.done()
        first.release()
        assert isinstance(await second, Claim)

    asyncio.run(steps())


def test_a_second_owner_is_reported_to_both(
    settings: NetworkSettings, sessions: Sessions, until: Until
) -> None:
    """As when a cut heals: each claimed the id where it could not see the other."""

    async def steps() -> None:
        heard: list[str] = []
        mine = await claim(sessions(settings), settings, "aaaaaaaaaaaa", heard.append)
        key = f"swarm/{settings.swarm}/tb3-01/alive/bbbbbbbbbbbb"
        token = sessions(settings).liveliness().declare_token(key)
        await until(lambda: bool(heard))
        assert heard == ["bbbbbbbbbbbb"]
        assert list(mine.duplicates) == ["bbbbbbbbbbbb"]
        token.undeclare()
        await until(lambda: not mine.duplicates)

    asyncio.run(steps())


def test_a_refused_claim_leaves_nothing_behind(
    settings: NetworkSettings, sessions: Sessions
) -> None:
    async def steps() -> None:
        first = await claim(sessions(settings), settings, "aaaaaaaaaaaa")
        loser = sessions(settings)
        with pytest.raises(NetworkError):
            await claim(loser, settings, "bbbbbbbbbbbb")
        first.release()
        third = await claim(sessions(settings), settings, "cccccccccccc")
        assert not third.duplicates

    asyncio.run(steps())
