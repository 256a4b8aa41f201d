"""Profile field between two network namespaces: static seeds, no multicast, a cut cable."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import yaml

from swarmd.core.values import Value
from tests.support.processes import CAP, DaemonProcess, unique_swarm, wait_until

if TYPE_CHECKING:
    from tests.conftest import Namespaces
    from tests.swarm.conftest import Swarm

pytestmark = pytest.mark.integration

ROOT = Path(__file__).parents[2]
ADDRESSES = {"a": "10.78.0.1", "b": "10.78.0.2"}
ROBOTS: dict[str, tuple[str, ...]] = {"a": ("r1", "r2"), "b": ("r3", "r4")}
PORTS = (7447, 7448)
SEEDS = [f"tcp/{address}:{port}" for address in ADDRESSES.values() for port in PORTS]


class LineProcess:
    """A process that answers each line with one of JSON."""

    def __init__(self, command: Sequence[str]) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT)

    def say(self, word: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()

    def hear(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"it ended with {self._process.wait(CAP)}"
        return json.loads(line)

    def ask(self, word: str) -> Any:
        self.say(word)
        return self.hear()

    def close(self) -> None:
        with self._process:
            self._process.communicate(timeout=CAP)


class Side:
    """One namespace: its robots, their daemons and its operators."""

    def __init__(
        self, swarm: Swarm, prefix: Sequence[str], address: str, robots: Sequence[str]
    ) -> None:
        self.swarm = swarm
        self.robots = robots
        self._prefix = prefix
        self._address = address
        self._left = contextlib.ExitStack()
        self._left.callback(swarm.close)
        self.bodies = self.talk(
            [sys.executable, "-m", "tests.swarm.bodies", "--swarm", swarm.name, *robots]
        )
        self._endpoints = self.bodies.hear()["endpoints"]

    def close(self) -> None:
        self._left.close()

    def talk(self, command: Sequence[str]) -> LineProcess:
        made = LineProcess([*self._prefix, *command])
        self._left.callback(made.close)
        return made

    def spawn(self, robot: str) -> DaemonProcess:
        """The robot's daemon, starting."""
        own = f"tcp/{self._address}:{PORTS[self.robots.index(robot)]}"
        options: dict[str, Value] = {
            "listen": [own],
            "seeds": [seed for seed in SEEDS if seed != own],
            "driver_options": {"endpoint": self._endpoints[robot]},
        }
        return self.swarm.spawn(robot, options=options)

    def conditions(self) -> dict[str, str]:
        """The conditions of the members as seen from here."""
        done = self.swarm.ctl("members", "-o", "json")
        return {member["robot"]: member["presence"] for member in done.json["members"]}

    def await_presences(self, **wanted: str) -> None:
        """Wait until the members have these conditions."""
        began = time.monotonic()
        wait_until(lambda: self.conditions() == wanted, f"{self.robots} see {wanted}")
        print(f"{self.robots} see {wanted} after {time.monotonic() - began:.1f} s")


Field = dict[str, Side]


@pytest.fixture
def lease() -> float:
    """Seconds until a side that is cut off counts as gone."""
    return 1.5


@pytest.fixture
def robots() -> dict[str, tuple[str, ...]]:
    return ROBOTS


@pytest.fixture
def field(
    tmp_path: Path,
    swarm: Swarm,
    namespaces: Namespaces,
    robots: dict[str, tuple[str, ...]],
    lease: float,
) -> Iterator[Field]:
    """Two sides with bodies and without daemons yet."""
    name = unique_swarm()
    settings = {
        "swarm": name,
        "profile": "field",
        "interface": "eth0",
        "multicast": False,
        "insecure": True,
    }
    config = tmp_path / "swarm.yaml"
    config.write_text(yaml.safe_dump({**settings, "seeds": SEEDS, "lease": lease}))
    with contextlib.ExitStack() as left:
        made: Field = {}
        for side, address in ADDRESSES.items():
            prefix = ("ip", "netns", "exec", namespaces.join(side, address))
            there = type(swarm)(tmp_path / side, name=name, prefix=prefix, config=config)
            made[side] = Side(there, prefix, address, robots[side])
            left.callback(made[side].close)
        yield made


def start(field: Field) -> None:
    daemons = [side.spawn(robot) for side in field.values() for robot in side.robots]
    for daemon in daemons:
        daemon.wait_ready()


ALL_ALIVE = dict.fromkeys(("r1", "r2", "r3", "r4"), "alive")


