"""The tracks of selected robots, from robots that tell them to those that watch."""

from __future__ import annotations

from typing import cast

from swarmd.core.codec import encode
from swarmd.core.messages import ShownTrack, Tracks
from swarmd.network.operator.operator import Operator
from swarmd.view.live import LiveSource
from tests.support.fed_swarm import PATTERNS, FedOperator, FedSwarm
from tests.support.processes import wait_until


def test_the_tracks_of_a_selected_robot_are_in_its_row() -> None:
    with FedSwarm(2) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        try:
            one, other = swarm.names
            wait_until(lambda: "tracks" in source.rows().get(other, {}), "a status")
            assert ("tracks", one) not in swarm.watched
            source.select([one])
            told = Tracks(one, (ShownTrack(0.6, 0.3, 0.1, -0.05, 0.09),))
            swarm.watched["tracks", one](one, encode(told))
            swarm.watched["tracks", one](one, encode(Tracks(other)))  # not its own
            rows = source.rows()
            assert rows[one]["tracks"] == [[0.6, 0.3, 0.1, -0.05, 0.09]]
            assert rows[other]["tracks"] == []
            source.select([])
            assert source.rows()[one]["tracks"] == []
            assert ("tracks", one) not in swarm.watched
        finally:
            source.close()
