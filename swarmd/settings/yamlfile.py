"""Reads YAML files strictly; each error is one line with file and line number.

Plain values follow YAML 1.2's core schema. Duplicate keys, keys that are not text, tags and anchors
are refused: with an anchor a file could refer to itself. `swarmd.settings.layered` checks the
values.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.constructor import SafeConstructor
from yaml.reader import ReaderError
from yaml.resolver import Resolver

from swarmd.core.errors import ConfigError
from swarmd.core.files import as_text, read_regular, real_path
from swarmd.core.numbers import FLOAT, INTEGER, read_number

Data = dict[str, Any]


def read(path: Path) -> Data:
    """The mapping in a file, {} for an empty one; ConfigError with file and line otherwise."""
    name = shown(path)
    try:
        text = read_regular(path)
    except OSError as error:
        raise ConfigError(f"{name}: cannot be read: {error.strerror}; check the path") from error
    return parsed(text, name)


def parsed(text: bytes, name: str) -> Data:
    """The mapping in the text of a file called `name`, {} for an empty one.

    ConfigError with name and line otherwise.
    """
    try:
        data = yaml.load(text, Loader=_StrictLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}{_yaml_fault(error, text)}") from error
    except (ValueError, RecursionError) as error:  # for instance a thousand nested brackets
        raise ConfigError(f"{name}: is not YAML that can be read: {error}") from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise ConfigError(
            f"{name}: holds {brief(data)}; expected keys and values, such as `id: r1`"
        )
    return data


def read_extended(path: Path, find: Callable[[str, Path], Path]) -> Iterator[tuple[Path, Data]]:
    """Read a file, the file that it names by `extends`, and so on.

    Yields (path, content) of each file, a file before the file that it extends. The caller merges
    the contents: values of an earlier file replace values of a later file. `find(name, folder)`
    returns the path of a file that a file in `folder` extends. ConfigError for a missing file, and
    if a file extends itself, directly or by other files.
    """
    seen: list[Path] = []
    while True:
        if real_path(path) in seen:
            files = " -> ".join(shown(file) for file in (*seen, path))
            raise ConfigError(f"{shown(path)}: extends itself: {files}; take one of them out")
        seen.append(real_path(path))
        data = read(path)
        yield path, data
        base = data.get("extends")
        if not isinstance(base, str):
            return
        try:
            path = find(base, path.parent)
        except ConfigError as error:
            raise ConfigError(f"{shown(path)}: extends: {error}") from error


def read_value(text: str) -> Any:
    """The value of a text that is read as YAML; ConfigError if the text is not valid YAML."""
    try:
        return yaml.load(text, Loader=_StrictLoader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise ConfigError(
            f"{brief(text)} is not a value; expected YAML, such as 3 or [1, 2]"
        ) from error


def key_lines(path: Path) -> Mapping[tuple[str | int, ...], int]:
    """The line of each key and list item of a file; {} if the file can no longer be read."""
    lines: dict[tuple[str | int, ...], int] = {}

    def walk(node: yaml.Node | None, keys: tuple[str | int, ...]) -> None:
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                lines[(*keys, str(key.value))] = key.start_mark.line + 1
                walk(value, (*keys, str(key.value)))
        elif isinstance(node, yaml.SequenceNode):
            for index, value in enumerate(node.value):
                lines[(*keys, index)] = value.start_mark.line + 1
                walk(value, (*keys, index))

    try:
        walk(yaml.compose(read_regular(path), Loader=yaml.SafeLoader), ())
    except (OSError, yaml.YAMLError, ValueError, RecursionError):
        return {}
    return lines


def text_of(data: Any, *, flow: bool | None = False, width: float = 80) -> str:
    """The data as YAML text that `read` reads back unchanged: text such as 08 is quoted.

    `flow`: which lists and mappings are written in brackets, such as [1, 2], instead of an item on
    each line. True: all. False: none. None: those without lists or mappings inside. ConfigError
    for a path that is not UTF-8.
    """
    text: str = yaml.dump(
        data,
        Dumper=_Dumper,
        sort_keys=False,
        default_flow_style=flow,
        allow_unicode=True,
        width=width,
    )
    return text


def shown(path: Path) -> str:
    """The path as errors show it: relative if it is below the working directory, else absolute."""
    try:
        real = real_path(path)
        here = Path.cwd()
    except OSError:  # the working directory was removed
        return str(path)
    return str(real.relative_to(here)) if real.is_relative_to(here) else str(real)


def brief(value: object) -> str:
    """A value as errors show it, at most 60 characters; with its type if no file can hold it."""
    text = repr(value) if isinstance(value, str | int | float | list | dict) else str(value)
    short = text if len(text) <= 60 else f"{text[:57]}..."
    is_plain = value is None or isinstance(value, str | int | float | list | tuple | dict)
    return short if is_plain else f"{short} of type {type(value).__name__}"


_Loader: Any = yaml.SafeLoader
if yaml.__with_libyaml__:
    from yaml._yaml import CParser

    class _FastLoader(Composer, CParser, SafeConstructor, Resolver):
        """libyaml's parser under the composer in Python: a quarter of the time of SafeLoader."""

        def __init__(self, stream: Any) -> None:
            CParser.__init__(self, stream)
            Composer.__init__(self)
            SafeConstructor.__init__(self)
            Resolver.__init__(self)

    _Loader = _FastLoader


