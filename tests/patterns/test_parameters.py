"""The parameters of every built-in pattern."""

from __future__ import annotations

import pytest

from swarmd.kit.factory import full_layers
from swarmd.kit.params import build, schema
from swarmd.pattern_host.loader import PatternLoader
from swarmd.plugins import pattern_names
from swarmd.settings.settings import load_platform, platform_names

FOUND = {name: o for name, o in pattern_names(None).items() if o.value.startswith("swarmd.")}
FIND = PatternLoader({name: (origin.value, False) for name, origin in FOUND.items()})
# Numbers that are counts, shares or weights.
WITHOUT_UNIT = {
    "bias",
    "black",
    "bright",
    "dark",
    "enough",
    "cruise",
    "initial",
    "opinions",
    "rays",
    "surge",
}
WITHOUT_UNIT |= {
    "band",
    "concavity",
    "coupling",
    "exponent",
    "refractory",
    "steepness",
    "stop",
    "white",
}
WITHOUT_UNIT |= {"cohesion", "flight", "pace", "social", "strongest"}


@pytest.mark.parametrize("name", FOUND)
def test_each_parameter_has_a_description_a_source_and_a_unit(name: str) -> None:
    for spec in schema(FIND(name).params_type):
        assert spec.description
        assert spec.source, f"{name}.{spec.name} names no source"
        is_number = spec.type in ("int", "float") and spec.name not in WITHOUT_UNIT
        assert not is_number or spec.unit, f"{name}.{spec.name} has no unit"


@pytest.mark.parametrize("platform", platform_names())
def test_pattern_parameters_of_platform_files_and_derived_defaults_are_valid(platform: str) -> None:
    robot = load_platform(platform)
    for name in FOUND:
        kind = FIND(name)
        layers = (("platform", robot.patterns.get(name, {})),)
        _, sources = build(kind.params_type, full_layers(kind, robot, layers))
        given = set(robot.patterns.get(name, {}))
        of_platform = {key for key, (_, source) in sources.items() if source == "platform"}
        assert of_platform == given, f"{name} on {platform}"


@pytest.mark.parametrize(
    ("pattern", "platform", "reach"),
    [
        ("attraction", "burger", 2.0),
        ("attraction", "waffle_pi", 2.0),
        ("attraction", "jackal", 3.0),
        ("dispersion", "burger", 3.5),
        ("dispersion", "waffle_pi", 3.5),
        ("dispersion", "jackal", 4.0),
    ],
)
def test_original_laws_keep_their_range(pattern: str, platform: str, reach: float) -> None:
    robot = load_platform(platform)
    kind = FIND(pattern)
    layers = full_layers(kind, robot, (("platform", robot.patterns.get(pattern, {})),))
    _, params = build(kind.params_type, layers)
    assert params["paper_range"][0] == reach
