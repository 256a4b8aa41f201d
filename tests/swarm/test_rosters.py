"""Rosters on their way: rolled out to daemons that run, pulled by those that were absent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from click.testing import CliRunner

from swarmd.link.keys.identity import load_identity
from swarmd.operator.cli.daemon import swarmd
from tests.support.fake_body import Body
from tests.support.processes import CAP, wait_until
from tests.support.swarmctl import Finished, swarmctl_in_time

if TYPE_CHECKING:
    from tests.support.processes import DaemonProcess
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration


class SecuredSwarm:
    """A swarm with an authority, whose robots have installed their bundles below `folder`."""

    def __init__(self, swarm: Swarm, folder: Path) -> None:
        self.swarm, self.folder = swarm, folder

    def make(self, robots: str) -> None:
        """Make the keys of these robots, and of two operators."""
        self.keys("init", self.swarm.name, "--robots", robots, "--operators", "alice,bob")
        assert self.keys("bundle", "--all", "-o", str(self.folder)).code == 0

    def ctl(self, *words: str) -> Finished:
        return swarmctl_in_time("--swarm", self.swarm.name, *words)

    def keys(self, *words: str) -> Finished:
        return self.ctl("keys", *words)

    def root(self, robot: str) -> Path:
        root = self.folder / robot
        root.mkdir(exist_ok=True, parents=True)
        return root

    def options(self, robot: str) -> dict[str, Any]:
        """The settings by which a daemon is this robot; installs its bundle the first time."""
        folder = self.root(robot) / "etc/swarmd/identities" / self.swarm.name
        if not folder.exists():
            words = [
                "install",
                str(self.folder / f"{robot}.bundle"),
                "--root",
                str(folder.parents[3]),
            ]
            done = CliRunner().invoke(swarmd, words)
            assert done.exit_code == 0, done.output
        return {"identity": str(folder)}

    def start(self, robot: str, body: Body | None = None) -> DaemonProcess:
        return self.swarm.start(robot, body, options=self.options(robot))

    def statuses(self) -> dict[str, Any]:
        """What `members` shows of each robot that answers."""
        members = self.ctl("members", "-o", "json").json["members"]
        return {one["robot"]: one["status"] for one in members if one["status"] is not None}

    def await_generation(self, robot: str, generation: int) -> dict[str, Any]:
        """The status of a robot once it has this generation of the roster."""
        found: dict[str, Any] = {}

        def has_it() -> bool:
            found.clear()
            found.update(self.statuses().get(robot, {}))
            return bool(found) and found["keys"]["generation"] == generation

        wait_until(has_it, f"{robot} has generation {generation}")
        return found


@pytest.fixture
def secured(swarm: Swarm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SecuredSwarm:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LOGNAME", "anna")
    return SecuredSwarm(swarm, tmp_path / "robots")


@pytest.mark.smoke
def test_a_roster_stops_robots_that_take_it_and_reaches_those_that_return(
    secured: SecuredSwarm,
) -> None:
    swarm = secured.swarm
    secured.make("r[1-2]")
    secured.start("r1", swarm.body("r1"))
    wait_until(lambda: secured.ctl("run", "drive", "r1").code == 0, "r1 runs")
    wait_until(lambda: "r1" in secured.statuses(), "r1 answers")
    assert secured.statuses()["r1"]["state"] == "running"

    done = secured.keys("add", "r3", "--role", "robot", "-o", "json")
    assert done.code == 3, done
    assert (done.json["applied"], done.json["missing"]) == (["r1"], ["r2"])
    status = secured.await_generation("r1", 3)
    assert (status["state"], status["reason"]) == ("stopped", "roster_changed")

    secured.start("r2")
    assert secured.await_generation("r2", 3)["state"] == "idle"  # a peer gave it the roster
    done = secured.keys("push")
    assert done.outcome == (0, "1 targeted, 1 applied"), done


def test_a_revoked_robot_stands_and_does_not_start_again(secured: SecuredSwarm) -> None:
    swarm = secured.swarm
    secured.make("r[1-2]")
    secured.start("r1")
    revoked = secured.start("r2", swarm.body("r2"))
    wait_until(lambda: secured.ctl("run", "drive", "r2").code == 0, "r2 runs")

    done = secured.keys("revoke", "r2", "-o", "json")
    assert done.json["applied"] == ["r1"], done
    wait_until(lambda: "the network stays closed" in revoked.text(), "r2 is cut off")
    secured.await_generation("r1", 3)
    assert "r2" not in secured.statuses()
    assert revoked.terminate() == 0
    again = swarm.spawn("r2", options=secured.options("r2"))
    assert again.process.wait(CAP) == 2
    assert secured.keys("add", "r2", "--role", "operator").code == 2


def test_certificates_are_renewed_over_the_link(secured: SecuredSwarm) -> None:
    secured.make("r1")
    secured.start("r1")
    before = secured.await_generation("r1", 2)["keys"]["expires"]
    key = (Path(secured.options("r1")["identity"]) / "key.pem").read_bytes()
    done = secured.keys("renew", "r1", "alice", "--days", "200")
    assert done.outcome == (0, "1 targeted, 1 applied"), done

    def has_it() -> bool:
        """It closes its links for the new certificate, and may not answer meanwhile."""
        status = secured.statuses().get("r1")
        return status is not None and status["keys"]["expires"] > before + 100 * 86400

    wait_until(has_it, "r1 has it")
    assert (Path(secured.options("r1")["identity"]) / "key.pem").read_bytes() == key


def test_an_operator_with_an_older_roster_takes_that_of_a_robot(
    secured: SecuredSwarm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm = secured.swarm.name
    assert secured.keys("init", swarm, "--robots", "r1", "--operators", "bob").code == 0
    secured.folder.mkdir()
    for number, name in enumerate(("bob", "r1", "r1")):
        bundle = secured.folder / f"{name}.bundle"
        bundle.unlink(missing_ok=True)
        secured.keys("add", f"viewer{number}", "--role", "viewer", "--timeout", "1s")
        assert secured.keys("bundle", name, "-o", str(bundle)).code == 0
    secured.start("r1", secured.swarm.resting("r1"))
    # The authority does not know yet that the robot has the last bundle.
    assert secured.keys("push").outcome == (0, "1 targeted, 1 applied")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "bob"))
    assert secured.keys("install", str(secured.folder / "bob.bundle")).code == 0
    done = secured.ctl("estop", "r1", "--until-all")
    assert done.outcome == (0, "1 targeted, 1 applied"), done
    assert secured.statuses()["r1"]["state"] == "estopped"


def test_an_operator_takes_the_key_of_a_robot_that_was_added_later_from_that_robot(
    secured: SecuredSwarm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swarm, bundle = secured.swarm.name, secured.folder / "bob.bundle"
    secured.make("r1")
    kept = bundle.read_bytes()
    secured.keys("add", "r2", "--role", "robot", "--timeout", "1s")
    assert secured.keys("bundle", "r1", "r2", "-o", str(secured.folder)).code == 0
    for robot in ("r1", "r2"):
        secured.start(robot, secured.swarm.resting(robot))
    bundle.write_bytes(kept)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "bob"))
    assert secured.keys("install", str(bundle)).code == 0
    folder = tmp_path / "bob/swarmd/identities" / swarm
    assert load_identity(folder).datagram_keys.answers.keys() == {"r1"}
    done = secured.ctl("estop", "--until-all")
    assert done.outcome == (0, "2 targeted, 2 applied"), done
    keys = load_identity(folder).datagram_keys
    assert (keys.generation, set(keys.answers)) == (3, {"r1", "r2"})
    assert {one["state"] for one in secured.statuses().values()} == {"estopped"}
    assert set(secured.statuses()) == {"r1", "r2"}
