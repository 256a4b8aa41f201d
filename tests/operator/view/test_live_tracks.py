"""The tracks and scans of selected robots, from robots that tell them to those that watch."""

from __future__ import annotations

import time
from contextlib import closing
from typing import cast

import pytest

from swarmd.core.codec import encode
from swarmd.core.messages import DecisionSummary, Reason, ShownTrack, Tracks
from swarmd.operator.session.operator import Operator
from swarmd.operator.view.live import LiveSource
from swarmd.operator.view.source import row_of
from tests.support.fed_swarm import PATTERNS, FedOperator, FedSwarm
from tests.support.processes import wait_until
from tests.support.statuses import make_member


def test_the_row_of_a_robot_that_gives_way_names_the_opening() -> None:
    text = "gives way at an opening, 0.8 m"
    decision = DecisionSummary(is_active=True, avoiding=text)
    status = make_member(decision=decision, reason=Reason.PROTECTION).status
    assert status is not None
    row = row_of(status)
    assert (row["protection"], row["why"], row["stands"]) == (
        text,
        f"protection holds it: {text}",
        "held",
    )


def test_the_tracks_of_a_selected_robot_are_in_its_row() -> None:
    with FedSwarm(2) as swarm:
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        try:
            one, other = swarm.names
            wait_until(
                lambda: all("tracks" in source.rows().get(name, {}) for name in swarm.names),
                "statuses",
            )
            assert ("tracks", one) not in swarm.watched
            source.select([one])
            told = Tracks(one, (ShownTrack(0.6, 0.3, 0.1, -0.05, 0.09, "tb3-02"),))
            swarm.watched["tracks", one](one, encode(told))
            swarm.watched["tracks", one](one, encode(Tracks(other)))  # not its own
            rows = source.rows()
            assert rows[one]["tracks"] == [[0.6, 0.3, 0.1, -0.05, 0.09, "tb3-02"]]
            assert rows[other]["tracks"] == []
            source.select([])
            assert source.rows()[one]["tracks"] == []
            assert ("tracks", one) not in swarm.watched
        finally:
            source.close()


def test_a_scan_is_shown_no_longer_than_it_is_new(monkeypatch: pytest.MonkeyPatch) -> None:
    with FedSwarm(1) as swarm:
        (name,) = swarm.names
        source = LiveSource(cast("Operator", FedOperator(swarm)), PATTERNS)
        source.start()
        with closing(source):
            wait_until(lambda: bool(source.rows().get(name, {}).get("limits")), "a status")
            source.select([name])
            wait_until(lambda: source.scan(name) is not None, "a scan")
            swarm.watched.pop(("scan", name))  # its sensor is silent
            now = time.monotonic()
            monkeypatch.setattr("swarmd.operator.view.live.time.monotonic", lambda: now + 2.0)
            assert source.scan(name) is None