def test_no_late_run_moves_a_swarm_that_was_cut_in_two(
    field: Field, namespaces: Namespaces
) -> None:
    a, b = field["a"], field["b"]
    start(field)
    for side in (a, b):
        side.await_presences(**ALL_ALIVE)
    assert a.swarm.ctl("run", "drive", "--all").outcome == (0, "4 targeted, 4 applied")
    for side in (a, b):
        side.bodies.ask("moving")
    late = a.talk([sys.executable, "-m", "tests.swarm.late_operator", str(a.swarm.config)])
    assert late.ask("look") == {"seen": ["r1", "r2", "r3", "r4"]}

    # A swarmctl takes 4.5 s to give unreachable seeds up: both sides wait for it at once.
    namespaces.cut("b")
    stop_b = b.swarm.begin("stop", "--timeout", "1s")
    b.bodies.ask("standing")
    b.bodies.ask("mark")
    a.bodies.ask("moving")  # the other side is autonomous
    stop_a = a.swarm.begin("stop", "--timeout", "1s")
    a.bodies.ask("standing")
    a.bodies.ask("mark")
    outcomes = [side.swarm.finish(stop).outcome for side, stop in ((a, stop_a), (b, stop_b))]
    assert outcomes == [
        (3, "4 targeted, 2 applied, 2 no answer (r3, r4)"),
        (3, "4 targeted, 2 applied, 2 no answer (r1, r2)"),
    ]
    late.say("run 1")
    with ThreadPoolExecutor(2) as pool:
        seen_by_a = {"r1": "alive", "r2": "alive", "r3": "failed", "r4": "failed"}
        seen_by_b = {"r1": "failed", "r2": "failed", "r3": "alive", "r4": "alive"}
        looks = [
            pool.submit(a.await_presences, **seen_by_a),
            pool.submit(b.await_presences, **seen_by_b),
        ]
        for look in looks:
            look.result()
    assert late.hear().keys() == {"r1", "r2", "r3", "r4"}

    namespaces.heal("b")
    for side in (a, b):
        side.await_presences(**ALL_ALIVE)
    answers = late.ask("run 20")
    assert {name: answer[0] for name, answer in answers.items()} == dict.fromkeys(
        ALL_ALIVE, "refused"
    )
    for side in (a, b):
        assert not any(side.bodies.ask("mark")["mark"].values())

    # The stops of both sides are still handed on, and one may come between look and request.
    wait_until(
        lambda: b.swarm.ctl("run", "drive", "--all").outcome == (0, "4 targeted, 4 applied"),
        "all robots run again",
    )
    for side in (a, b):
        side.bodies.ask("moving")


@pytest.mark.parametrize("lease", [10.0])
def test_a_run_delayed_by_a_short_cut_is_refused(field: Field, namespaces: Namespaces) -> None:
    """The links outlive the cut, and deliver afterwards what was asked during it."""
    a, b = field["a"], field["b"]
    start(field)
    a.await_presences(**ALL_ALIVE)
    late = a.talk([sys.executable, "-m", "tests.swarm.late_operator", str(a.swarm.config)])
    assert late.ask("look") == {"seen": ["r1", "r2", "r3", "r4"]}
    local = b.swarm.begin("run", "drive", "r3", "r4", user="ben")
    assert b.swarm.finish(local).code == 0
    b.bodies.ask("moving")

    namespaces.cut("b")
    late.say("run 5")
    stopping = b.swarm.begin("stop", "r3", "r4", user="ben")
    b.bodies.ask("standing")
    b.bodies.ask("mark")
    namespaces.heal("b")
    answers = late.hear()
    assert {name: answer and answer[0] for name, answer in answers.items()} == {
        "r1": "applied",
        "r2": "applied",
        "r3": "refused",
        "r4": "refused",
    }
    assert answers["r3"][1].startswith("robot changed since you looked, by ben@")
    assert b.swarm.finish(stopping).code == 0
    assert not any(b.bodies.ask("mark")["mark"].values())


@pytest.mark.parametrize("robots", [{"a": ("r1",), "b": ("r1",)}])
def test_an_id_on_both_sides_of_a_cut_is_faulted_after_it_heals(
    field: Field, namespaces: Namespaces
) -> None:
    namespaces.cut("b")
    start(field)
    sides = list(field.values())
    runs = [side.swarm.begin("run", "drive", "r1") for side in sides]
    for side, run in zip(sides, runs, strict=True):
        assert side.swarm.finish(run).code == 0
        side.bodies.ask("moving")

    healed = time.monotonic()
    namespaces.heal("b")
    for side in sides:
        side.bodies.ask("standing")
    print(f"both stand {time.monotonic() - healed:.1f} s after the cut has healed")
    for side in sides:
        wait_until(
            lambda: "duplicate_id" in side.swarm.ctl("describe", "r1").out,  # noqa: B023
            "it says why",
        )
        side.bodies.ask("standing")
        side.bodies.ask("mark")
    for side in sides:
        note = "# two daemons have one id: r1; stop one of each"
        wait_until(lambda: note in side.swarm.ctl("members").out, "both are met")  # noqa: B023
        assert side.swarm.ctl("run", "drive", "r1").code == 7
    for side in sides:
        assert not any(side.bodies.ask("mark")["mark"].values())
