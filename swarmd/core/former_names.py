"""The names that modules had before they moved into rooms by who runs them.

`import` of a former name gives the same module, so that scripts, plugins and recordings of 0.2.0
keep working. A new module has no former name, and is not listed: a row is a package that moved, or
a module of 0.2.0 that left its package.
`swarmd/__init__.py` installs the finder, which Python asks before
it looks for a file: in a package that moved it would find a second copy of the module.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from importlib.abc import Loader

FORMER: Mapping[str, str] = {
    "swarmd.acceptance": "swarmd.operator.acceptance",
    "swarmd.calibration": "swarmd.operator.calibration",
    "swarmd.cli": "swarmd.operator.cli",
    "swarmd.cli.acceptance": "swarmd.operator.verbs.acceptance.command",
    "swarmd.cli.acceptance_robot": "swarmd.operator.verbs.acceptance.tested_robot",
    "swarmd.cli.apply": "swarmd.operator.verbs.apply.command",
    "swarmd.cli.doctor": "swarmd.operator.verbs.doctor.command",
    "swarmd.cli.events": "swarmd.operator.verbs.events.command",
    "swarmd.cli.goal": "swarmd.operator.verbs.goal.command",
    "swarmd.cli.incidents": "swarmd.operator.verbs.incidents.command",
    "swarmd.cli.label": "swarmd.operator.verbs.label.command",
    "swarmd.cli.members": "swarmd.operator.verbs.members.command",
    "swarmd.cli.param": "swarmd.operator.verbs.param.command",
    "swarmd.cli.plugin_push": "swarmd.operator.verbs.push.command",
    "swarmd.cli.record": "swarmd.operator.verbs.record.command",
    "swarmd.cli.run": "swarmd.operator.verbs.run.command",
    "swarmd.cli.run_lease": "swarmd.operator.verbs.run.command",
    "swarmd.cli.stop_and_reset": "swarmd.operator.verbs.stop.command",
    "swarmd.cli.wait": "swarmd.operator.verbs.wait.command",
    "swarmd.client": "swarmd.operator.client",
    "swarmd.client.apply_plan": "swarmd.operator.verbs.apply.ask",
    "swarmd.client.arguments": "swarmd.operator.session.targets",
    "swarmd.client.ask_robots": "swarmd.operator.session.session",
    "swarmd.client.canary": "swarmd.operator.verbs.run.canary",
    "swarmd.client.changes": "swarmd.operator.verbs.label.ask",
    "swarmd.client.event_feed": "swarmd.operator.verbs.events.feed",
    "swarmd.client.events": "swarmd.operator.verbs.events.ask",
    "swarmd.client.goals": "swarmd.operator.verbs.goal.ask",
    "swarmd.client.incidents": "swarmd.operator.verbs.incidents.ask",
    "swarmd.client.input_watch": "swarmd.operator.session.clocks",
    "swarmd.client.known_robots": "swarmd.operator.session.targets",
    "swarmd.client.members": "swarmd.operator.verbs.members.ask",
    "swarmd.client.run_lease": "swarmd.operator.verbs.run.lease",
    "swarmd.client.runs": "swarmd.operator.verbs.run.ask",
    "swarmd.client.session": "swarmd.operator.session.session",
    "swarmd.client.states": "swarmd.operator.session.states",
    "swarmd.client.stops": "swarmd.operator.verbs.stop.ask",
    "swarmd.client.swarm_watch": "swarmd.operator.session.looks",
    "swarmd.client.targets": "swarmd.operator.session.targets",
    "swarmd.client.waits": "swarmd.operator.verbs.wait.ask",
    "swarmd.kin": "swarmd.robot.kin",
    "swarmd.network": "swarmd.link",
    "swarmd.network.operator": "swarmd.operator.session",
    "swarmd.network.operator.arrivals": "swarmd.operator.session.clocks",
    "swarmd.network.operator.clock_query": "swarmd.operator.session.clocks",
    "swarmd.network.operator.loop_watch": "swarmd.operator.session.clocks",
    "swarmd.network.operator.member_search": "swarmd.operator.session.looks",
    "swarmd.network.operator.operator_admission": "swarmd.operator.session.roster",
    "swarmd.network.operator.operator_datagrams": "swarmd.operator.session.carriers",
    "swarmd.network.operator.operator_goals": "swarmd.operator.session.session",
    "swarmd.network.operator.operator_sessions": "swarmd.operator.session.carriers",
    "swarmd.network.operator.operator_text": "swarmd.operator.session.targets",
    "swarmd.network.operator.repeat_timer": "swarmd.operator.session.clocks",
    "swarmd.network.operator.request_sender": "swarmd.operator.session.senders",
    "swarmd.network.operator.robot_clocks": "swarmd.operator.session.clocks",
    "swarmd.network.operator.roster_follower": "swarmd.operator.session.roster",
    "swarmd.network.operator.round_trips": "swarmd.operator.session.clocks",
    "swarmd.network.operator.seen_member": "swarmd.operator.session.member_reports",
    "swarmd.network.operator.status_table": "swarmd.operator.session.member_reports",
    "swarmd.network.operator.stop_origin": "swarmd.operator.session.senders",
    "swarmd.network.operator.stop_request": "swarmd.operator.session.senders",
    "swarmd.network.operator.stop_sender": "swarmd.operator.session.senders",
    "swarmd.protection": "swarmd.robot.protection",
    "swarmd.recording": "swarmd.daemon.recording",
    "swarmd.replay": "swarmd.operator.replay",
    "swarmd.security": "swarmd.link.keys",
    "swarmd.sensing": "swarmd.robot.sensing",
    "swarmd.steering": "swarmd.robot.steering",
    "swarmd.texts": "swarmd.operator.texts",
    "swarmd.texts.awaited": "swarmd.operator.verbs.wait.words",
    "swarmd.texts.goal": "swarmd.operator.verbs.goal.words",
    "swarmd.texts.labels": "swarmd.operator.verbs.label.words",
    "swarmd.texts.members": "swarmd.operator.verbs.members.words",
    "swarmd.view": "swarmd.operator.view",
}
"""By the former name of a package or a module, its present name."""


def present_name(module: str) -> str:
    """The present name of a module: `swarmd.kin.kin` is `swarmd.robot.kin.kin`."""
    package = module
    while package:
        if package in FORMER:
            return FORMER[package] + module[len(package) :]
        package = package.rpartition(".")[0]
    return module


class FormerNameFinder:
    """Finds modules by their former names; nothing else."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """What gives the module of a former name; None for any other name."""
        present = present_name(name) if name.startswith("swarmd.") else name
        if present == name:
            return None
        return ModuleSpec(name, cast("Loader", _FormerNameLoader(present)))


class _FormerNameLoader:
    """Gives the module that has moved, as itself and not as a copy."""

    def __init__(self, present: str) -> None:
        self._present = present
        self._spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """The module under its present name. ModuleNotFoundError if there is none."""
        module = import_module(self._present)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Nothing is executed again; the module keeps the spec of its present name."""
        module.__spec__ = self._spec

    def get_code(self, name: str) -> CodeType | None:
        """The code of the module, for `python -m`; None if it is compiled."""
        from importlib.abc import InspectLoader  # each `import swarmd` runs this file
        from importlib.util import find_spec

        spec = find_spec(self._present)
        if spec is None or not isinstance(spec.loader, InspectLoader):
            return None
        return spec.loader.get_code(self._present)


def install_former_names() -> None:
    """Let `import` find former names, from now on in this process."""
    if FormerNameFinder not in sys.meta_path:
        sys.meta_path.insert(0, FormerNameFinder)
