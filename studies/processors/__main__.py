"""Which bits of a run depend on the processor, and which functions give other bits there.

`python -m studies.processors variants` runs the scenarios of SCENARIOS for some seconds in each
variant of this machine (other functions of glibc and numpy on x86-64, interpreted kernels, two
processes, another hash seed). It prints the table of docs/evidence/simulation.md: which traces
differ, where, and which functions, sums, products and steps give other bits for the same arguments.
The same command resumes. The exit code is 1 if a variant of the program alone differs, or if traces
differ and no function does. `traces` and `compare` do the same for two machines: `make arm64`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.table import markdown
from studies import keeper, kept
from studies.processors.runs import (
    SCENARIOS,
    Variant,
    differences,
    differing_facts,
    run_variant,
    variants,
    write_traces,
)


def main(words: Sequence[str] | None = None) -> int:
    """Run one of the commands; returns its exit code."""
    args = _parser().parse_args(words)
    if args.command == "traces":
        write_traces(args.folder, args.only, share=args.share, cores=args.cores)
        return 0
    if args.command == "compare":
        return compare(args.a, args.b)
    of_these = f"{args.share}-{len(args.only)}"
    folder = args.folder or keeper.experiment_folder("processors.__main__") / of_these
    return run_all(folder, args.only, args.share)


def run_all(folder: Path, names: Sequence[str], share: float) -> int:
    """Run all variants, and print a row for each."""
    run_variant(Variant({}), folder / "here", names, share)
    run_variant(Variant({}, is_pinned=True), folder / "pinned", names, share)
    is_good = True
    rows = [["compared with this processor", "equal", "what gives other bits", "first difference"]]
    for name, variant in variants().items():
        there = folder / name.replace(" ", "-")
        run_variant(variant, there, names, share)
        here = folder / ("pinned" if variant.is_pinned else "here")
        found = differences(here, there)
        facts = [name for name in differing_facts(here, there) if name != "kernels"]
        others = [f"`{scenario}`: {text}" for scenario, text in found.items() if text]
        is_good &= not others or (bool(facts) and not variant.is_equal)
        equal = f"{len(found) - len(others)} of {len(found)}"
        rows.append([name, equal, ", ".join(facts) or "nothing", "; ".join(others) or "-"])
    kept.print_parts({"processors": markdown(rows)})
    return int(not is_good)


def compare(a: Path, b: Path) -> int:
    """Print how the traces of two folders differ; the exit code is 1 if a trace does."""
    found = differences(a, b)
    for scenario, text in found.items():
        print(f"{scenario}: {text or 'equal'}")
    print(f"differs: {', '.join(differing_facts(a, b)) or 'nothing'}")
    return int(any(found.values()))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="studies.processors", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    for name in ("variants", "traces"):
        command = commands.add_parser(name)
        command.add_argument("folder", type=Path, nargs="?" if name == "variants" else None)
        command.add_argument("--only", nargs="+", choices=SCENARIOS, default=[*SCENARIOS])
        command.add_argument("--share", type=float, default=1.0, help="of the seconds of each")
        command.add_argument("--cores", type=int, default=1, help="processes of a run")
    command = commands.add_parser("compare")
    command.add_argument("a", type=Path)
    command.add_argument("b", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
