"""One owner for each robot id."""

from __future__ import annotations

import asyncio
import contextlib
import random
from collections.abc import Awaitable, Callable, Iterator

import pytest
import zenoh

from swarmd.core.errors import NetworkError
from swarmd.network.claim import MAX_RIVALS, Claim, Rivals, claim_id
from swarmd.network.session import open_session
from swarmd.network.settings import NetworkSettings

Until = Callable[[Callable[[], bool]], Awaitable[None]]


@pytest.fixture
def rivals() -> Rivals:
    return Rivals(own="m", started=0.0)


def settles_at(rivals: Rivals) -> float:
    return pytest.approx(rivals.settles_at(0.1))  # type: ignore[return-value]


def test_new_links_extend_settling_within_bounds(rivals: Rivals) -> None:
    assert settles_at(rivals) == 0.1
    rivals.on_link(0.05)
    assert settles_at(rivals) == 0.15
    rivals.on_link(30.0)
    assert settles_at(rivals) == 1.0
    rivals.on_token("claim", "z", True, 30.0)
    assert settles_at(rivals) == 30.1


@pytest.mark.parametrize(("rival", "holder"), [("a", "a"), ("z", None)])
def test_the_smaller_of_two_claimers_goes_first(
    rivals: Rivals, rival: str, holder: str | None
) -> None:
    rivals.on_token("claim", rival, True, 0.05)
    assert rivals.holder == holder
    assert settles_at(rivals) == 0.15


def test_an_owner_blocks_the_claim_until_it_vanishes(rivals: Rivals) -> None:
    rivals.on_token("alive", "z", True, 0.05)
    assert rivals.holder == "z"
    rivals.on_token("alive", "z", False, 3.0)
    assert rivals.holder is None
    assert settles_at(rivals) == 3.1


def test_a_rival_that_became_owner_is_no_leftover(rivals: Rivals) -> None:
    rivals.on_token("claim", "a", True, 0.01)
    assert not rivals.has_lost
    rivals.on_token("claim", "a", False, 0.1)
    rivals.on_token("alive", "a", True, 0.1)
    assert rivals.has_lost


def test_the_own_tokens_are_no_rivals(rivals: Rivals) -> None:
    rivals.on_token("claim", "m", True, 0.05)
    rivals.on_token("alive", "m", True, 0.05)
    assert rivals.holder is None
    assert settles_at(rivals) == 0.1


def test_a_flood_of_rivals_is_bounded(rivals: Rivals) -> None:
    for number in range(10_000):
        rivals.on_token("claim", f"n{number}", True, 0.0)
        rivals.on_token("alive", f"n{number}", True, 0.0)
    assert len(rivals.alive) == len(rivals.claiming) == len(rivals.claimed) == MAX_RIVALS


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


OpenSession = Callable[[], zenoh.Session]


@pytest.fixture
def new_session(settings: NetworkSettings) -> Iterator[OpenSession]:
    """Opens sessions, and closes them all."""
    with contextlib.ExitStack() as opened:

        def open_one() -> zenoh.Session:
            session = open_session(settings)
            opened.callback(session.close)
            return session

        yield open_one


@pytest.mark.parametrize(
    ("gap", "count", "is_fresh"),
    [*((gap, 2, False) for gap in (0.0, 0.01, 0.05, 0.09, 0.11)), (0.0, 5, True)],
)
@pytest.mark.parametrize("trial", range(3))
async def test_of_several_at_once_exactly_one_owns_the_id(
    settings: NetworkSettings,
    new_session: OpenSession,
    gap: float,
    count: int,
    is_fresh: bool,
    trial: int,
) -> None:
    """Together, while the first settles, and just after; also while the links come up.

    Each trial has its own sessions, as daemons have: Zenoh 1.10 may leave a token that is taken
    back while another session asks in that session's tables, until the owner's session closes.
    """
    opened = [] if is_fresh else [await asyncio.to_thread(new_session) for _ in range(count)]

    async def start(number: int) -> Claim:
        own = opened[number] if opened else await asyncio.to_thread(new_session)
        await asyncio.sleep(gap * number)
        return await claim(own, settings, random.randbytes(6).hex())

    ends = await asyncio.gather(*map(start, range(count)), return_exceptions=True)
    assert sum(isinstance(end, Claim) for end in ends) == 1, ends
    assert sum(isinstance(end, NetworkError) for end in ends) == count - 1, ends


async def test_a_held_id_is_refused_in_one_line_and_nothing_is_left_behind(
    settings: NetworkSettings, new_session: OpenSession
) -> None:
    first = await claim(new_session(), settings, "aaaaaaaaaaaa")
    loser = new_session()
    with pytest.raises(NetworkError) as caught:
        await claim(loser, settings, "000000000000")
    assert "'tb3-01'" in str(caught.value)
    assert "aaaaaaaaaaaa" in str(caught.value)
    assert "\n" not in str(caught.value)
    first.release()
    third = await claim(new_session(), settings, "cccccccccccc")
    assert not third.duplicates


async def test_a_claim_waits_for_a_token_that_vanishes_soon(
    settings: NetworkSettings, new_session: OpenSession
) -> None:
    """What is left of a machine that lost power goes with its lease."""

    first = await claim(new_session(), settings, "aaaaaaaaaaaa")
    second = asyncio.create_task(claim(new_session(), settings, "bbbbbbbbbbbb"))
    await asyncio.sleep(3 * settings.settle)
    assert not second.done()
    first.release()
    assert isinstance(await second, Claim)


async def test_a_second_owner_is_reported_to_both(
    settings: NetworkSettings, new_session: OpenSession, until: Until
) -> None:
    """As when a cut heals: each claimed the id where it could not see the other."""

    heard: list[str] = []
    mine = await claim(new_session(), settings, "aaaaaaaaaaaa", heard.append)
    key = f"swarm/{settings.swarm}/tb3-01/alive/bbbbbbbbbbbb"
    token = new_session().liveliness().declare_token(key)
    await until(lambda: bool(heard))
    assert heard == ["bbbbbbbbbbbb"]
    assert list(mine.duplicates) == ["bbbbbbbbbbbb"]
    token.undeclare()
    await until(lambda: not mine.duplicates)
