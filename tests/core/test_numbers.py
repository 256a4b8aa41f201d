"""Numbers in texts: each reader of files and options takes the number that a person sees."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import Any

import click
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from swarmd.core.errors import SwarmError
from swarmd.core.host_messages import REQUEST_LAYER
from swarmd.kit.condition_state import _is_as_wanted as is_as_wanted
from swarmd.kit.conditions import Reported, parse_condition
from swarmd.kit.params import Params, build
from swarmd.operator.cli.canary import read_canary
from swarmd.operator.cli.daemon import _read_options
from swarmd.operator.cli.options import Duration
from swarmd.operator.texts.assignments import read_assignments
from swarmd.settings.layered import read as read_as
from swarmd.settings.yamlfile import read, text_of
from swarmd.sim.cli.exp_results import parse_targets
from swarmd.sim.experiments.plan import parse_seeds, parse_sets, parse_sweeps
from swarmd.sim.experiments.requirements import parse_requirement
from swarmd.sim.experiments.search_space import parse_range
from swarmd.sim.metrics.placed import _numbers
from swarmd.sim.world.arena import parse_arena
from tests.support.examples import examples


class Given(Params, frozen=True):
    """One parameter of each type that numbers are read for."""

    number: float = 0.0
    whole: int = 0
    name: str = ""


def read_file(text: str) -> dict[str, Any]:
    path = Path("read.yaml")
    path.write_text(text)
    return read(path)


def requested(key: str, text: str) -> object:
    return getattr(build(Given, ((REQUEST_LAYER, read_assignments([f"{key}={text}"])),))[0], key)


def until(text: str) -> object:
    condition = parse_condition(f"report:a={text}")
    assert isinstance(condition, Reported)
    return condition.value


READERS: Mapping[str, Callable[[str], object]] = {
    "file": lambda text: read_file(f"a: {text}")["a"],
    "--set": lambda text: parse_sets([f"a={text}"])["a"],
    "--sweep": lambda text: parse_sweeps([f"a={text}"])["a"][0],
    "-p of a number": lambda text: requested("number", text),
    "-p of a whole number": lambda text: requested("whole", text),
    "-p of a text": lambda text: requested("name", text),
    "--driver-option": lambda text: _read_options((f"a={text}",))["a"],
    "--canary": read_canary,
    "--timeout": lambda text: Duration().convert(text, None, None),
    "--seed": click.IntRange(min=0),
    "--seeds": lambda text: parse_seeds(f"0,{text.replace('-', 'x')}")[-1],  # - makes a range
    "--target": lambda text: parse_targets([f"a={text}"])["a"],
    "--require": lambda text: parse_requirement(f"a <= {text}").value,
    "--param": lambda text: parse_range(f"a={text}..1e300")[0],
    "--until": until,
    "--arena": lambda text: parse_arena(f"9x9,pole:{text}:0:1").poles[0].x,
    "--metrics": lambda text: _numbers([text], 1)[0],
}
LIKE_NUMBERS = st.text("0123456789+-._:eExXoObBafnITZ", min_size=1, max_size=10)
"""Octal, base 60, underscores, hexadecimal, powers, dates, and what a language takes for one."""
SAMPLES = [
    *("010", "08", "-010", "0o17", "0x1F", "0b11", "1_000", "1e3", "+1.5E-3", ".5", "5.", "1:30"),
    *("190:20:30.15", "2020-01-01", "2020-99-99", "١٢", "²", "1e999", "9" * 400, "9" * 5000, "inf"),
    *(
        ".inf",
        "-.INF",
        ".nan",
        "NaN",
        "infinity",
        "yes",
        "no",
        "on",
        "off",
        "y",
        "=",
        "<<",
        "-",
        ".",
    ),
]


def seen(text: str) -> Decimal | None:
    """The number that a person sees, by other means than the code; None if it is no number."""
    plain = text.strip().replace("_", "").lower()
    try:
        if plain.startswith(("0x", "0o")):
            return Decimal(int(plain, 0))
        return Decimal(plain.replace(".inf", "inf").replace(".nan", "nan"))
    except (ValueError, InvalidOperation):
        return None


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def is_as_seen(text: str, value: object) -> bool:
    """Whether the value is the number that the text shows, or the text."""
    number = seen(text)
    match value:
        case None:
            return text.strip() in ("", "~", "null")
        case bool():
            return text.strip().lower() == str(value).lower()
        case str():
            return value == text.strip()
        case int():
            return number == value
        case float() if number is not None:
            return value == float(number) or (value != value and number.is_nan())
        case list() | dict():  # YAML's own signs, as in `- 5`
            return True
    return False


def fault_of(call: Callable[[], object]) -> str:
    """The error's text; empty if the call returns."""
    try:
        call()
    except (SwarmError, click.ClickException, ValueError) as error:
        return str(error)
    return ""


@pytest.mark.parametrize("reader", READERS)
@settings(max_examples=examples(400), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.sampled_from(SAMPLES) | LIKE_NUMBERS)
def test_a_reader_takes_the_number_that_is_seen_or_the_text_or_refuses(
    reader: str, text: str
) -> None:
    fault = fault_of(lambda: READERS[reader](text))
    assert "\n" not in fault
    assert fault or is_as_seen(text, READERS[reader](text))


@pytest.mark.parametrize("reader", sorted(READERS.keys() - {"--canary"}))
def test_a_leading_zero_means_nothing_where_a_number_is_wanted(reader: str) -> None:
    value = "010" if reader in ("-p of a text", "--until") else 10
    assert READERS[reader]("010") == value


@given(name=st.sampled_from([text for text in SAMPLES if len(text) < 64]) | LIKE_NUMBERS)
@settings(max_examples=examples(400), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_name_that_looks_like_a_number_survives_or_is_refused(name: str) -> None:
    assert requested("name", name) == name
    condition = parse_condition(f"report:leader={name}")
    assert isinstance(condition, Reported)
    assert is_as_wanted(condition, name)
    assert read_file(text_of({name: [name]})) == {name: [name]}
    for text in (f"a: [{name}]", f"a: {{{name}: {name}}}"):
        fault = fault_of(partial(read_file, text))
        assert "\n" not in fault
        if not fault:
            value, faults = read_as(read_file(text)["a"], list[str] | dict[str, str])
            assert faults or value in ([name.strip()], {name.strip(): name.strip()})


@pytest.mark.long
@given(
    data=st.dictionaries(
        st.text(),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
            lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
        ),
    ),
    flow=st.sampled_from([None, False, True]),
)
@settings(max_examples=examples(200), suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_file_that_is_written_reads_as_it_was(data: dict[str, Any], flow: bool | None) -> None:
    twice = {"a": data, "b": data}
    assert repr(read_file(text_of(twice, flow=flow))) == repr(twice)
