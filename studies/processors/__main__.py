"""Which bits of a run depend on the processor, and which functions give other bits there.

`python -m studies.processors variants FOLDER` runs the scenarios of SCENARIOS for some seconds in
each variant of this machine (other functions of glibc and numpy on x86-64, interpreted kernels, two
processes, another hash seed). It prints which traces differ, where, and which functions, sums,
products and steps give other bits for the same arguments. The exit code is 1 if a variant of the
program alone differs, or if traces differ and no function does. `traces` and `compare` do the same
for two machines: `make arm64`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

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
    return run_all(args.folder, args.only, args.share)


def run_all(folder: Path, names: Sequence[str], share: float) -> int:
    """Run all variants; prints a row for each variant and scenario that differs."""
    run_variant(Variant({}), folder / "here", names, share)
    is_good = True
    for name, variant in variants().items():
        there = folder / name.replace(" ", "-")
        run_variant(variant, there, names, share)
        found = differences(folder / "here", there)
        equal = [scenario for scenario, text in found.items() if not text]
        print(f"\n{name}: {len(equal)} of {len(found)} traces equal")
        if facts := differing_facts(folder / "here", there):
            print(f"  differs: {', '.join(facts)}")
        is_good &= len(equal) == len(found) or (bool(facts) and not variant.is_equal)
        for scenario, text in found.items():
            if text:
                print(f"  {scenario}: {text}")
        sys.stdout.flush()
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
        command.add_argument("folder", type=Path)
        command.add_argument("--only", nargs="+", choices=SCENARIOS, default=[*SCENARIOS])
        command.add_argument("--share", type=float, default=1.0, help="of the seconds of each")
        command.add_argument("--cores", type=int, default=1, help="processes of a run")
    command = commands.add_parser("compare")
    command.add_argument("a", type=Path)
    command.add_argument("b", type=Path)
    return parser


if __name__ == "__main__":
    sys.exit(main())