class _StrictLoader(_Loader):  # type: ignore[misc]  # a base chosen at run time
    """safe_load without duplicate keys, keys that are not text, tags and anchors."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.peek_event()
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise yaml.MarkedYAMLError(
                problem="& and * are not read here; write the value out",
                problem_mark=event.start_mark,
            )
        if getattr(event, "tag", None) not in (None, "!", _TAG + "str"):
            raise yaml.MarkedYAMLError(
                problem=f"the tag {event.tag} is not read here; write the value alone",
                problem_mark=event.start_mark,
            )
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        lines: dict[str, int] = {}
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            mark = key_node.start_mark
            if not isinstance(key, str):
                is_plain = isinstance(key_node, yaml.ScalarNode) and key is not None
                text = key_node.value if is_plain else brief(key)
                raise yaml.MarkedYAMLError(
                    problem=f"key {text} is not text; put it in quotes", problem_mark=mark
                )
            if key in lines:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key!r} stands twice, first in line {lines[key]}; keep one",
                    problem_mark=mark,
                )
            lines[key] = mark.line + 1
        return super().construct_mapping(node, deep=deep)

    def construct_number(self, node: Any) -> int | float:
        number = read_number(node.value)
        if number is None:
            raise yaml.MarkedYAMLError(
                problem=f"the number {brief(node.value)} is too large", problem_mark=node.start_mark
            )
        return number


class _Dumper(yaml.SafeDumper):
    """Writes YAML that `_StrictLoader` and readers of YAML 1.1 read alike, without anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        return True

    def represent_text(self, text: str) -> Any:
        # Outside of double quotes readers fold the characters that YAML 1.1 counts as line ends.
        style = None if text.isprintable() else '"'
        return self.represent_scalar(_TAG + "str", as_text(text), style)


_TAG = "tag:yaml.org,2002:"
# Plain scalars of the core schema: type, form and first characters.
_PLAIN = (
    ("null", re.compile(r"(?:~|null|Null|NULL|)\Z"), ["", *"~nN"]),
    ("bool", re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z"), list("tTfF")),
    ("int", INTEGER, list("-+0123456789")),
    ("float", FLOAT, list("-+.0123456789")),
)
_StrictLoader.yaml_implicit_resolvers = {}
for _name, _form, _first in _PLAIN:
    _StrictLoader.add_implicit_resolver(_TAG + _name, _form, _first)
    _Dumper.add_implicit_resolver(_TAG + _name, _form, _first)
_Dumper.add_representer(str, _Dumper.represent_text)
_StrictLoader.add_constructor(_TAG + "int", _StrictLoader.construct_number)
_StrictLoader.add_constructor(_TAG + "float", _StrictLoader.construct_number)


def _yaml_fault(error: yaml.YAMLError, content: bytes) -> str:
    """The line number, the fault in that line, and a remedy if the line shows it."""
    # libyaml gives no encoding, but the reason "invalid leading UTF-8 octet".
    if isinstance(error, ReaderError) and "utf-8" in f"{error.encoding} {error.reason}".lower():
        line_number = content.count(b"\n", 0, error.position) + 1
        return f": is not YAML: line {line_number} has no UTF-8 text; save the file as UTF-8"
    if not isinstance(error, yaml.MarkedYAMLError) or error.problem_mark is None:
        return f": is not YAML: {' '.join(str(error).split())}"
    begin = error.context_mark
    if "escape" in (error.problem or ""):
        return rf":{error.problem_mark.line + 1}: {error.problem}; write \ twice, or take ' for \""
    if begin is not None and any(word in (error.context or "") for word in ("quoted", "flow")):
        what = "quote" if "quoted" in str(error.context) else "bracket"
        return f":{begin.line + 1}: the {what} that begins here is not closed; close it"
    lines = content.decode(errors="replace").splitlines()[: error.problem_mark.line + 1]
    problem = error.problem or "is not YAML"
    if "expected" in problem or "allowed" in problem or "token" in problem or "tab" in problem:
        problem = _fault_of_indent(lines) or problem
    return f":{error.problem_mark.line + 1}: {problem}"


def _fault_of_indent(lines: list[str]) -> str:
    """The fault in the indent of the last line, in which the parser found an error."""
    *above, line = lines or [""]
    if "\t" in line[: len(line) - len(line.lstrip())]:
        return "the line begins with a tab; indent it with spaces"
    levels = [0]
    for earlier in above:
        if earlier.strip() and not earlier.lstrip().startswith("#"):
            levels = [n for n in levels if n < _indent(earlier)] + [_indent(earlier)]
    if _indent(line) not in levels:
        wanted = " or ".join(map(str, levels))
        return f"the line is indented by {_indent(line)} spaces; expected {wanted}, as lines above"
    if line.count(": ") > 1:
        return "the line has a second `: `; put the value in quotes"
    return ""


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" "))
