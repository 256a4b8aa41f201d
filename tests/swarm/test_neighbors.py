"""Which robots a daemon's robot counts as neighbors, by the setting of its swarm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


def test_neighbors_follow_the_setting(swarm: Swarm) -> None:
    by_link: dict[str, Any] = {"neighborhood": "link"}
    by_range: dict[str, Any] = {"neighborhood": "range", "range": 2.0}
    swarm.start("r01", None, {"neighbors": by_link})
    swarm.start("r02", None, {"neighbors": by_range})
    third = swarm.start("r03")
    swarm.await_status("r01", "linked", lambda status: status.neighbors == ("r02", "r03"))
    swarm.await_status("r03", "beside all", lambda status: status.neighbors == ("r01", "r02"))
    wait_until(lambda: swarm.presences("r02").keys() == {"r01", "r03"}, "r02 hears both")
    assert swarm.status("r02").neighbors == ()  # their distances are not known
    third.kill()
    swarm.await_status("r01", "linked to one", lambda status: status.neighbors == ("r02",))
