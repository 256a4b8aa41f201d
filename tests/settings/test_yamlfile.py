"""Strict reading of YAML."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.core.errors import ConfigError
from swarmd.settings.yamlfile import brief, read, read_value, shown


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path / "x.yaml"


@pytest.mark.parametrize(
    ("text", "data"),
    [
        ("", {}),
        ("# nothing\n", {}),
        ("a: 1\nb: {c: [x, 2.5]}", {"a": 1, "b": {"c": ["x", 2.5]}}),
        ("a: 1e-3\nb: -2E5\nc: 1e3x", {"a": 0.001, "b": -200000.0, "c": "1e3x"}),
        ("a: [off, no, Yes, on, y]", {"a": ["off", "no", "Yes", "on", "y"]}),
        ("a: [010, -08, 0o17, 0x1F, +5]", {"a": [10, -8, 15, 31, 5]}),
        (
            "a: [1_000, 1:30, 2020-99-99, =, !!str 8]",
            {"a": ["1_000", "1:30", "2020-99-99", "=", "8"]},
        ),
        ("a: [true, False, TRUE]", {"a": [True, False, True]}),
    ],
)
def test_reads_values_by_type(file: Path, text: str, data: object) -> None:
    file.write_text(text)
    assert read(file) == data


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("a: 1\nb: 2\na: 3", "x.yaml:3: key 'a' stands twice, first in line 1; keep one"),
        ("a:\n  b: 1\n  b: 1", "x.yaml:3: key 'b' stands twice, first in line 2; keep one"),
        ("a: [{b: 1, b: 2}]", "x.yaml:1: key 'b' stands twice, first in line 1; keep one"),
        ("a: &x 1\nb: *x", "x.yaml:1: & and * are not read here; write the value out"),
        ("a: &x [*x]", "x.yaml:1: & and * are not read here; write the value out"),
        ("true: 1", "x.yaml:1: key true is not text; put it in quotes"),
        ("~: 1", "x.yaml:1: key None is not text; put it in quotes"),
        ("1: 1", "x.yaml:1: key 1 is not text; put it in quotes"),
        ("[a]: 1", "x.yaml:1: key ['a'] is not text; put it in quotes"),
        ("a:\n - b: ]", "x.yaml:2: "),
        ("a:\n\tb: 1", "x.yaml:2: the line begins with a tab; indent it with spaces"),
        ("a:\n- b\n \t- c: 1", "x.yaml:3: the line begins with a tab"),
        ("a: 1\n  b: 2", "x.yaml:2: the line is indented by 2 spaces; expected 0,"),
        ("a:\n    b: 1\n  c: 2", "x.yaml:3: the line is indented by 2 spaces; expected 0 or 4,"),
        ("a:\n  - b\n c: 2", "x.yaml:3: the line is indented by 1 spaces; expected 0 or 2,"),
        ("a: b: c", "x.yaml:1: the line has a second `: `; put the value in quotes"),
        ("a: 'b\nc: 1", "x.yaml:1: the quote that begins here is not closed"),
        ("a: 1\nb: 'C:\\dir'\nc: \"C:\\dir\"", "x.yaml:3: found unknown escape character; write"),
        ('a: "\\uDCFF"', "x.yaml:1: found invalid Unicode character escape code; write"),
        ("a: 1\nb: [c\nd: 2", "x.yaml:2: the bracket that begins here is not closed"),
        ("a: !!python/object:os.system x", "x.yaml:1: the tag tag:yaml.org,2002:python/object:os"),
        ("a: !!bool maybe", "x.yaml:1: the tag tag:yaml.org,2002:bool is not read here"),
        ("010: 1", "x.yaml:1: key 010 is not text; put it in quotes"),
        ("a: 1e999", "x.yaml:1: the number '1e999' is too large"),
        ("a: 0x" + "f" * 4000, "x.yaml:1: the number '0xff"),  # more digits than str() gives
        ("- a\n- b", "x.yaml: holds ['a', 'b']; expected keys and values, such as `id: r1`"),
        ("hello", "x.yaml: holds 'hello'; expected keys and values, such as `id: r1`"),
        ("a: " + "[" * 5000, "x.yaml"),
    ],
)
def test_refuses_in_one_line_with_file_and_line(file: Path, text: str, fault: str) -> None:
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        read(file)
    assert str(caught.value).startswith(fault)
    assert "\n" not in str(caught.value)


def test_refuses_bytes_that_are_not_text(file: Path) -> None:
    file.write_bytes(b"a: \xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"^x\.yaml: is not YAML"):
        read(file)


def test_refuses_a_missing_file(file: Path) -> None:
    with pytest.raises(ConfigError, match=r"^x\.yaml: cannot be read"):
        read(file)


def test_paths_below_the_working_directory_are_shown_relative(file: Path) -> None:
    assert shown(file.parent / "a" / "b.yaml") == "a/b.yaml"
    assert shown(Path("/etc/b.yaml")) == "/etc/b.yaml"


def test_shortens_long_values() -> None:
    assert brief("x") == "'x'"
    assert len(brief(["long"] * 100)) == 60


def test_a_value_alone_is_read_as_in_a_file() -> None:
    assert [read_value(text) for text in ("1e-3", "[1, a]", "{a: 1}", "true", "")] == [
        *(0.001, [1, "a"], {"a": 1}, True, None)
    ]
    with pytest.raises(ConfigError, match=r"'\[1' is not a value"):
        read_value("[1")


def test_a_file_that_is_no_utf_8_has_line_and_remedy(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_bytes("id: r1\n# für alle\n".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"mine\.yaml: .*line 2 .* UTF-8"):
        read(file)
