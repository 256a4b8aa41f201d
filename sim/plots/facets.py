"""Which panel of a figure a variant of a parameter sweep belongs to, and its name there."""

from __future__ import annotations

from dataclasses import dataclass

from swarmd.core.errors import ConfigError, unknown
from swarmd.sim.experiments.plan import Plan, shown


@dataclass(frozen=True, slots=True)
class Facet:
    """The panel of a variant, empty without facets, and what distinguishes it in the panel."""

    panel: str
    label: str


def facets_of(plan: Plan, key: str | None, alone: str) -> dict[str, Facet]:
    """The facet of each variant by its name.

    With a swept `key`, or its last part, there is a panel for each of its values. `alone` is the
    label of a variant that nothing else distinguishes. ConfigError with the nearest key if it was
    not swept.
    """
    if key is None:
        return {one.name: Facet("", one.name or alone) for one in plan.variants}
    short = {name.rpartition(".")[2]: name for name in plan.sweep}
    full = key if key in plan.sweep else short.get(key)
    if full is None:
        if not plan.sweep:
            raise ConfigError(f"--facet {key}: nothing was swept; run with --sweep {key}=A,B")
        raise ConfigError(f"--facet: {unknown('swept key', key, (*plan.sweep, *short))}")
    own = full.rpartition(".")[2]
    found = {}
    for one in plan.variants:
        rest = [
            f"{name.rpartition('.')[2]}={shown(value)}"
            for name, value in one.values.items()
            if name != full
        ]
        found[one.name] = Facet(f"{own}={shown(one.values[full])}", ",".join(rest) or alone)
    return found
