"""`swarmctl events` and `swarmctl logs` with real daemons."""

from __future__ import annotations

import contextlib
import json
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


@contextlib.contextmanager
def following(swarm: Swarm) -> Iterator[Iterator[dict[str, Any]]]:
    """The events that `swarmctl events -f -o json` prints, until SIGTERM ends it."""
    process = swarm.begin("events", "-f", "-o", "json")
    try:
        yield map(json.loads, process.out)
    finally:
        process.send_signal(signal.SIGTERM)
        code = process.finish().code
    assert code == 128 + signal.SIGTERM


def test_events_and_logs_of_three_daemons(swarm: Swarm) -> None:
    names = ["tb3-01", "tb3-02", "tb3-03"]
    daemons = [swarm.spawn(name, swarm.resting(name)) for name in names]
    for daemon in daemons:
        daemon.wait_ready()
    with following(swarm) as events:
        assert swarm.ctl("estop", "--reason", "cable", "tb3-02").code == 0
        found = next(one for one in events if "cable" in one["text"])
        assert (found["kind"], found["robot"], found["event"]) == ("Event", "tb3-02", "event")
        daemons[2].kill()
        assert next(one for one in events if one["event"] == "watch")["robot"] == "tb3-03"

    kept = swarm.ctl("events", "tb3-02")
    assert kept.code == 0
    assert "cable" in kept.out
    assert "tb3-01" not in kept.out
    missing = swarm.ctl("events", "-o", "json", "--timeout", "2s")
    assert (missing.code, missing.json["missing"]) == (3, ["tb3-03"])

    follower = swarm.begin("logs", "-f")
    try:
        next(line for line in follower.out if "tb3-02" in line)
        daemons[1].kill()
        next(line for line in follower.err if line.startswith("tb3-02 "))
        swarm.spawn("tb3-02").wait_ready()
        next(line for line in follower.err if line.startswith("tb3-02 is heard again"))
    finally:
        follower.send_signal(signal.SIGTERM)
        code = follower.finish().code
    assert code == 128 + signal.SIGTERM
