"""How many examples the properties are tried with: profiles of hypothesis."""

from __future__ import annotations

from hypothesis import Phase, settings

# A machine may be busy: how long an example takes is no property.
settings.register_profile("calm", deadline=None)
# Whether a mechanism is missing shows soon; which example shows it best does not matter.
settings.register_profile(
    "mutants",
    deadline=None,
    derandomize=True,
    max_examples=25,
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile("calm")
