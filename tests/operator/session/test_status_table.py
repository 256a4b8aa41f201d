"""The statuses with which robots answer."""

from __future__ import annotations

import pytest

from swarmd.operator.session.clocks import QUIET_TIME
from tests.operator.session.discovery_rig import Rig, life


@pytest.fixture
def rig() -> Rig:
    return Rig()


@pytest.mark.parametrize("do_agree", [True, False])
def test_views_that_agree_are_complete_at_once(rig: Rig, do_agree: bool) -> None:
    rig.hear("a", "b")
    rig.answer("a", "b")
    rig.answer("b", *(["a"] if do_agree else []))
    assert rig.found.is_complete(0.02) is do_agree
    assert rig.found.is_complete(0.021 + QUIET_TIME)


def test_both_daemons_of_one_id_must_answer(rig: Rig) -> None:
    rig.hear("b")
    for at in (0.01, 0.05):
        rig.hear("a", instance=1, at=at)
        rig.hear("a", instance=2, at=at + 0.01)
    rig.answer("a", "b", instance=1)
    rig.answer("b", "a")
    assert not rig.found.is_complete(0.5)
    assert rig.found.result(0.1).duplicates == {"a": (life(1).hex(), life(2).hex())}
    rig.answer("a", "b", instance=2)
    assert rig.found.is_complete(0.1)
