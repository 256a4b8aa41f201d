"""The option `services`: the services by which ROS runs and resets this robot."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from typing import Annotated, Literal

from msgspec import Meta, Struct

from swarmd.core.bounds import Id, ParamValues, Word
from swarmd.core.errors import ConfigError
from swarmd.driver_api.command_source import DeclaredRun, DriverCommand

MAX_RUNS = 32
RESET = "swarmd/reset"
RUN = "swarmd/run"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


class RunOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A run that a service starts; `seconds`: its duration, `until`: conditions of its end."""

    pattern: Id
    params: ParamValues = {}
    seconds: Annotated[float, Meta(gt=0.0, le=1e7)] | None = None
    until: tuple[Word, ...] = ()


class ServiceOptions(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The services, each of type std_srvs/Trigger.

    - `operator`: every caller commands as this operator; the audit log has this name.
    - `runs`: the runs by name of their service.
    - `reset`: `own` clears emergency stops of this operator alone.
    """

    operator: Id
    runs: Annotated[dict[str, RunOptions], Meta(max_length=MAX_RUNS)] = {}
    reset: Literal["own", "all"] = "own"

    def commands(self, topic: Callable[[str], str]) -> dict[str, DriverCommand]:
        """The command of each service by its full name, which `topic` gives; ages are not known."""
        runs = {
            f"{RUN}/{name}": DeclaredRun(run.pattern, run.params, run.seconds, run.until)
            for name, run in self.runs.items()
        }
        return {
            (service := topic(name)): DriverCommand(
                verb="reset" if run is None else "run",
                operator=self.operator,
                source=f"ROS service {service}",
                run=run,
                resets_others=self.reset == "all",
            )
            for name, run in {RESET: None, **runs}.items()
        }

    def faults(self) -> Iterator[str]:
        """The texts of the faults of the names of runs, and of their conditions."""
        from swarmd.kit.conditions import parse_conditions  # not for options without services

        for name, run in self.runs.items():
            try:
                if run.until:
                    parse_conditions(run.until)
            except ConfigError as error:
                yield f"services.runs.{name}.until: {error}"
            if _NAME.fullmatch(name) is None:
                yield (
                    f"services.runs has {name!r}; expected a name such as gather_all (letters,"
                    " digits and _, a letter first)"
                )
