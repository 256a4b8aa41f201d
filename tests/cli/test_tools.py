"""logs, audit, links and doctor against real daemons (without a world: their bodies are lost)."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.keys import SwarmKeys
from tests.support.processes import DaemonProcess, run_command, unique_swarm, wait_until

pytestmark = pytest.mark.integration

ROBOTS = ("r1", "r2")


class Swarm:
    """Two daemons and a terminal."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, unique_swarm()
        self.daemons = [
            DaemonProcess(
                folder, swarm=self.name, robot=robot, endpoint="tcp/127.0.0.1:9",
                options={"labels": {"red": ["r1"]}},
            )
            for robot in ROBOTS
        ]  # fmt: skip

    def ctl(self, *args: str) -> subprocess.CompletedProcess[str]:
        return run_command("swarmctl", *args, cwd=self.folder, SWARM=self.name)

    def json(self, *args: str) -> Any:
        done = self.ctl(*args, "-o", "json")
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Swarm]:
    made = Swarm(tmp_path_factory.mktemp("tools"))
    try:
        for daemon in made.daemons:
            daemon.wait_ready()
        wait_until(lambda: "2/2 alive" in made.ctl("members").stdout, "both are alive")
        yield made
    finally:
        for daemon in made.daemons:
            daemon.__exit__()


def test_the_audit_log_has_requests_stops_and_refusals_of_each_robot(swarm: Swarm) -> None:
    assert swarm.ctl("stop", "--all").returncode == 0
    assert swarm.ctl("run", "no-such-pattern", "r1").returncode != 0
    entries = swarm.json("audit")["entries"]
    stopped = {one["robot"] for one in entries if one["verb"] == "stop"}
    assert stopped == set(ROBOTS)
    (refused,) = (one for one in entries if one["verb"] == "run")
    assert (refused["robot"], refused["targets"]) == ("r1", 1)
    assert refused["result"].startswith("refused")
    assert "@" in refused["operator"]
    assert refused["time"] is not None
    of_red = swarm.json("audit", "-l", "red", "-n", "1", "--since", "1h")["entries"]
    assert [one["robot"] for one in of_red] == ["r1"]
    assert "no-such-pattern" in swarm.ctl("audit", "r1").stdout


def test_logs_are_filtered_and_followed(swarm: Swarm) -> None:
    records = swarm.json("logs", "--grep", "READY IN SWARM")["records"]
    assert {one["robot"] for one in records} == set(ROBOTS)
    assert all("ready" in one["text"] for one in records)
    assert swarm.json("logs", "--level", "error")["records"] == []
    command = [sys.executable, "-c", "from swarmd.cli.entry import swarmctl; swarmctl()"]
    words = ("logs", "r1", "-f", "-o", "json", "--grep", "stop to", "--swarm", swarm.name)
    with subprocess.Popen(
        [*command, *words], stdout=subprocess.PIPE, text=True, cwd=swarm.folder
    ) as follower:
        try:
            assert follower.stdout is not None
            swarm.ctl("stop", "--all")
            first = json.loads(follower.stdout.readline())
        finally:
            follower.kill()
    assert (first["kind"], first["robot"]) == ("LogRecord", "r1")
    assert "stop to all robots" in first["text"]


def test_links_tell_who_hears_whom(swarm: Swarm) -> None:
    links = swarm.json("links")["links"]
    assert {(one["robot"], one["hears"]) for one in links} == {("r1", "r2"), ("r2", "r1")}
    for one in links:
        assert one["received"] > 0
        assert one["round_trip"] is not None
        assert "multicast" in one["ways"]
    absent = swarm.ctl("links", "r9")
    assert absent.returncode == 4


def test_doctor_looks_at_this_machine_and_each_robot(swarm: Swarm) -> None:
    found = swarm.json("doctor")["findings"]
    assert {one["where"] for one in found} == {"this machine", *ROBOTS}
    of_r1 = {one["what"]: one for one in found if one["where"] == "r1"}
    assert {"skew", "version", "identity", "heard here", "hears", "state", "ports"} <= set(of_r1)
    assert of_r1["hears"]["finding"].startswith("1 of 1")
    shown = swarm.ctl("doctor", "--problems", "r1").stdout.splitlines()
    assert not any(line.startswith("ok") for line in shown)


def test_a_latch_that_a_robot_takes_from_its_peers_is_in_its_audit_log(swarm: Swarm) -> None:
    swarm.ctl("estop", "--all", "--reason", "cable")
    with DaemonProcess(
        swarm.folder, swarm=swarm.name, robot="r3", endpoint="tcp/127.0.0.1:9"
    ) as late:
        late.wait_ready()

        def taken() -> list[str]:
            entries = swarm.json("audit", "r3")["entries"]
            return [one["text"] for one in entries if one["verb"] == "latch"]

        wait_until(lambda: bool(taken()), "the latch is noted")
        assert taken() == ["cable"]
        swarm.ctl("reset", "--all", "--yes")


def test_doctor_works_without_a_robot(tmp_path: Path) -> None:
    alone = run_command("swarmctl", "doctor", "--timeout", "0.3s", cwd=tmp_path)
    assert alone.returncode == 0
    assert "no robot of swarm" in alone.stdout
    wrong = run_command("swarmctl", "doctor", "--profile", "dev", "--seed", "x", cwd=tmp_path)
    assert wrong.returncode == 1
    assert "this machine" in wrong.stdout


def test_with_keys_the_audit_log_names_the_operator_and_is_closed_to_viewers(
    tmp_path: Path,
) -> None:
    name = unique_swarm()
    keys = SwarmKeys(tmp_path / "keys", name, ["r1"], operators=["anna"], viewers=["class"])

    def ctl(who: str, *words: str) -> subprocess.CompletedProcess[str]:
        identity = str(keys.folder_of(who))
        return run_command("swarmctl", *words, "--identity", identity, cwd=tmp_path, SWARM=name)

    options = {"identity": str(keys.folder_of("r1"))}
    with DaemonProcess(
        tmp_path, swarm=name, robot="r1", endpoint="tcp/127.0.0.1:9", options=options
    ) as daemon:
        daemon.wait_ready()
        assert ctl("anna", "stop").returncode == 0
        entries = json.loads(ctl("anna", "audit", "-o", "json").stdout)["entries"]
        assert [(one["verb"], one["operator"]) for one in entries] == [("stop", "anna")]
        refused = ctl("class", "audit")
        assert refused.returncode != 0
        assert "anna" not in refused.stdout
        assert "ready in swarm" in ctl("class", "logs").stdout
        found = json.loads(ctl("class", "doctor", "-o", "json").stdout)["findings"]
        (identity,) = (one for one in found if (one["where"], one["what"]) == ("r1", "identity"))
        assert "certificate ends in" in identity["finding"]
