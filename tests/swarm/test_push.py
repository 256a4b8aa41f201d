"""Patterns that an operator pushes to robots: tried, provisional, returned from, pulled."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import swarmd
from swarmd.core.messages import Reason
from swarmd.core.messages import State as S
from tests.support.keys import SwarmKeys
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from tests.support.swarmctl import Finished
    from tests.swarm.conftest import Swarm

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
    """A swarm, and a folder with what is pushed to it: `r1` with a body, and `r2`.

    Each test pushes under names of its own.
    """

    def __init__(self, swarm: Swarm, folder: Path) -> None:
        self.swarm, self.folder = swarm, folder
        self.body = swarm.body("r1")
        self.daemon = swarm.spawn("r1", self.body)
        swarm.start("r2")
        self.daemon.wait_ready()

    def push(self, text: str, *words: str, name: str) -> Finished:
        """`swarmctl plugin push` of a file with this text."""
        file = self.folder / f"{name}.py"
        file.write_text(text)
        return self.swarm.ctl("plugin", "push", str(file), *words)

    def listed(self, robot: str) -> dict[str, Any]:
        """What `plugin list` shows of each pushed pattern of a robot, by name."""
        found = self.swarm.ctl("plugin", "list", robot, "-o", "json").json["robots"]
        return {one["name"]: one for one in found.get(robot, ())}

    def run(self, name: str, robot: str, version: int) -> None:
        """Run the pattern, and wait until it reports this version."""
        done = self.swarm.ctl("run", name, robot)
        assert done.code == 0, done
        self.swarm.await_status(
            robot,
            f"at version {version}",
            lambda now: (now.pattern, now.report.get("version")) == (name, version),
        )


@pytest.fixture(scope="module")
def pushing(shared_swarm: Swarm, tmp_path_factory: pytest.TempPathFactory) -> Pushing:
    return Pushing(shared_swarm, tmp_path_factory.mktemp("pushed"))


def test_pushed_code_is_run_and_kept_over_a_restart(pushing: Pushing) -> None:
    """Also under the names of the files in which a robot keeps it."""
    swarm, names = pushing.swarm, ("own", "record", "code")
    for name in names:
        done = pushing.push(V1, "r1", "--version", "1.0", name=name)
        assert done.outcome == (0, "1 targeted, 1 applied"), done
    assert swarm.status("r1").state is S.IDLE  # nothing moves by a push
    pushing.run("own", "r1", 1)
    assert pushing.push(V2, "r1", name="own").code == 0
    status = swarm.status("r1")  # the run goes on with the old code
    assert (status.state, status.report) == (S.RUNNING, {"version": 1})
    pushing.run("own", "r1", 2)
    assert pushing.daemon.terminate() == 0
    pushing.daemon = swarm.start("r1", pushing.body)
    pushing.run("own", "r1", 2)
    found = {
        name: (one["standing"], one["generation"]) for name, one in pushing.listed("r1").items()
    }
    assert found == {
        "record": ("provisional", 2),
        "code": ("provisional", 3),
        "own": ("provisional", 4),
    }
    assert swarm.ctl("plugin", "remove", "own", "r1").code == 0
    assert swarm.ctl("stop", "r1").code == 0
    assert swarm.ctl("run", "own", "r1").code == 2  # no such pattern


def test_code_that_does_not_load_or_hides_a_pattern_is_refused(pushing: Pushing) -> None:
    assert pushing.push("def broken(:\n", "r1", name="broken").code == 2
    done = pushing.push("import nothing_of_that_name\n", "r1", name="broken")
    assert done.code == 7, done
    assert "nothing_of_that_name" in done.out
    listed = pushing.listed("r1")["broken"]
    assert (listed["standing"], listed["hash"]) == ("returned", "")
    done = pushing.push(V1, "r1", name="drive")
    assert done.code == 7, done
    assert "--replace" in done.out
    assert pushing.push(V1, "r1", "--replace", name="drive").code == 0


def test_provisional_code_that_raises_gives_way_to_the_version_before(pushing: Pushing) -> None:
    swarm = pushing.swarm
    assert pushing.push(V1, "r1", "r2", name="raising").code == 0
    pushing.run("raising", "r1", 1)
    done = pushing.push(RAISES, "r1", "r2", "--canary", "r1", "--rerun", name="raising")
    assert done.code == 3, done
    assert "ZeroDivisionError" in done.err
    status = swarm.await_state("r1", S.FAULTED)
    assert status.reason is Reason.QUARANTINED
    texts = [event.text for event in status.events]
    assert any("returned from raising" in one and "ZeroDivisionError" in one for one in texts)
    listed = pushing.listed("r1")["raising"]
    assert (listed["standing"], "ZeroDivisionError" in listed["text"]) == ("returned", True)
    assert listed["hash"] != listed["pushed"]
    assert pushing.listed("r2")["raising"]["pushed"] == listed["hash"]
    assert swarm.ctl("reset", "r1").code == 0
    assert swarm.status("r1").state is S.IDLE  # it moves again when it is asked to
    pushing.run("raising", "r1", 1)


def test_the_folder_of_a_pattern_is_pushed_with_its_modules(pushing: Pushing) -> None:
    """A module that a method imports is sent, too; the same folder again is there already."""
    folder = pushing.folder / "packed"
    folder.mkdir()
    code = "from .numbers import FIRST\n" + V1.replace(
        "        return", "        from .later import SECOND as LAST\n        return"
    )
    (folder / "pattern.py").write_text(code.replace('version": 1', 'version": FIRST + LAST'))
    (folder / "numbers.py").write_text("FIRST = 3\n")
    (folder / "later.py").write_text("from .numbers import FIRST\nSECOND = FIRST + 1\n")
    done = pushing.swarm.ctl("plugin", "push", str(folder), "r1")
    assert done.outcome == (0, "1 targeted, 1 applied"), done
    pushing.run("packed", "r1", 7)
    before = pushing.listed("r1")["packed"]["hash"]
    with swarmd.connect(pushing.swarm.name) as client:
        again = client.push(folder, "r1")
        assert (again.had, again.taken, again.digest) == (("r1",), (), before)
        (folder / "later.py").write_text("SECOND = 5\n")
        outcome = client.push(folder, "r1", rerun=True)
        assert (outcome.had, outcome.taken) == ((), ("r1",)), outcome
    assert pushing.listed("r1")["packed"]["hash"] == outcome.digest != before
    pushing.run("packed", "r1", 8)


def test_a_late_joiner_gets_what_was_pushed(pushing: Pushing) -> None:
    swarm = pushing.swarm
    bad = "import nothing_of_that_name\n"
    done = pushing.push(bad, "--all", "--canary", "r1", name="late")
    assert done.code == 3, done
    assert "nothing was sent to r2" in done.err
    assert pushing.listed("r2").get("late", {}).get("hash", "") == ""
    done = pushing.push(V1, "--all", "--canary", "1", name="late")
    assert done.code == 0
    assert "swarmctl plugin remove late r1 r2" in done.err
    swarm.start("r3", swarm.body("r3"))
    wait_until(lambda: pushing.listed("r3").get("late", {}).get("hash", "") != "", "r3 has it")
    assert pushing.listed("r3")["late"]["hash"] == pushing.listed("r1")["late"]["hash"]
    pushing.run("late", "r3", 1)


def wheel(name: str, code: str) -> bytes:
    """A wheel of one module with the pattern `Own`, under this name."""
    content = io.BytesIO()
    about = f"{name}-3.1.dist-info"
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr(f"{name}_code/__init__.py", code)
        archive.writestr(f"{about}/METADATA", f"Name: {name}\nVersion: 3.1\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\n")
        entry = f"[swarmd.patterns]\n{name} = {name}_code:Own\n"
        archive.writestr(f"{about}/entry_points.txt", entry)
    return content.getvalue()


@pytest.mark.parametrize("kind", ["file", "wheel"])
def test_a_file_and_a_wheel_are_run_and_not_once_they_were_changed_on_the_disk(
    pushing: Pushing, kind: str
) -> None:
    swarm, name = pushing.swarm, f"own_{kind}"
    file = pushing.folder / (f"{name}.py" if kind == "file" else f"{name}-3.1-py3-none-any.whl")
    codes = [f"# {kind}\n{text}" for text in (V1, V2)]
    contents = [code.encode() if kind == "file" else wheel(name, code) for code in codes]
    for number, content in enumerate(contents, start=1):
        file.write_bytes(content)
        done = swarm.ctl("plugin", "push", str(file), "r1")
        assert done.code == 0, done
        pushing.run(name, "r1", number)
    assert kind == "file" or pushing.listed("r1")[name]["version"] == "3.1"
    assert swarm.ctl("stop", "r1").code == 0
    patterns = swarm.folder / "state" / swarm.name / "r1" / "patterns"
    said = len(pushing.daemon.text())
    kept = [path for path in patterns.rglob("*") if path.is_file()]
    changed = [path for path in kept if path.read_bytes() in (codes[1].encode(), contents[1])]
    for path in changed:
        path.write_bytes(codes[0].encode() if path.suffix == ".py" else contents[0])
    assert changed, kept
    done = swarm.ctl("run", name, "r1", "-o", "json")
    assert done.json["replies"]["r1"]["refusal"] == "changed_code", done
    wait_until(lambda: "changed" in pushing.daemon.text()[said:], "the log tells of it")
    wait_until(lambda: pushing.listed("r1")[name]["hash"] == "", "the list shows no code")
    listed = pushing.listed("r1")[name]
    assert (listed["standing"], "changed" in listed["text"]) == ("missing", True)
    assert swarm.ctl("run", name, "r1").code != 0
    assert swarm.ctl("plugin", "push", str(file), "r1").code == 0
    pushing.run(name, "r1", 2)


def test_with_keys_an_operator_pushes_and_a_viewer_only_looks(swarm: Swarm, tmp_path: Path) -> None:
    robots, everyone = ("r1", "r2"), ("alice", "vera")
    keys = SwarmKeys(
        tmp_path / "keys", swarm.name, robots, operators=everyone[:1], viewers=everyone[1:]
    )

    def secured(robot: str) -> dict[str, Any]:
        return {"identity": str(keys.folder_of(robot))}

    def ctl(who: str, *words: str) -> Finished:
        return swarm.ctl(*words, "--identity", str(keys.folder_of(who)))

    swarm.start("r1", swarm.resting("r1"), secured("r1"))
    file = tmp_path / "own.py"
    file.write_text(V1)
    done = ctl("alice", "plugin", "push", str(file), "r*")
    assert done.code == 3, done  # r2 is on the roster and not there yet
    swarm.start("r2", options=secured("r2"))

    listed: list[dict[str, Any]] = []

    def has_it() -> bool:
        found = ctl("vera", "plugin", "list", "r2", "-o", "json").json["robots"]
        listed[:] = found.get("r2", ())
        return any(one["hash"] != "" for one in listed)

    wait_until(has_it, "r2 has it")
    assert listed[0]["issuer"] == "alice"

    assert ctl("alice", "stop", "r1").code == 0
    entries = ctl("alice", "audit", "r1", "-o", "json").json["entries"]
    assert {(one["verb"], one["operator"]) for one in entries} == {
        ("push", "alice"),
        ("stop", "alice"),
    }
    refused = ctl("vera", "audit", "r1")
    assert refused.code != 0
    assert "alice" not in refused.out
    assert "ready in swarm" in ctl("vera", "logs").out
    found = ctl("vera", "doctor", "-o", "json").json["findings"]
    (identity,) = (one for one in found if (one["where"], one["what"]) == ("r1", "identity"))
    assert "certificate ends in" in identity["finding"]
