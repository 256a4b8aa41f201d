"""The world's process: ready line, ends, and a driver's session."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from swarmd.core.values import Twist
from swarmd.drivers.simulated import SimulatedDriver
from swarmd.settings.platforms import load_platform
from swarmd.sim.live.link import WorldView
from swarmd.sim.live.server import main
from swarmd.sim.live.state import WorldState
from swarmd.sim.metrics.kinematics import path_lengths
from swarmd.sim.trace import load_trace
from swarmd.testing.driver_contract import CollectingSink
from tests.support.processes import attempts

CAP = 30.0
SERVER = (sys.executable, "-m", "swarmd.sim.live.server")
ROBOTS = {"a": "waffle_pi", "b": "burger"}


def options(**changes: Any) -> str:
    """The options of a world of two robots."""
    return json.dumps({"swarm": "s", "robots": ROBOTS, "layout": "list:0:0:0,0:2:0", **changes})


@contextmanager
def world(**changes: Any) -> Iterator[tuple[subprocess.Popen[bytes], str, str]]:
    """A running world, and its endpoints for viewers and for drivers."""
    command = [*SERVER, options(**changes)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            ready = json.loads(process.stdout.readline())
            yield process, ready["endpoint"], ready["driver_options"]["endpoint"]
        finally:
            process.kill()


def speed(sink: CollectingSink) -> float:
    return sink.odometries[-1].twist.linear if sink.odometries else 0.0


def check(sink: CollectingSink) -> None:
    """All came whole; a slow machine may leave some out."""
    assert [what for what in sink.lost if not what.endswith(":overtaken")] == []


@pytest.mark.integration
def test_a_robot_follows_its_driver_and_stops_when_commands_end(
    tmp_path: Path,
) -> None:
    trace = tmp_path / "run.npz"

    async def story(viewers: str, endpoint: str) -> None:
        heard = CollectingSink()
        driver = SimulatedDriver(
            swarm="s", robot="a", platform=load_platform("waffle_pi"),
            options={"endpoint": endpoint},
        )  # fmt: skip
        task = asyncio.create_task(driver.run(heard))
        with WorldView("s", viewers) as view:
            async with asyncio.timeout(CAP):
                while not heard.scans:
                    await asyncio.sleep(0.01)
                started = await asyncio.to_thread(view.ask, "start")
                while speed(heard) < 0.19:  # the first one is sent as zero, so once would not do
                    driver.send(Twist(0.2), heard.scans[-1].seq, -1)
                    await asyncio.sleep(0.01)
                # Silence; a base that a stall cut off gets zero once more when it is back.
                while any((await asyncio.to_thread(view.ask, "poses")).state.commanded):
                    await asyncio.sleep(0.05)
                while speed(heard) > 0.0:
                    await asyncio.sleep(0.01)
                done = await asyncio.to_thread(view.ask, "finish")
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert started.state.poses[0][0] == 0.0
        assert done.state.poses[0][0] > 0.0
        assert Path(done.path) == trace
        assert not any(done.state.commanded)
        check(heard)

    with world(trace=str(trace)) as (_, viewers, endpoint):
        asyncio.run(story(viewers, endpoint))
    run = load_trace(trace)
    assert run.meta["layout"] == "list:0:0:0,0:2:0"
    way = path_lengths(run)
    assert way[0] == pytest.approx(run.pose[-1, 0, 0], abs=1e-3)  # straight ahead
    assert way[1] == 0.0


_DRIVE = """
import asyncio, sys
from swarmd.drivers.simulated import SimulatedDriver
from swarmd.settings.platforms import load_platform
from swarmd.testing.driver_contract import CollectingSink
from swarmd.core.values import Twist

async def drive():
    driver = SimulatedDriver(swarm="s", robot="a", platform=load_platform("waffle_pi"),
                             options={"endpoint": sys.argv[1]})
    heard = CollectingSink()
    task = asyncio.create_task(driver.run(heard))
    while True:
        driver.send(Twist(0.0, 0.5), heard.scans[-1].seq if heard.scans else -1, -1)
        await asyncio.sleep(0.05)

