"""The names that modules had at e0319367, by which pages and examples of others import them."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from types import CodeType
from typing import Any

import pytest

from swarmd.core.former_names import FORMER, FormerNameFinder, present_name
from swarmd.robot.memory import _class_named
from swarmd.testing.no_side_effects import forbidden_imports

# By `git show e0319367`: each module that a page or an example imports, and those that authors use.
PUBLIC = (
    "swarmd.api",
    "swarmd.core.errors",
    "swarmd.core.events",
    "swarmd.core.finding",
    "swarmd.core.values",
    "swarmd.driver_api",
    "swarmd.driver_api.command_gate",
    "swarmd.driver_api.driver",
    "swarmd.kit.observation",
    "swarmd.kit.policy_network",
    "swarmd.sim.cli.progress",
    "swarmd.sim.experiments.compare",
    "swarmd.sim.experiments.results",
    "swarmd.sim.experiments.simulate",
    "swarmd.sim.experiments.statistics",
    "swarmd.sim.experiments.tune",
    "swarmd.sim.learning",
    "swarmd.sim.learning.environment",
    "swarmd.sim.learning.vector",
    "swarmd.sim.metrics.own",
    "swarmd.sim.plots",
    "swarmd.sim.plots.figures",
    "swarmd.sim.plots.theme",
    "swarmd.sim.trace",
    "swarmd.testing",
    "swarmd.testing.driver_contract",
)
# By `git show e0319367`: modules that have moved since, one of each package.
MOVED = (
    "swarmd.network.operator.outcome",
    "swarmd.network.peer",
    "swarmd.security.roster",
    "swarmd.sensing.conditioning",
    "swarmd.protection.barrier",
    "swarmd.steering.recovery",
    "swarmd.kin.kin",
    "swarmd.recording.reader",
    "swarmd.acceptance.steps",
    "swarmd.calibration.pattern",
    "swarmd.client.swarm",
    "swarmd.cli.entry",
    "swarmd.replay.replay",
    "swarmd.texts.why",
    "swarmd.view.source",
)
# Modules of 0.2.0 that left their package.
MODULES_OF_PACKAGES = {name for name in FORMER if name.rpartition(".")[0] in FORMER} - {
    "swarmd.network.operator"
}


@pytest.mark.parametrize("name", [*PUBLIC, *MOVED])
def test_a_name_of_0_2_0_is_imported(name: str) -> None:
    module = import_module(name)
    assert module is sys.modules[present_name(name)]
    assert module.__spec__ is not None
    assert module.__spec__.name == module.__name__ == present_name(name)


def test_each_row_of_the_table_is_tried() -> None:
    packages = {name.rpartition(".")[0] for name in MOVED}
    assert packages | MODULES_OF_PACKAGES == FORMER.keys()


@pytest.mark.parametrize("name", sorted(MODULES_OF_PACKAGES))
def test_a_module_that_left_its_package_is_imported(name: str) -> None:
    """These rows go on from packages that moved: `swarmd.client.stops` is not in `client`."""
    assert import_module(name) is sys.modules[FORMER[name]]


def test_an_unknown_name_in_a_former_package_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError):
        import_module("swarmd.protection.no_such_module")
    assert present_name("swarmd.protections.x") == "swarmd.protections.x"


def test_a_program_starts_by_a_former_name() -> None:
    """As `python -m swarmd.cli.daemon` of a script."""
    code = get_code("swarmd.cli.daemon")
    assert code is not None
    assert code.co_filename == import_module("swarmd.operator.cli.daemon").__file__


def get_code(name: str) -> CodeType | None:
    """What `python -m` would execute."""
    spec = FormerNameFinder.find_spec(name)
    assert spec is not None
    loader: Any = spec.loader
    code: CodeType | None = loader.get_code(name)
    return code


def test_a_recording_names_classes_as_they_were() -> None:
    found = _class_named("swarmd.sensing.conditioning.ScanConditioner")
    assert found.__module__ == "swarmd.robot.sensing.conditioning"


def test_a_recording_names_no_other_class_by_a_former_name() -> None:
    with pytest.raises(ValueError, match="no part"):
        _class_named("swarmd.network.peer.Peer")


@pytest.mark.parametrize("package", ["swarmd.network", "swarmd.link", "swarmd.operator.cli"])
def test_a_pattern_imports_the_network_by_no_name(package: str) -> None:
    assert [*forbidden_imports(f"import {package}.x".encode())] == [(1, f"{package}.x")]


@pytest.mark.integration
def test_a_kernel_is_compiled_or_not_by_both_names() -> None:
    code = (
        "import swarmd.protection.barrier as former, swarmd.robot.protection.barrier as present;"
        "assert former is present"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
