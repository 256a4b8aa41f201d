"""Small changes of the code that decides motion, and the tests that notice them.

`python -m studies.mutants sample --draw 600 [--seed 1]` draws changes of all files of DECIDES.
`python -m studies.mutants of COMMIT` makes all changes of the functions, tables and constants there
that a commit or a range (`COMMIT..`, `A..B`) touched. Both print a line for each mutant and a table
by folder. A mutant that no test notices survives.

The first N mutants of a draw are the draw of N, so that a part of a draw is a fair sample, too.
Verdicts are kept in build/mutants, by the digest of sources and tests: the same command goes on
where it was ended. studies/mutant_runs.py runs the tests.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from swarmd.core.kernels import KERNELS, source_of

ROOT = Path(__file__).resolve().parent.parent
TESTS = {
    path: f"tests/{Path(path).parent.as_posix().removeprefix('swarmd/')}"
    for path in map(source_of, KERNELS)
}
"""By the file of a kernel, the folder of its tests."""
DECIDES = {
    "swarmd/protection": "",
    "swarmd/robot": "",
    "swarmd/steering": "",
    "swarmd/sensing": "",
    "swarmd/core": """angles arrival_delay avoided bounds clock closing codec events goal hazard
        host_messages low_battery messages numbers record threads token_bucket values verbs""",
    "swarmd/driver_api": "",
    "swarmd/daemon": """connection daemon datagram_guard driver driver_commands
        goal_service neighbors network requests robot_setup tick_timer""",
    "swarmd/network/stops": "",
    "swarmd/network/spread": "",
    "swarmd/network/members": "",
    "swarmd/network/operator": """clock_query discovery operator operator_admission
        operator_datagrams operator_goals outcome repeat_timer request_sender stop_origin
        stop_request stop_sender""",
    "swarmd/network/carriers": """arrival_time bus inbound_queue recipients robot_link routed
        udp""",
    "swarmd/network": "access datagram peer signature",
    "swarmd/client": "ask_robots canary goals run_lease runs stops targets waits",
    "drivers/crazyflie": "driver flight link sensors",
    "drivers/ros": """absence cdr command_type foreign_commands from_ros messages stop_topics
        subscriptions to_ros topic_detections topic_hazards topic_inputs topic_readings
        zero_answers""",
    "drivers/ros1": "adapter adapter_process driver",
    "drivers/ros2": """command_credit dds_bridge driver request_age rmw_zenoh services
        zero_sender""",
    "drivers": "latest_samples simulated",
}
"""By folder, the names of the files that decide motion; without names, all files below it.

Not in it are files that store, record, print, start processes or show, and the emulators.
"""
HUNK = re.compile(r"^@@ -\S+ \+(\d+)(?:,(\d+))? @@", re.MULTILINE)
OPERATORS: dict[type[ast.AST], tuple[type[ast.AST], str]] = {
    ast.Add: (ast.Sub, "+ to -"),
    ast.Sub: (ast.Add, "- to +"),
    ast.Mult: (ast.Div, "* to /"),
    ast.Div: (ast.Mult, "/ to *"),
    ast.Lt: (ast.GtE, "< to >="),
    ast.LtE: (ast.Gt, "<= to >"),
    ast.Gt: (ast.LtE, "> to <="),
    ast.GtE: (ast.Lt, ">= to <"),
    ast.And: (ast.Or, "and to or"),
    ast.Or: (ast.And, "or to and"),
    ast.Eq: (ast.NotEq, "== to !="),
    ast.NotEq: (ast.Eq, "!= to =="),
    ast.Is: (ast.IsNot, "is to is not"),
    ast.IsNot: (ast.Is, "is not to is"),
    ast.In: (ast.NotIn, "in to not in"),
    ast.NotIn: (ast.In, "not in to in"),
}
TABLES = (ast.Set, ast.Dict)
"""Displays whose first entry a mutant drops."""
BRANCHES = (ast.If, ast.While, ast.IfExp)
BARE = (ast.Name, ast.Attribute, ast.Call, ast.Subscript, ast.NamedExpr)
"""Conditions without an operator, which a mutant negates."""
EXTREMES = {"min": "max", "max": "min"}
LEFT_OUT = {"decorator_list", "annotation", "returns"}
"""Fields of nodes that are not changed: types, and directives for the compiler of kernels."""
UNCHANGED = -1
"""The number of a mutant that changes nothing, for a control."""


@dataclass(frozen=True)
class Mutant:
    """The change of place `number` of the file `path`."""

    path: str
    number: int


def places(tree: ast.Module) -> Iterator[tuple[ast.AST, str]]:
    """The nodes that a mutant changes, each with its function; empty for a part of the module.

    Texts are left out (no test pins wording), and so are conditions outside functions.
    """
    yield from _places(tree, "")


def _places(node: ast.AST, function: str) -> Iterator[tuple[ast.AST, str]]:
    if isinstance(node, ast.JoinedStr | ast.Assert):
        return
    kind = _kind(node)
    if kind is not None and (function or kind is not ast.Not):
        yield node, function
    left_out = {*LEFT_OUT, "keywords"} if isinstance(node, ast.ClassDef) else LEFT_OUT
    if isinstance(node, ast.If) and not function:
        left_out = {"test"}
    for field, value in ast.iter_fields(node):
        # Defaults of arguments are of the module.
        inside = function
        if field == "body" and isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            inside = node.name
        if field not in left_out:
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _places(child, inside)


def _kind(node: ast.AST) -> type[ast.AST] | None:
    """What can be changed: an operator's type, Not for a condition, or the type of the node."""
    if isinstance(node, ast.BinOp | ast.AugAssign | ast.BoolOp):
        found: ast.AST = node.op
    elif isinstance(node, ast.Compare):
        found = node.ops[0]
    elif isinstance(node, BRANCHES):
        return ast.Not if isinstance(node.test, BARE) else None
    elif isinstance(node, ast.UnaryOp):
        return ast.Not if isinstance(node.op, ast.Not) else None
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return ast.Call if node.func.id in EXTREMES and node.args[1:] else None
    elif isinstance(node, ast.Constant) and type(node.value) in (float, bool):
        return ast.Constant if node.value or node.value is False else None
    elif isinstance(node, TABLES) and _entries(node):
        return type(node)
    else:
        return None
    return type(found) if type(found) in OPERATORS else None