asyncio.run(drive())
"""


def turns(state: WorldState) -> bool:
    """Whether the second robot follows its commands."""
    return state.commanded[1] and abs(state.twists[1][1] - 0.5) < 1e-6


@pytest.mark.integration
def test_a_frozen_driver_stops_its_own_base_and_no_other() -> None:
    async def story(viewers: str, endpoint: str, frozen: subprocess.Popen[bytes]) -> bool:
        """False if the driver lost its base meanwhile, as after a stall of the world."""
        heard = CollectingSink()
        driver = SimulatedDriver(
            swarm="s", robot="b", platform=load_platform("burger"), options={"endpoint": endpoint}
        )
        task = asyncio.create_task(driver.run(heard))
        with WorldView("s", viewers) as view:
            async with asyncio.timeout(CAP):
                while not (await asyncio.to_thread(view.ask, "poses")).state.commanded[0]:
                    await asyncio.sleep(0.05)
                frozen.send_signal(signal.SIGSTOP)
                while not heard.odometries:
                    await asyncio.sleep(0.01)
                start = heard.odometries[-1].stamp
                # Long enough for the frozen one's buffers to fill: 25 odometries, 5 scans a second.
                asking = None
                while asking is None or not asking.done():  # asked while it drives
                    seq = heard.scans[-1].seq if heard.scans else -1
                    driver.send(Twist(0.0, 0.5), seq, -1)
                    await asyncio.sleep(0.01)
                    if asking is not None and asking.done() and not turns(asking.result().state):
                        asking = None  # commands came late
                    if asking is None and heard.odometries[-1].stamp - start >= 4.0:
                        asking = asyncio.create_task(asyncio.to_thread(view.ask, "poses"))
                state = asking.result().state
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        assert state.commanded == (False, True)
        assert state.twists[0] == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        assert state.twists[1][1] == pytest.approx(0.5)
        check(heard)
        return all(is_up for is_up, _ in heard.states[1:])  # after the first `not yet`, never lost

    with (
        world() as (_, viewers, endpoint),
        subprocess.Popen([sys.executable, "-c", _DRIVE, endpoint]) as frozen,
    ):
        try:
            for _ in attempts("the driver never loses its base"):
                if asyncio.run(story(viewers, endpoint, frozen)):
                    break
                frozen.send_signal(signal.SIGCONT)
        finally:
            frozen.kill()


@pytest.mark.integration
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.evidence)]
)
def test_a_signal_ends_it_and_writes_the_trace(tmp_path: Path, number: signal.Signals) -> None:
    trace = tmp_path / "run.npz"
    with world(trace=str(trace), radio_range=1.5, realism="realistic") as (process, viewers, _):
        with WorldView("s", viewers) as view:
            reply = view.ask("poses")
        process.send_signal(number)
        assert process.wait(CAP) == 0
    assert reply.state.ids == ("a", "b")
    assert reply.state.poses[1][1] == pytest.approx(2.0)
    run = load_trace(trace)
    assert len(run.t) > 0
    assert (run.meta["realism"], run.meta["arena"]) == ("realistic", "6x6")
    assert (run.meta["radio"]["neighborhood"], run.meta["radio"]["range"]) == ("range", 1.5)
    assert run.meta["v_max"] == {"waffle_pi": 0.26, "burger": 0.22}
    assert run.meta["thresholds"] == {"waffle_pi": 0.5, "burger": 0.5}


@pytest.mark.integration
def test_it_does_not_outlive_its_parent(tmp_path: Path) -> None:
    # The parent in between starts the world, tells its id, and is then killed.
    parent_code = (
        "import os, subprocess, sys;"
        f"p = subprocess.Popen([*{[*SERVER, options()]!r},"
        "'--die-with-parent', str(os.getpid())], stdout=subprocess.PIPE);"
        "p.stdout.readline(); print(p.pid, flush=True); p.wait()"
    )
    with subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        watch = os.pidfd_open(child)
        parent.kill()
        try:
            asyncio.run(_ended(watch))
        finally:
            with contextlib.suppress(ProcessLookupError):  # gone, as it should be
                signal.pidfd_send_signal(watch, signal.SIGKILL)
            os.close(watch)


async def _ended(pidfd: int) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.add_reader(pidfd, ended.set)
    async with asyncio.timeout(CAP):
        await ended.wait()
    loop.remove_reader(pidfd)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"robots": {"a": "wafle_pi"}}, "'waffle_pi'"),
        ({"robots": {"A": "burger"}}, "'A'"),
        ({"robots": "a:burger"}, "robots"),
        ({"robots": {}}, "robots"),
        ({"arena": "big"}, "6x6"),
        ({"layout": "row:0.1"}, "robot 1"),
        ({"endpoint": "here"}, "endpoint"),
        ({"radio_range": -1.0}, "radio_range"),
        ({"colour": "red", "robots": {}}, "colour"),
    ],
)
def test_an_invalid_option_is_one_line_and_exit_code_2(
    changes: dict[str, Any], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([options(**changes)]) == 2
    said = capsys.readouterr()
    assert complaint in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""
