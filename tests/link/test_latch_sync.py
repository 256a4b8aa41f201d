"""How latches are asked for and sent: what fits, and what a forged answer must not hide."""

from __future__ import annotations

import pytest

from swarmd.core.messages import Latch
from swarmd.link.datagram import Latches, pack, tag_of
from swarmd.link.spread.latch_sync import LatchSync, digest_of, latch_parts

TAG = tag_of("field", "lab")
INSTANCE = b"abcdef"
LATCH = Latch(issuer="anna", scope="swarm")


@pytest.mark.parametrize(("issuer", "reason"), [("ä" * 128, "止" * 256), ("a", "")])
def test_texts_in_any_script_fit_and_all_latches_are_sent(issuer: str, reason: str) -> None:
    latch = Latch(issuer=issuer, scope="swarm", reason=reason, age=0.1)
    held = {f"e{number}": latch for number in range(33)}
    parts = list(latch_parts("r" * 63, INSTANCE, held))
    for part in parts:
        pack(TAG, part)
    assert {name for part in parts for name in part.held} == held.keys()
    sync = LatchSync()
    assert sync.wants(INSTANCE, digest_of(held), b"", 0.0)
    for part in parts:
        sync.on_latches(part)
    assert not sync.wants(INSTANCE, digest_of(held), b"", 9.0)


def test_forged_answers_do_not_hide_latches() -> None:
    digest, sync = digest_of({"e1": LATCH}), LatchSync()
    junk = {f"x{number}": Latch(issuer="eve", scope="robots") for number in range(30)}
    for _ in range(5):
        sync.on_latches(Latches(robot="r1", instance=INSTANCE, digest=digest, held=junk))
    wide = {f"y{number}": Latch(issuer="eve", scope="swarm") for number in range(33)}
    for number in range(3):
        held = {f"{name}{number}": latch for name, latch in wide.items()}
        sync.on_latches(Latches(robot="r1", instance=INSTANCE, digest=digest, held=held))
    assert sync.wants(INSTANCE, digest, b"", 0.0)
    sync.on_latches(Latches(robot="r1", instance=INSTANCE, digest=digest, held={"e1": LATCH}))
    assert not sync.wants(INSTANCE, digest, b"", 1.0)


def test_strangers_do_not_use_up_the_requests_to_members() -> None:
    sync = LatchSync()
    for number in range(100):
        sync.wants(number.to_bytes(6, "big"), b"random", b"", 0.0, is_stranger=True)
    assert sync.wants(INSTANCE, b"123456", b"", 0.0)
    assert not sync.wants(INSTANCE, b"123456", b"", 0.1), "asked once a period"
    assert sync.wants(INSTANCE, b"123456", b"", 0.3)
