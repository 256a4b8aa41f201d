"""What ends a run of any pattern beside the pattern itself."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from swarmd.errors import ConfigError
from swarmd.mission.conditions import Condition, needs_of, parse_conditions
from swarmd.mission.watch import Facts, Watch
from swarmd.values import Inputs, Outputs, Platform


class Ending:
    """Watches the steps of a pattern; the first of them is when its time begins."""

    def __init__(self, condition: Condition) -> None:
        self._watch = Watch(condition)
        self._has_begun = False

    def applied(self, inputs: Inputs, outputs: Outputs) -> Outputs:
        """A step's outputs, done if the condition holds after it."""
        if not self._has_begun:
            self._has_begun = True
            self._watch.begin(inputs.now)
        done = () if outputs.done is None else ("",)
        facts = Facts(inputs.now, outputs.report, done, inputs.scan, inputs.readings)
        if not self._watch.is_met(facts) or outputs.done is not None:
            return outputs
        return msgspec.structs.replace(outputs, done=f"until {self._watch.condition}")


def ending_of(until: Sequence[str], platform: Platform) -> Ending | None:
    """What any of these conditions ends; None without one.

    ConfigError if one is none, or needs what the platform does not provide.
    """
    if not until:
        return None
    condition = parse_conditions(until)
    missing = sorted(needs_of(condition) - platform.provides)
    if missing:
        raise ConfigError(
            f"the condition needs {', '.join(missing)}, which {platform.name} does not provide"
        )
    return Ending(condition)