def _entries(table: ast.AST) -> Sequence[ast.expr]:
    if isinstance(table, ast.Set):
        return table.elts
    return table.values if isinstance(table, ast.Dict) else ()


def mutate(node: ast.AST) -> str:
    """Change the node in place; what was changed."""
    if isinstance(node, ast.Constant):
        before = node.value
        node.value = not before if isinstance(before, bool) else 1.5 * float(repr(before))
        return f"{before!r} to {node.value!r}"
    if isinstance(node, TABLES):
        dropped = node.elts.pop(0) if isinstance(node, ast.Set) else node.keys.pop(0)
        if isinstance(node, ast.Dict):
            node.values.pop(0)
        return f"without {ast.unparse(dropped) if dropped else 'its first part'}"
    if isinstance(node, BRANCHES):
        text = ast.unparse(node.test)
        node.test = ast.copy_location(ast.UnaryOp(ast.Not(), node.test), node.test)
        return f"{text} to not {text}"
    if isinstance(node, ast.UnaryOp):
        text = ast.unparse(node.operand)
        node.operand = ast.copy_location(ast.UnaryOp(ast.Not(), node.operand), node.operand)
        return f"not {text} to {text}"
    if isinstance(node, ast.Call):
        assert isinstance(node.func, ast.Name)
        before = node.func.id
        node.func.id = EXTREMES[before]
        return f"{before} to {node.func.id}"
    kind = _kind(node)
    assert kind is not None
    new, text = OPERATORS[kind]
    if isinstance(node, ast.Compare):
        node.ops[0] = new()  # type: ignore[call-overload]  # the table pairs comparisons
    else:
        node.op = new()  # type: ignore[attr-defined]  # the table pairs operators
    return text


def mutated(mutant: Mutant) -> tuple[ast.Module, str]:
    """The tree of the changed file, with the lines of the file, and a line that describes it."""
    tree = ast.parse((ROOT / mutant.path).read_text())
    if mutant.number == UNCHANGED:
        return tree, f"{mutant.path}: unchanged"
    node, function = list(places(tree))[mutant.number]
    place = f"{mutant.path}:{getattr(node, 'lineno', 0)} {function or 'module'}"
    text = f"{place}: {mutate(node)}"
    return ast.fix_missing_locations(tree), text


def files() -> list[str]:
    """The files of DECIDES, sorted."""
    found = set()
    for folder, names in DECIDES.items():
        chosen = [f"{name}.py" for name in names.split()]
        paths = [ROOT / folder / one for one in chosen] or (ROOT / folder).rglob("*.py")
        found |= {path.relative_to(ROOT).as_posix() for path in paths}
    return sorted(found)


def folder_of(path: str) -> str:
    """The row of the table in which a file counts, such as swarmd/core or drivers."""
    parts = Path(path).parts[:-1]
    return parts[0] if parts[0] == "drivers" else "/".join(parts[:2])


