"""Behaviours that an operator pushes to robots: tried, provisional, returned from, pulled."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from swarmd.core.messages import Reason
from swarmd.core.messages import State as S
from tests.support.keys import SwarmKeys
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.swarm.conftest import Finished, Swarm

pytestmark = pytest.mark.integration

CODE = """
from swarmd.api import Inputs, Outputs, Params, Pattern, Twist

class Own(Pattern[Params]):
    '''A test's.'''

    def step(self, inputs: Inputs) -> Outputs:
        return Outputs(Twist(0.1), report={"version": VERSION})
"""
V1, V2 = (CODE.replace("VERSION", version) for version in "12")
RAISES = V2.replace("return", "1 / 0\n        return")


class Pushing:
    """A swarm, and a folder with what is pushed to it."""

    def __init__(self, swarm: Swarm, folder: Path) -> None:
        self.swarm, self.folder = swarm, folder
        folder.mkdir()

    def push(self, text: str, *words: str, name: str = "own") -> Finished:
        """`swarmctl plugin push` of a file with this text."""
        file = self.folder / f"{name}.py"
        file.write_text(text)
        return self.swarm.ctl("plugin", "push", str(file), *words)

    def listed(self, robot: str) -> dict[str, Any]:
        """What `plugin list` shows of each behaviour of a robot, by name."""
        found = self.swarm.ctl("plugin", "list", robot, "-o", "json").json["robots"]
        return {one["name"]: one for one in found.get(robot, ())}

    def run(self, robot: str, version: int) -> None:
        """Run the behaviour, and wait until it reports this version."""
        done = self.swarm.ctl("run", "own", robot)
        assert done.code == 0, done
        self.swarm.await_status(
            robot, f"at version {version}", lambda now: now.report.get("version") == version
        )


@pytest.fixture
def pushing(swarm: Swarm, tmp_path: Path) -> Pushing:
    return Pushing(swarm, tmp_path / "pushed")


def test_pushed_code_is_run_and_kept_over_a_restart(pushing: Pushing) -> None:
    swarm = pushing.swarm
    body = swarm.body("r1")
    first = swarm.start("r1", body)
    done = pushing.push(V1, "r1", "--version", "1.0")
    assert done.outcome == (0, "1 targeted, 1 applied"), done
    assert swarm.status("r1").state is S.IDLE  # nothing moves by a push
    pushing.run("r1", 1)
    assert pushing.push(V2, "r1").code == 0
    status = swarm.status("r1")  # the run goes on with the old code
    assert (status.state, status.report) == (S.RUNNING, {"version": 1})
    pushing.run("r1", 2)
    assert first.terminate() == 0
    swarm.start("r1", body)
    pushing.run("r1", 2)
    (listed,) = pushing.listed("r1").values()
    assert (listed["standing"], listed["generation"]) == ("provisional", 2)
    assert swarm.ctl("plugin", "remove", "own", "r1").code == 0
    assert swarm.ctl("stop", "r1").code == 0
    assert swarm.ctl("run", "own", "r1").code == 2  # no such pattern


def test_code_that_does_not_load_or_hides_a_pattern_is_refused(pushing: Pushing) -> None:
    swarm = pushing.swarm
    swarm.start("r1")
    assert pushing.push("def broken(:\n", "r1").code == 2
    done = pushing.push("import nothing_of_that_name\n", "r1")
    assert done.code == 7, done
    assert "nothing_of_that_name" in done.out
    listed = pushing.listed("r1")["own"]
    assert (listed["standing"], listed["hash"]) == ("returned", "")
    done = pushing.push(V1, "r1", name="drive")
    assert done.code == 7, done
    assert "--replace" in done.out
    assert pushing.push(V1, "r1", "--replace", name="drive").code == 0


def test_provisional_code_that_raises_gives_way_to_the_version_before(pushing: Pushing) -> None:
    swarm = pushing.swarm
    body = swarm.body("r1")
    swarm.start("r1", body)
    swarm.start("r2")
    assert pushing.push(V1, "--all").code == 0
    pushing.run("r1", 1)
    done = pushing.push(RAISES, "--all", "--canary", "r1", "--rerun")
    assert done.code == 3, done
    assert "ZeroDivisionError" in done.err
    status = swarm.await_state("r1", S.FAULTED)
    assert status.reason is Reason.QUARANTINED
    texts = [event.text for event in status.events]
    assert any("returned from own" in text and "ZeroDivisionError" in text for text in texts), texts
    listed = pushing.listed("r1")["own"]
    assert (listed["standing"], "ZeroDivisionError" in listed["text"]) == ("returned", True)
    assert listed["hash"] != listed["pushed"]
    assert pushing.listed("r2")["own"]["pushed"] == listed["hash"]
    assert swarm.ctl("reset", "r1").code == 0
    assert swarm.status("r1").state is S.IDLE  # it moves again when it is asked to
    pushing.run("r1", 1)


def test_a_late_joiner_gets_what_was_pushed(pushing: Pushing) -> None:
    swarm = pushing.swarm
    swarm.start("r1")
    swarm.start("r2")
    done = pushing.push("import nothing_of_that_name\n", "--all", "--canary", "1")
    assert done.code == 3, done
    assert "nothing was sent to r2" in done.err
    assert not pushing.listed("r2") or pushing.listed("r2")["own"]["hash"] == ""
    assert pushing.push(V1, "--all", "--canary", "1").code == 0
    swarm.start("r3", swarm.body("r3"))
    wait_until(lambda: pushing.listed("r3").get("own", {}).get("hash", "") != "", "r3 has it")
    assert pushing.listed("r3")["own"]["hash"] == pushing.listed("r1")["own"]["hash"]
    pushing.run("r3", 1)


def wheel(name: str, code: str) -> bytes:
    """A wheel of one module with the pattern `Own`, under this name."""
    content = io.BytesIO()
    about = f"{name}-3.1.dist-info"
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(f"{name}_code/__init__.py", code)
        archive.writestr(f"{about}/METADATA", f"Name: {name}\nVersion: 3.1\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\n")
        entry = f"[swarmd.patterns]\nown = {name}_code:Own\n"
        archive.writestr(f"{about}/entry_points.txt", entry)
    return content.getvalue()


def test_a_wheel_is_pushed_and_run(pushing: Pushing) -> None:
    swarm = pushing.swarm
    swarm.start("r1", swarm.body("r1"))
    for number, text in enumerate((V1, V2), start=1):
        file = pushing.folder / "own-3.1-py3-none-any.whl"
        file.write_bytes(wheel("own", text))
        done = swarm.ctl("plugin", "push", str(file), "r1")
        assert done.code == 0, done
        pushing.run("r1", number)
    assert pushing.listed("r1")["own"]["version"] == "3.1"


@pytest.mark.parametrize("kind", ["file", "wheel"])
def test_code_that_was_changed_on_the_disk_is_not_run(pushing: Pushing, kind: str) -> None:
    swarm = pushing.swarm
    daemon = swarm.start("r1", swarm.body("r1"))
    file = pushing.folder / ("own.py" if kind == "file" else "own-3.1-py3-none-any.whl")
    file.write_bytes(V1.encode() if kind == "file" else wheel("own", V1))
    assert swarm.ctl("plugin", "push", str(file), "r1").code == 0
    pushing.run("r1", 1)
    assert swarm.ctl("stop", "r1").code == 0
    behaviours = swarm.folder / "state" / swarm.name / "r1" / "behaviours"
    changed = 0
    for path in behaviours.rglob("*"):
        if path.suffix == ".py":  # of a wheel that is unpacked, too
            changed += path.write_text(V2) > 0
        elif path.suffix == ".whl":
            changed += path.write_bytes(wheel("own", V2)) > 0
    assert changed
    done = swarm.ctl("run", "own", "r1", "-o", "json")
    assert done.json["replies"]["r1"]["refusal"] == "changed_code", done
    assert "changed" in daemon.text()
    wait_until(lambda: pushing.listed("r1")["own"]["hash"] == "", "the list shows no code")
    listed = pushing.listed("r1")["own"]
    assert (listed["standing"], "changed" in listed["text"]) == ("missing", True)
    assert swarm.ctl("run", "own", "r1").code != 0
    assert swarm.ctl("plugin", "push", str(file), "r1").code == 0
    pushing.run("r1", 1)


@pytest.mark.parametrize("name", ["record", "code"])
def test_no_name_of_a_pattern_is_that_of_a_file(pushing: Pushing, name: str) -> None:
    swarm = pushing.swarm
    first = swarm.start("r1")
    assert pushing.push(V1, "r1", name=name).code == 0
    assert pushing.push(V1, "r1", name="own").code == 0
    assert first.terminate() == 0
    swarm.start("r1")
    assert set(pushing.listed("r1")) == {name, "own"}
    assert pushing.listed("r1")[name]["standing"] == "provisional"


def test_with_keys_an_operator_pushes_and_robots_pull_from_each_other(
    pushing: Pushing, tmp_path: Path
) -> None:
    swarm = pushing.swarm
    robots, everyone = ("r1", "r2"), ("alice", "vera")
    keys = SwarmKeys(
        tmp_path / "keys", swarm.name, robots, operators=everyone[:1], viewers=everyone[1:]
    )

    def secured(robot: str) -> dict[str, Any]:
        return {"identity": str(keys.folder_of(robot))}

    def ctl(who: str, *words: str) -> Finished:
        return swarm.ctl(*words, "--identity", str(keys.folder_of(who)))

    swarm.start("r1", options=secured("r1"))
    file = pushing.folder / "own.py"
    file.write_text(V1)
    done = ctl("alice", "plugin", "push", str(file), "r*", "--timeout", "2s")
    assert done.code == 3, done  # r2 is on the roster and not there yet
    swarm.start("r2", options=secured("r2"))

    def listed(robot: str) -> Any:
        return ctl("vera", "plugin", "list", robot, "-o", "json").json["robots"][robot]

    wait_until(lambda: bool(listed("r2")) and listed("r2")[0]["hash"] != "", "r2 has it")
    assert listed("r2")[0]["issuer"] == "alice"
