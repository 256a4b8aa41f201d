"""Recordings of robots whose clocks differ by hours, merged onto one timeline by swarmctl."""

from __future__ import annotations

import json
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from swarmd.core.messages import Presence
from swarmd.daemon.recording.reader import read_file
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

AHEAD = 3 * 3600
UNSHARE = ("unshare", "--time", "--boottime", str(AHEAD))


def why_no_time_namespace() -> str:
    try:
        done = subprocess.run([*UNSHARE, "true"], capture_output=True, text=True)
    except OSError as error:
        return str(error)
    return done.stderr.strip()


def folder_of(swarm: Swarm, robot: str) -> Path:
    return swarm.folder / "state" / swarm.name / robot / "recordings"


def has_pairs(folder: Path) -> bool:
    messages = [one for path in folder.glob("*.mcap") for one in read_file(path).messages]
    return sum(one.topic == "/clock/pair" for one in messages) >= 2


def has_index(folder: Path) -> bool:
    return bool(list(folder.glob("*.index.json")))


def test_robots_whose_clocks_are_three_hours_apart_share_a_timeline(
    swarm: Swarm, tmp_path: Path
) -> None:
    if refusal := why_no_time_namespace():
        pytest.skip(f"no time namespace: {refusal}")
    swarm.start("tb3-01", swarm.resting("tb3-01"))
    swarm.start("tb3-02", swarm.resting("tb3-02"), prefix=UNSHARE)
    swarm.await_presence("tb3-01", "tb3-02", Presence.ALIVE)
    swarm.await_presence("tb3-02", "tb3-01", Presence.ALIVE)
    assert swarm.ctl("record", "start", "--all").code == 0
    began = time.time()
    assert swarm.ctl("stop", "--all").code == 0
    acked = time.time()
    for robot in ("tb3-01", "tb3-02"):
        wait_until(partial(has_pairs, folder_of(swarm, robot)), f"{robot} has noted clocks")
    assert swarm.ctl("record", "stop", "--all").code == 0
    for robot in ("tb3-01", "tb3-02"):
        wait_until(partial(has_index, folder_of(swarm, robot)), "finished")
    here, merged = tmp_path / "here", tmp_path / "all.mcap"
    assert swarm.ctl("record", "fetch", "--all", "-d", str(here)).code == 0
    (here / "clocks.jsonl").unlink()  # the robots' own exchanges must do
    done = swarm.ctl("record", "merge", str(here), "-o", str(merged), "-o", "json")
    assert done.code == 0, done.err
    rows = {one["robot"]: one for one in done.json["clocks"]}
    assert rows["tb3-01"]["offset"] == 0.0
    assert abs(rows["tb3-02"]["offset"] - AHEAD) <= rows["tb3-02"]["error"] < 0.5

    stops: dict[str, float] = {}
    with merged.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            if channel.topic.endswith("/request") and json.loads(decoded.json)["verb"] == "stop":
                stops.setdefault(channel.topic.split("/")[1], 1e-9 * message.log_time)
        about = {one.name: one.metadata for one in reader.iter_metadata()}
    assert json.loads(about["swarmd"]["clocks"]) == done.json["clocks"]
    assert about["swarmd/tb3-02"]["robot"] == "tb3-02"
    # Each robot has handled the stop when it acks it.
    for robot in ("tb3-01", "tb3-02"):
        assert began - 0.1 <= stops[robot] + rows[robot]["error"]
        assert stops[robot] - rows[robot]["error"] <= acked + 0.1
    again = swarm.ctl("record", "merge", str(here), "-o", str(merged))
    assert again.code == 2
    assert "exists" in again.err
