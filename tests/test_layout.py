"""The layout: the direction of imports, the layers of `swarmd/`, and the packaging.

LAYERS is the table of layers, from the ground up. A room is a folder of `swarmd/`, or a folder in
it that LAYERS names, such as `robot/protection`: a module imports its own room and lower layers
only. WINGS of tests/support/wings.py has the wings; a module imports from no later wing. `link/`
has an order of its own, in ROOMS there.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import yaml

import swarmd
from swarmd.core import kernels
from swarmd.plugins import installed_patterns
from swarmd.testing.no_side_effects import FORBIDDEN_IMPORTS
from tests.support.kernel_forms import typed_text
from tests.support.packed import packed_assignments
from tests.support.shape import CLOSURES, FILES, import_closure, keys_of, statements
from tests.support.wings import ROOMS, WINGS, wing_of

ROOT = Path(__file__).resolve().parent.parent
LINKED = ("patterns", "drivers", "sim", "config")
CODE = ("swarmd", *LINKED)
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
ROS_PACKAGE = ROOT / "drivers" / "swarmd_bringup"
SETUPTOOLS = PROJECT["tool"]["setuptools"]

FORBIDDEN = {
    "swarmd": ("swarmd.patterns", "swarmd.drivers", "swarmd.sim", "mujoco", "matplotlib"),
    "patterns": FORBIDDEN_IMPORTS,
    "drivers": ("swarmd.patterns", "swarmd.sim", "mujoco"),
    "sim": ("swarmd.patterns", "swarmd.drivers", "zenoh"),
    "config": CODE,
}
# Modules that may break a rule of FORBIDDEN, with the reason.
EXCEPTIONS: dict[tuple[str, str], str] = {
    ("sim/live/link.py", "zenoh"): "the world's own session, for viewers of real-time mode",
}
# The rooms (packages of `swarmd/`) of all modules in the import closure of a module: what one must
# know of it. First those that an import of the module loads, then those that its functions import
# later. A new room is a decision, named in the commit that adds it here.
# `python -m tests.support.shape` prints lines and modules, which no test bounds.
ROOMS_KNOWN: dict[str, tuple[set[str], set[str]]] = {
    "swarmd.robot.protection.protection": ({"core", "robot/protection", "robot/sensing"}, set()),
    "swarmd.robot.robot": (
        {"core", "kit", "robot/protection", "robot", "robot/sensing", "settings"},
        set(),
    ),
    "swarmd.link.peer": ({"core", "link", "link/keys"}, set()),
    "swarmd.api": (
        {"api", "core", "kit", "robot/sensing"},
        set(),
    ),  # what authors of patterns import
    "swarmd.daemon.daemon": (
        {
            *("core", "daemon", "driver_api", "robot/kin", "kit", "make_robot", "link"),
            *(
                "pattern_host",
                "plugins",
                "robot/protection",
                "daemon/recording",
                "robot",
                "link/keys",
            ),
            *("robot/sensing", "settings"),
        },
        {
            "robot/steering",  # by `make_robot`, when the robot is made
            *("api", "mission"),  # in the child process that runs a mission
        },
    ),
}
# Folders whose functions import late, for one reason: `swarmctl` starts with what its verb needs.
# (`swarmctl --help` loads none of them, as tests/operator/cli/test_swarmctl.py checks.)
LATE_IMPORTS = (
    "swarmd/operator/cli/",
    "swarmd/operator/client/",
    "swarmd/operator/session/",
    "swarmd/operator/verbs/",
    "sim/",
)
# Keys of all files; SLACK above them is a fault.
KEYS = 355
SLACK = 1.05
# The public names, which are imported when they are used, and where type checkers find them.
SURFACE = "swarmd/__init__.py"
# Packages that take the time as an argument, and read no clock.
PURE = (
    *(
        "robot",
        "robot/protection",
        "robot/steering",
        "robot/kin",
        "kit",
        "mission",
        "robot/sensing",
        "operator/calibration",
    ),
    "operator/acceptance",
)
CLOCKS = ("time", "datetime", "asyncio", "swarmd.core.clock.boottime")
# Layers of `swarmd/`, from the ground up. A module imports its own package and lower layers only.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("config",),
    ("core",),
    ("link/keys",),
    ("robot/sensing", "driver_api", "link"),
    ("operator/session/members_view",),  # the value that a look gives, which texts show
    ("plugins",),
    ("kit", "robot/protection"),
    ("robot/kin", "robot/steering", "operator/texts"),
    ("api", "settings"),
    ("robot",),
    ("make_robot", "daemon/recording"),
    ("mission", "operator/calibration", "ros2_nodes"),
    ("pattern_host", "operator/acceptance", "operator/session"),
    ("operator/verbs",),
    ("operator/client",),
    ("daemon", "operator/replay", "operator/view"),
    ("operator/cli",),
    ("testing",),
)
HEIGHT = {name: n for n, layer in enumerate(LAYERS) for name in layer}
LAYER_EXCEPTIONS: dict[tuple[str, str], str] = {
    ("pattern_host", "testing"): "the inspecting child runs the contract that authors import",
}
_MEASURES, _TESTS = ("benchmarks", "studies"), ("tests",)
PATTERN_FILES = sorted((ROOT / "patterns").glob("*/pattern.py"))
# Metrics beside patterns, which experiments import, and no robot.
METRICS_FILES = sorted((ROOT / "patterns").glob("*/metrics.py"))
OF_METRICS = (
    *("swarmd.core.values", "swarmd.sim.metrics", "swarmd.sim.trace"),
    *("numpy", "math", "dataclasses"),
)


@cache
def sources(*folders: str) -> list[Path]:
    """Each Python file once: links are not followed."""
    found = []
    for folder in folders:
        for path in sorted((ROOT / folder).rglob("*.py")):
            inside = path.relative_to(ROOT).parts
            is_link = any((ROOT / Path(*inside[:n])).is_symlink() for n in range(1, len(inside)))
            if not is_link:
                found.append(path)
    return found


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@dataclass(frozen=True, slots=True)
class Facts:
    """What tests ask of a file. Its tree is let go: those of all files take a gigabyte."""

    imports: list[tuple[int, str]]
    """(line, module) of each import, also of a name that might be a module itself."""
    silent_imports: list[int]
    """The lines of imports inside functions without a reason near them."""
    packed: list[str]
    """Line and text of each packed assignment; read in CODE alone."""


@cache
def facts(path: Path) -> Facts:
    text = path.read_text()
    tree = ast.parse(text)
    body = [*statements(tree)]
    is_code = path.relative_to(ROOT).parts[0] in CODE
    return Facts(
        imports=[one for node in body for one in _imported(node)],
        silent_imports=_silent(body, text.splitlines()) if is_code else [],
        packed=_packed(tree) if is_code else [],
    )


def imports(path: Path) -> list[tuple[int, str]]:
    return facts(path).imports


def _imported(node: ast.stmt) -> list[tuple[int, str]]:
    if isinstance(node, ast.Import):
        return [(node.lineno, alias.name) for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    package = (node.lineno, "." * node.level + (node.module or ""))
    return [package, *((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)]


def _silent(body: list[ast.stmt], lines: list[str]) -> list[int]:
    """The first import of each function that has some, none of which has a comment near it."""
    found = []
    for function in body:
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        inner = [node for part in function.body for node in statements(part)]
        late = [node for node in inner if isinstance(node, ast.Import | ast.ImportFrom)]
        near = {n for node in late for n in range(node.lineno - 2, node.end_lineno or 0)}
        if late and not any("#" in lines[n] for n in near):
            found.append(min(node.lineno for node in late))
    return found


def _packed(tree: ast.Module) -> list[str]:
    return [f"{node.lineno} {ast.unparse(node)[:60]}" for node in packed_assignments(tree)]


def is_within(module: str, package: str) -> bool:
    return module == package or module.startswith(package + ".")


def offences(path: Path, forbidden: tuple[str, ...]) -> list[str]:
    return [
        f"{name_of(path)}:{line} imports {module}"
        for line, module in imports(path)
        if any(is_within(module, package) for package in forbidden)
        and (name_of(path), module) not in EXCEPTIONS
        and name_of(path) != SURFACE
    ]


def rooms_of(modules: Iterable[str]) -> set[str]:
    return {room_of(module) for module in modules}


def test_the_closures_that_are_printed_are_those_with_rooms() -> None:
    assert set(CLOSURES) == ROOMS_KNOWN.keys()


@pytest.mark.parametrize("module", ROOMS_KNOWN)
def test_the_rooms_that_one_must_know_of_a_module(module: str) -> None:
    """At the start, and ever: imports inside functions count, too."""
    at_start, later = ROOMS_KNOWN[module]
    assert rooms_of(import_closure(module, at_start=True)) == at_start
    assert rooms_of(import_closure(module)) == at_start | later


@pytest.mark.parametrize("module", ["swarmd.robot.protection.protection", "swarmd.robot.robot"])
def test_protection_and_the_robot_know_nothing_of_steering(module: str) -> None:
    """Neither at the start nor later: the shells give it."""
    known = import_closure(module)
    assert "swarmd.robot.protection.barrier" in known
    assert not [
        one for one in known if one.startswith(("swarmd.robot.steering.", "swarmd.robot.kin."))
    ]
    assert "swarmd.robot.steering.recovery" in import_closure("swarmd.make_robot")


def test_an_import_inside_a_function_says_why() -> None:
    """In a comment on its line, or on the line above; a group of imports has one comment."""
    silent = []
    for path in sources("swarmd", "patterns", "drivers"):
        if name_of(path).startswith(LATE_IMPORTS):
            continue
        silent += [f"{name_of(path)}:{line}" for line in facts(path).silent_imports]
    assert silent == []


@pytest.mark.parametrize("folder", ["swarmd", "patterns", "drivers", "sim"])
def test_one_statement_assigns_one_thing(folder: str) -> None:
    """Swaps, shifts and the unpacking of one value stay: see tests/support/packed.py."""
    found = [f"{name_of(path)}:{one}" for path in sources(folder) for one in facts(path).packed]
    assert found == []


@pytest.mark.parametrize(
    ("code", "is_packed"),
    [
        ("a, b = 1, 2", True),
        ("self.a, self.b = x, x + 1", True),
        ("a = self.b = 0.0", True),
        ("a = b = -INFINITY", True),
        ("i, j = i + 1, j - 1", True),
        ("a, b = b, a", False),
        ("a, b = b, a + b", False),
        ("v[i], v[j] = v[j], v[i]", False),
        ("a, b = pair", False),
        ("first, *rest = 1, 2, 3", False),
        ("link = self._open = Link()", False),
    ],
)
def test_what_counts_as_packed(code: str, is_packed: bool) -> None:
    assert bool(list(packed_assignments(ast.parse(code)))) == is_packed


def test_configuration_keys_do_not_grow() -> None:
    assert 0.5 < sum(map(len, keys_of(*FILES).values())) / KEYS <= SLACK


def test_one_module_reads_and_writes_yaml() -> None:
    files = sources(*CODE, *_MEASURES, "docs", "examples")
    users = {name_of(path) for path in files for _, name in imports(path) if name == "yaml"}
    assert users == {"swarmd/settings/yamlfile.py"}


@pytest.mark.parametrize("folder", FORBIDDEN)
def test_imports_point_one_way(folder: str) -> None:
    paths = [path for path in sources(folder) if path not in METRICS_FILES]
    assert [line for path in paths for line in offences(path, FORBIDDEN[folder])] == []


def test_metrics_beside_a_pattern_import_what_computes() -> None:
    used = {
        f"{name_of(path)}:{line} {module}"
        for path in METRICS_FILES
        for line, module in imports(path)
        if not f"{module}.".startswith(tuple(f"{one}." for one in ("__future__", *OF_METRICS)))
    }
    assert METRICS_FILES
    assert used == set()


@pytest.mark.parametrize("package", PURE)
def test_pure_packages_take_the_time_as_an_argument(package: str) -> None:
    found = [line for path in sources(f"swarmd/{package}") for line in offences(path, CLOCKS)]
    assert found == []


def room_of(module: str) -> str:
    """The room of a module: its longest prefix in LAYERS, else its first folder.

    The command of a verb is of the room of the command line, in whose frame it is.
    """
    parts = module.split(".")[1:]
    if parts[:2] == ["operator", "verbs"] and "command" in parts[3:]:
        return "operator/cli"
    prefixes = ("/".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((prefix for prefix in prefixes if prefix in HEIGHT), parts[0])


def test_packages_of_swarmd_keep_their_layers() -> None:
    upward = []
    for path in sources("swarmd"):
        room = room_of(module_of(name_of(path)))
        if path.name == "__init__.py" and room not in HEIGHT:
            continue
        for line, module in imports(path):
            if not module.startswith("swarmd.") or module.split(".")[1] in LINKED:
                continue
            other = room_of(module)
            if other == room:
                continue
            if HEIGHT[other] >= HEIGHT[room] and (room, other) not in LAYER_EXCEPTIONS:
                upward.append(f"{name_of(path)}:{line} imports {module}")
    assert upward == []


def test_a_verb_is_asked_by_its_ask_and_not_by_its_command() -> None:
    """`swarmctl` names the module of a command, and imports it when it is used.

    `swarmctl plugin` is a group, which imports the commands of its group.
    """
    found = [
        f"{name_of(path)}:{line} imports {module}"
        for path in sources("swarmd", "sim", "drivers")
        if name_of(path) != "swarmd/operator/cli/plugin.py"
        for line, module in imports(path)
        if re.match(r"swarmd\.operator\.verbs\.\w+\.command\b", module)
    ]
    assert found == []


def test_wings_import_from_no_later_wing() -> None:
    order = list(WINGS)
    later, homeless = [], []
    for path in sources(*CODE):
        name = name_of(path)
        own = wing_of(name)
        if own is None:
            homeless += [name] if path.name != "__init__.py" else []
            continue
        for line, module in imports(path):
            wing = wing_of(place_of(module))
            if wing is not None and order.index(wing) > order.index(own):
                later.append(f"{name}:{line} imports {module}")
    assert homeless == []
    assert later == []


def test_rooms_of_the_network_keep_their_layers() -> None:
    height = {name: n for n, rooms in enumerate(ROOMS) for name in rooms}
    upward = []
    for path in sources("swarmd/link"):
        room = path.relative_to(ROOT / "swarmd" / "link").parts[0].removesuffix(".py")
        for line, module in imports(path):
            parts = module.split(".")
            if room == "__init__" or parts[:2] != ["swarmd", "link"] or len(parts) < 3:
                continue
            if parts[2] != room and height[parts[2]] >= height[room]:
                upward.append(f"{name_of(path)}:{line} imports {module}")
    assert upward == []


def place_of(module: str) -> str:
    """The place of a module in the tree: linked folders are beside `swarmd`."""
    parts = module.split(".")
    is_linked = len(parts) > 1 and parts[0] == "swarmd" and parts[1] in LINKED
    return "/".join(parts[1:] if is_linked else parts)


def test_one_file_has_one_import_name() -> None:
    everything = sources(*CODE, "tests", *_MEASURES, "examples")
    found = [line for path in everything for line in offences(path, (*LINKED, "examples"))]
    shipped = sources(*CODE, "examples")
    found += [line for path in shipped for line in offences(path, (*_MEASURES, *_TESTS))]
    # Benchmarks and studies use the rigs of the tests, and nothing else of them.
    found += [
        line
        for path in sources(*_MEASURES)
        for line in offences(path, _TESTS)
        if "imports tests.support" not in line
    ]
    relative = [
        f"{name_of(path)}:{line}"
        for path in everything
        for line, module in imports(path)
        if module.startswith(".")
    ]
    assert found == []
    assert relative == []


def test_the_core_names_no_concrete_plugin() -> None:
    plugins = PROJECT["project"]["entry-points"]
    names = {value.partition(":")[0] for group in plugins for value in plugins[group].values()}
    names -= {"swarmd.patterns"}  # the group, too; its folders are the plugins
    names |= {f"swarmd.patterns.{path.parent.name}" for path in PATTERN_FILES}
    found = [
        f"{name_of(path)} names {name}"
        for path in sources("swarmd")
        for name in sorted(names)
        if name in path.read_text()
    ]
    assert found == []


@pytest.mark.integration
@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("swarmd.daemon.daemon", {"swarmd.kit.behavior", "swarmd.api", "numpy.random"}),
        ("swarmd.pattern_host.worker", {"importlib.abc", "tempfile", "lzma", "swarmd.link"}),
        ("swarmd.api", {"zenoh", "asyncio", "mujoco", "click", "rich", "swarmd.link"}),
    ],
)
def test_the_daemon_loads_no_pattern_code_and_a_pattern_no_network(
    module: str, unwanted: set[str]
) -> None:
    code = f"import sys, {module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not unwanted & set(done.stdout.split())


@pytest.mark.parametrize("folder", LINKED)
def test_folder_is_linked(folder: str) -> None:
    link = ROOT / "swarmd" / folder
    assert link.is_symlink()
    assert link.readlink() == Path("..") / folder


def test_every_folder_with_code_is_packaged() -> None:
    expected = {}
    for path in sources(*CODE):
        if path in (*PATTERN_FILES, *METRICS_FILES):
            continue  # data of swarmd.patterns: to add a pattern changes no list
        if ROS_PACKAGE in path.parents:
            continue  # it has a setup.py of its own
        folder = path.parent.relative_to(ROOT)
        inside = folder if folder.parts[0] == "swarmd" else Path("swarmd") / folder
        expected[".".join(inside.parts)] = folder.as_posix()
    mapping = SETUPTOOLS["package-dir"]
    assert sorted(SETUPTOOLS["packages"]) == sorted(expected)
    assert {name: mapping.get(name, name.replace(".", "/")) for name in expected} == expected


def test_every_kernel_is_in_a_library() -> None:
    files = {
        name_of(path)
        for path in sources("swarmd", "sim")
        if "from swarmd.core import cython_shadow as cython\n" in path.read_text()
        or path.with_suffix(".pxd").exists()
    }
    assert {*map(kernels.source_of, kernels.KERNELS)} == files


def test_mypy_checks_every_module_of_ours() -> None:
    exempt = [
        name
        for override in PROJECT["tool"]["mypy"]["overrides"]
        for name in override["module"]
        if name.startswith(("swarmd", "*"))
    ]
    assert exempt == []


def test_python_uses_kernels_as_cython_permits() -> None:
    """A function of one argument takes no keyword, and a subclass replaces no method of C.

    The directive `always_allow_keywords` is False; the interpreted form permits both.
    """
    files = [kernels.source_of(name) for name in kernels.KERNELS]
    trees = [ast.parse(typed_text(name)) for name in kernels.KERNELS]
    classes = {node.name: node for t in trees for node in t.body if isinstance(node, ast.ClassDef)}
    functions = [node for t in trees for node in ast.walk(t) if isinstance(node, ast.FunctionDef)]
    arguments = [(f.name, [arg.arg for arg in f.args.args if arg.arg != "self"]) for f in functions]
    keywords = {f"{name}({args[0]}=" for name, args in arguments if len(args) == 1}
    found = []
    for path in sources(*CODE):
        text, names = path.read_text(), classes.keys()
        found += [f"{name_of(path)}: {call}" for call in re.findall(r"\b\w+\(\w+=", text)
                  if call in keywords]  # fmt: skip
        is_python = name_of(path) not in files  # a kernel may replace methods of C
        for node in ast.walk(tree_of(path)) if any(f"({name})" in text for name in names) else ():
            bases = node.bases if isinstance(node, ast.ClassDef) and is_python else []
            for base in map(ast.unparse, bases):
                found += [
                    f"{name_of(path)}: {base}.{name}"
                    for name in methods_of(node) & methods_of(classes.get(base), "cython.cfunc")
                ]
    assert found == []


def module_of(path: str) -> str:
    """The import name of a file, by its path in the repository."""
    inside = path if path.startswith(("swarmd/", "tests/")) else f"swarmd/{path}"
    return inside.removesuffix(".py").replace("/", ".")


def methods_of(node: ast.AST | None, decorator: str = "") -> set[str]:
    """The methods of a class, or those with a decorator."""
    return {
        method.name
        for method in getattr(node, "body", ())
        if isinstance(method, ast.FunctionDef)
        and (not decorator or decorator in map(ast.unparse, method.decorator_list))
    }


def test_every_package_has_an_init_that_only_reexports() -> None:
    missing = [
        p for p in SETUPTOOLS["packages"] if not (ROOT / _folder(p) / "__init__.py").exists()
    ]
    busy = [
        name_of(path)
        for path in sources(*CODE)
        if path.name == "__init__.py"
        and name_of(path) not in ("swarmd/operator/cli/__init__.py", SURFACE)
        for node in tree_of(path).body
        if not isinstance(node, ast.Import | ast.ImportFrom | ast.Expr | ast.Assign)
    ]
    assert missing == []
    assert busy == []


@pytest.mark.integration
def test_public_names_are_imported_when_they_are_used() -> None:
    names = set(swarmd._PUBLIC)
    typed = {
        alias.asname
        for node in ast.walk(tree_of(ROOT / SURFACE))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.asname
    }
    code = "import sys, swarmd; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name for name in done.stdout.split() if name.startswith("swarmd")}
    assert loaded == {
        "swarmd",
        "swarmd.core",
        "swarmd.core.former_names",
        "swarmd.core.kernels",
    }
    assert names == typed == {name for name in names if callable(getattr(swarmd, name))}
    assert names <= set(dir(swarmd))
    with pytest.raises(AttributeError, match="conect"):
        swarmd.conect  # type: ignore[attr-defined]  # noqa: B018  # a name that is misspelt


def test_the_citation_is_of_this_version_and_licence() -> None:
    """The keys that CFF 1.2.0 requires, and those that the project's metadata repeats."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert {"cff-version", "message", "title", "authors"} <= set(cited)
    assert cited["cff-version"] == "1.2.0"
    assert cited["title"] == PROJECT["project"]["name"]
    assert str(cited["version"]) == PROJECT["project"]["version"]
    assert cited["license"] == PROJECT["project"]["license"]
    assert cited["abstract"] == PROJECT["project"]["description"]
    assert cited["keywords"] == PROJECT["project"]["keywords"]
    for work in (cited, *cited["references"]):
        assert work["authors"]
        assert all({"name"} <= set(one) or {"family-names"} <= set(one) for one in work["authors"])
        assert work["title"]


def test_entry_points_lead_to_names() -> None:
    groups = PROJECT["project"]["entry-points"] | {"scripts": PROJECT["project"]["scripts"]}
    values = [value for entries in groups.values() for value in entries.values() if ":" in value]
    values += [origin.value for origin in installed_patterns().values() if not origin.is_file]
    places = [value.partition(":") for value in values]
    missing = [
        f"{module}:{name}" for module, _, name in places if not hasattr(import_module(module), name)
    ]
    assert missing == []


def _folder(package: str) -> str:
    mapping: dict[str, str] = SETUPTOOLS["package-dir"]
    return mapping.get(package, package.replace(".", "/"))
