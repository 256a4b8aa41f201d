"""Files of a scenario for a live world and its daemons, and the check that it can run live."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msgspec import to_builtins

from swarmd.core.errors import ConfigError
from swarmd.core.values import Platform
from swarmd.settings.yamlfile import text_of
from swarmd.sim.scenarios.scenario import Scenario
from swarmd.sim.world.detector import DETECTIONS
from swarmd.sim.world.radio import RadioSettings
from swarmd.sim.world.realism import configured

SCENARIO_FILE = "scenario.json"


@dataclass(frozen=True, slots=True, eq=False)
class LiveScenario:
    """A scenario whose robots are daemons."""

    scenario: Scenario

    def write(self, folder: Path) -> None:
        """Write the effective scenario, and its platforms with the sensors that it adds."""
        scenario = self.scenario
        (folder / SCENARIO_FILE).write_text(json.dumps(scenario.effective, indent=1))
        (folder / "platforms").mkdir(exist_ok=True)
        for platform in {platform.name: platform for platform in scenario.robots.values()}.values():
            path = _platform_path(folder, platform)
            path.write_text(text_of(self._platform_file(platform)), "utf-8")

    def daemon_config(self, robot: str, folder: Path) -> dict[str, object]:
        """The keys of the daemon's file that the scenario sets; `write` has written to `folder`."""
        scenario = self.scenario
        own: dict[str, dict[str, Any]] = {}
        _, *layers = scenario.parameters[robot].base  # the daemon reads those of the platform
        for _, parameters in layers:
            for pattern, values in parameters.items():
                own[pattern] = {**own.get(pattern, {}), **values}
        return {
            "platform": str(_platform_path(folder.absolute(), scenario.robots[robot])),
            "labels": {name: list(ids) for name, ids in scenario.groups.items()},
            "parameters": {"robots": {robot: own}},
            **to_builtins(scenario.settings[robot]),
        }

    def _platform_file(self, platform: Platform) -> dict[str, Any]:
        own = configured(platform, self.scenario.realism)
        scan = own.scan
        ring = own.ranges
        file = dict(self.scenario.effective["platforms"][platform.name])
        file["provides"] = sorted(platform.provides - {DETECTIONS})  # the driver's options give it
        file["scan"] = {**file["scan"], "noisy": scan.is_noisy}
        if scan.sweep is None:
            file["scan"] |= {"sweep": None}
        if ring is not None:
            file["ranges"] = {**file["ranges"], "noisy": ring.is_noisy}
        return file


def _platform_path(folder: Path, platform: Platform) -> Path:
    return folder / "platforms" / f"{platform.name}.yaml"


def check_live(scenario: Scenario, most: int, emulator: str | None = None) -> None:
    """Raise ConfigError for the first key of a scenario that a live run cannot carry out.

    `most`: the greatest number of robots whose daemons one machine can run.
    """
    for key, why in _impossible(scenario, most, emulator):
        raise ConfigError(f"scenario {scenario.name}: {key}: {why}")


def _impossible(scenario: Scenario, most: int, emulator: str | None) -> Iterator[tuple[str, str]]:
    count = len(scenario.robots)
    if count > most:
        text = f"{count} robots; a live run has at most {most}, each with a daemon"
        yield "groups", f"{text}: lower the counts with --set, or use swarmctl exp run"
    if scenario.pseudo_reality:
        yield "pseudo_reality", "is for lockstep alone; leave it out, or use swarmctl exp run"
    if emulator is None:
        return
    default = RadioSettings()
    faults = [event.fault for event in scenario.events if event.fault is not None]
    if any(fault.carried_by == "radio" for fault in faults):
        text = f"emulated robots ({emulator}) have no simulated radio; leave --emulate out"
        yield "events", f"fault of radio: {text}"
    for key in RadioSettings.__struct_fields__:
        if getattr(scenario.radio, key) != getattr(default, key):
            text = f"emulated robots ({emulator}) have no simulated radio; leave --emulate out"
            yield f"radio.{key}", text
    for platform in scenario.robots.values():
        if platform.protection["mode"] == "off":
            text = f"off is for driver simulated, not for {emulator}; leave --emulate out"
            yield f"platforms.{platform.name}.protection.mode", text
