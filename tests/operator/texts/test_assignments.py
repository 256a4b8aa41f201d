"""Assignments: numbers are read as numbers, wrong words are refused."""

from __future__ import annotations

import pytest

from swarmd.core.errors import ConfigError
from swarmd.operator.texts.assignments import read_assignments


@pytest.mark.parametrize(
    ("word", "value"),
    [
        ("k=1", 1),
        ("k=-7", -7),
        ("k=0.15", 0.15),
        ("k=.5", ".5"),
        ("k=1e-3", "1e-3"),
        ("k=paper", "paper"),
        ("k=true", "true"),
        ("k=", ""),
        ("k=a=b", "a=b"),
        ("k=nan", "nan"),
        ("k=inf", "inf"),
        ("k=1e999", "1e999"),
        ("k=007", "007"),
        ("k=1_000", "1_000"),
        ("k=.", "."),
        ("k=-", "-"),
        ("k=9007199254740993", "9007199254740993"),
    ],
)
def test_reads_exact_numbers_as_numbers_and_all_else_as_text(word: str, value: object) -> None:
    found = read_assignments([word])["k"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(
    ("words", "subject"),
    [
        (["speed"], "'speed'"),
        (["=1"], "'=1'"),
        (["k" * 65 + "=1"], "64 characters"),
        (["a=1", "a=2"], "-p a "),
        (["a=" + "x" * 257], "256 characters"),
        (["a=\udcff"], "UTF-8"),
        ([f"k{i}={250 * 'x'}" for i in range(150)], "32768 bytes"),
    ],
)
def test_refuses_wrong_assignments(words: list[str], subject: str) -> None:
    with pytest.raises(ConfigError, match=subject):
        read_assignments(words)
