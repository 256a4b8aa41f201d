"""Where nodes lie: beside a scenario, in a folder of a pattern, and in a folder that is pushed."""

from __future__ import annotations

import asyncio
import hashlib
import importlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from swarmd.core.errors import ConfigError, PluginError
from swarmd.core.host_messages import HostCommand, HostEvent, Load, Loaded, Step, Stepped
from swarmd.core.values import Inputs, Twist
from swarmd.kit.behavior import Context
from swarmd.pattern_host.loader import PatternLoader
from swarmd.pattern_host.plugin_inspector import sources_of
from swarmd.pattern_host.runner import ProcessRunner
from swarmd.pattern_host.wheel import inspect_wheel, packed_folder
from swarmd.patterns.ros2_nodes.pattern import Ros2Nodes
from swarmd.plugins import IN_WHEEL
from swarmd.ros2_nodes.pattern import Ros2NodesParams
from tests.support.ros2_nodes import BURGER, written

PATTERN = """
from swarmd.ros2_nodes.pattern import Ros2NodesPattern


class Driver(Ros2NodesPattern):
    launch = "nodes.yaml"
"""
LAUNCH = "nodes: [{run: timer_driver, parameters: driver.yaml}]"
PARAMETERS = "timer_driver: {ros__parameters: {speed: 0.2}}"


@pytest.fixture
def driver(tmp_path: Path) -> Path:
    """The folder of a pattern `driver`, with its nodes below and a launch file beside it."""
    folder = written(tmp_path / "plugins" / "driver")
    own = {
        "pattern.py": PATTERN,
        "nodes.yaml": "path: [., walls]\n" + LAUNCH,
        "driver.yaml": f"/**: {{{PARAMETERS.partition('{')[2]}",
    }
    return written(folder, own)


def context(seed: int = 0) -> Context:
    return Context("tb3-01", BURGER, np.random.default_rng(seed))


def third_twist(pattern: object) -> Twist | None:
    for at in (0.0, 0.2):
        pattern.step(Inputs(now=at, dt=0.1))  # type: ignore[attr-defined]
    twist: Twist | None = pattern.step(Inputs(now=0.3, dt=0.1)).twist  # type: ignore[attr-defined]
    return twist


def test_a_folder_of_a_pattern_has_its_launch_file_beside_it(driver: Path) -> None:
    kind = PatternLoader({"driver": (str(driver / "pattern.py"), True)})("driver")
    assert third_twist(kind(kind.params_type(), context())) == Twist(0.2, 1.0)


@pytest.fixture
def imports() -> Iterator[None]:
    """The import path and the modules of pushed code are as before afterwards."""
    path = [*sys.path]
    yield
    sys.path[:] = path
    for name in [name for name in sys.modules if name.startswith("swarmd_pushed_")]:
        del sys.modules[name]
    importlib.invalidate_caches()


@pytest.mark.usefixtures("imports")
def test_a_pushed_folder_runs_from_the_wheel_alone(driver: Path, tmp_path: Path) -> None:
    content = packed_folder(driver, "driver")
    value = inspect_wheel(content, "driver").value
    wheel = tmp_path / "driver.whl"
    wheel.write_bytes(content)
    shutil.rmtree(driver)
    loader = PatternLoader({})
    digest = hashlib.sha256(content).digest()
    loader.begin({"driver": (f"{wheel}{IN_WHEEL}{value}", False)}, {"driver": digest})
    kind = loader("driver")
    assert third_twist(kind(kind.params_type(), context())) == Twist(0.2, 1.0)


def test_the_nodes_beside_a_pattern_are_no_modules_of_it(driver: Path) -> None:
    """They may import time and threading, for which they get stand-ins; `plugin check` says so."""
    assert sources_of(driver / "pattern.py") == [driver / "pattern.py"]


def test_the_example_runs_without_a_launch_file() -> None:
    pattern = Ros2Nodes(Ros2NodesParams(), context())
    assert pattern.needs == {"scan"}
    assert pattern.channels == {}


@pytest.mark.parametrize(
    ("launch", "named"),
    [("nowhere/nodes.yaml", "nodes.yaml"), (".", "driver"), ("nodes.py", "nodes.py")],
)
def test_a_launch_file_that_is_not_there_is_named(driver: Path, launch: str, named: str) -> None:
    with pytest.raises((ConfigError, PluginError), match=named):
        Ros2Nodes(Ros2NodesParams(launch=str(driver / launch)), context())


def test_the_launch_file_stays_during_a_run(driver: Path) -> None:
    pattern = Ros2Nodes(Ros2NodesParams(), context())
    with pytest.raises(ConfigError, match="launch"):
        pattern.update(Ros2NodesParams(launch=str(driver / "nodes.yaml")))
    pattern.update(Ros2NodesParams(recovery=True))


@pytest.mark.integration
def test_a_pattern_host_runs_the_nodes_of_its_plugin_folder_in_its_sandbox(driver: Path) -> None:
    """And none that lie elsewhere: the kernel denies the file, and the line says where it may lie.

    A kernel without Landlock denies nothing, and is no part of this test.
    """

    async def run() -> None:
        woken = asyncio.Event()
        runner = ProcessRunner(asyncio.get_running_loop(), driver.parent, woken.set)

        async def answer(command: HostCommand) -> HostEvent:
            runner.send(command)
            async with asyncio.timeout(60.0):
                while not (found := list(runner.events())):
                    woken.clear()
                    await woken.wait()
            return found[0]

        try:
            loaded = await answer(Load(1, "driver", (), "r1", BURGER, 1))
            assert isinstance(loaded, Loaded), loaded
            for at in (5.0, 5.2, 5.3):
                stepped = await answer(Step(1, Inputs(now=at, dt=0.1)))
            assert isinstance(stepped, Stepped)
            assert stepped.outputs.twist == Twist(0.2, 1.0)
            elsewhere = written(driver.parent.parent / "other") / "all.yaml"
            layers = (("request", {"launch": str(elsewhere)}),)
            refused = await answer(Load(2, "ros2_nodes", layers, "r1", BURGER, 1))
            if runner.sandbox is not None and "files" in runner.sandbox.denied:
                assert "plugin_dir" in getattr(refused, "text", "")
        finally:
            runner.close()

    asyncio.run(run())