def everywhere() -> list[Mutant]:
    """All mutants of the files of DECIDES."""
    return [
        Mutant(path, number)
        for path in files()
        for number, _ in enumerate(places(ast.parse((ROOT / path).read_text())))
    ]


def drawn(mutants: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """A random sample, of which each beginning is the sample of that size."""
    order = [*mutants]
    random.Random(seed).shuffle(order)
    return order[:count]


def of_commits(commits: str) -> list[Mutant]:
    """The mutants of all functions, tables and constants that the commits touched, as they are."""
    commits = commits if ".." in commits else f"{commits}^!"
    command = ["git", "-C", str(ROOT), "diff", "--unified=0", "--diff-filter=d", commits, "--"]
    done = subprocess.run([*command, *DECIDES], capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"no commits {commits!r} here; expected COMMIT, COMMIT.. or A..B")
    found: list[Mutant] = []
    decides = {*files()}
    for part in done.stdout.split("\n+++ b/")[1:]:
        path = part.partition("\n")[0]
        if path in decides:
            spans = ((int(first), int(count or 1)) for first, count in HUNK.findall(part))
            lines = {line for first, count in spans for line in range(first, first + count)}
            found += [Mutant(path, n) for n in touched((ROOT / path).read_text(), lines)]
    return found


def touched(source: str, lines: set[int]) -> list[int]:
    """The numbers of the places in functions, tables and constants that have one of these lines."""
    tree = ast.parse(source)
    spans = [
        range(node.lineno, (node.end_lineno or node.lineno) + 1)
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Assign | ast.AnnAssign)
    ]
    near = {line for span in spans if lines & {*span} for line in span}
    return [n for n, (node, _) in enumerate(places(tree)) if getattr(node, "lineno", 0) in near]


def table(mutants: Sequence[Mutant], judged: Sequence[tuple[str, bool]]) -> str:
    """Markdown: by folder, how many mutants there are, were judged, and survived.

    `judged` has the path of each judged mutant, and whether it survived.
    """
    lines = ["| folder | mutants | judged | killed | survived |", "|---|---|---|---|---|"]
    for folder in [*dict.fromkeys(folder_of(path) for path in files()), "all"]:
        whole = [one for one in mutants if folder in ("all", folder_of(one.path))]
        part = [survived for path, survived in judged if folder in ("all", folder_of(path))]
        if whole:
            counts = len(whole), len(part), len(part) - sum(part), sum(part)
            lines.append(f"| `{folder}` | {' | '.join(map(str, counts))} |")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.mutants", description=__doc__)
    parser.add_argument("what", choices=("sample", "of"))
    parser.add_argument("commits", nargs="?", metavar="COMMIT", help="COMMIT, COMMIT.. or A..B")
    parser.add_argument("--draw", type=int, metavar="N", help="judge N mutants [all]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--under", default="", metavar="PATH", help="judge those of files below it")
    parser.add_argument(
        "--seconds",
        type=float,
        default=20.0,
        metavar="S",
        help="s of CPU of the tests of one mutant at most [20]; more judges only survivors again",
    )
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="mutants at a time [2]")
    options = parser.parse_args(arguments)
    if (options.what == "of") != (options.commits is not None):
        parser.error("name commits with `of`, such as `of HEAD` or `of v0.1..`")
    whole = everywhere() if options.what == "sample" else of_commits(options.commits)
    count = len(whole) if options.draw is None else options.draw
    from studies.mutant_runs import FOLDERS, judge_all, near  # needs pytest

    chosen = drawn(whole, count, options.seed)
    chosen = [one for one in chosen if one.path.startswith(options.under)]
    folders = dict.fromkeys(name for one in chosen for name in near(one.path))
    is_all = options.what == "sample" and not options.under
    verdicts = judge_all(
        chosen,
        jobs=options.jobs,
        most=options.seconds,
        folders=FOLDERS if is_all else [*folders],
    )
    survivors = [one for one in verdicts if one.survived]
    print()
    print("\n".join(f"SURVIVED  {one.text}" for one in survivors))
    print()
    print(table(whole, [(one.path, one.survived) for one in verdicts]))
    # Not before: the tests of mutants are to be the first to import modules of swarmd.
    from swarmd.sim.experiments.statistics import wilson

    killed = len(verdicts) - len(survivors)
    least, most = wilson(killed, len(verdicts)) if verdicts else (0.0, 1.0)
    print(
        f"\n{killed} of {len(verdicts)} mutants were noticed: {killed / max(len(verdicts), 1):.0%}"
        f" (95 % interval {least:.0%} to {most:.0%});"
        f" {sum(one.cpu for one in verdicts):.0f} s of CPU without the tests of the code as it is"
    )


if __name__ == "__main__":
    main()
