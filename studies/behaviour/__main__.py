"""Writes the ledger of behaviours: `make behaviour`.

Prints a line for each robot that drives otherwise than the ledger says, and writes the ledger
again. With `--against REV` it builds that commit in build/behaviour, simulates the scenes there and
here, and prints by how much robots drive otherwise; it writes no ledger then. `--only SCENE ...`
takes some of the scenes, and writes none either. `--check` writes none, and ends with code 1 if a
robot drives otherwise. `--interpreted`: with interpreted kernels, eleven times as dear.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec

from studies.behaviour.ledger import (
    FILE,
    Ledger,
    by_how_much,
    described,
    differences,
    drives_of,
    note,
    read,
    write,
)
from studies.behaviour.scenes import ROOT, SCENES, SEED
from swarmd.core.errors import ConfigError, SwarmError, unknown
from swarmd.core.pin import pinned_environment
from swarmd.sim.experiments.cores import usable_cores
from swarmd.sim.trace import Trace, load_trace

PROGRAM = Path(__file__).with_name("measure.py")
BUILDS = ROOT / "build" / "behaviour"


def main(words: Sequence[str] | None = None) -> int:
    """Do what the command line asks; returns the exit code."""
    parser = argparse.ArgumentParser(prog="studies.behaviour", description=__doc__)
    parser.add_argument("--against", metavar="REV", help="compare with a commit")
    parser.add_argument("--only", nargs="+", metavar="SCENE", help="these scenes alone")
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--interpreted", action="store_true", help="with interpreted kernels")
    options = parser.parse_args(words)
    names = options.only or [*SCENES]
    for name in names:
        if name not in SCENES:
            raise ConfigError(unknown("scene", name, SCENES))
    if options.against is not None:
        return compare(options.against, names)
    is_whole = options.only is None
    is_written = is_whole and not options.check and not options.interpreted
    if is_written and note()["pinned"] != "yes":
        raise SwarmError(
            "this machine's workers are not pinned, so no other machine could compare the ledger;"
            " --check compares without writing it"
        )
    with TemporaryDirectory(prefix="swarmd-behaviour-") as folder:
        traces = simulated(Path(folder), ROOT, names, is_compiled=not options.interpreted)
    now = {name: drives_of(trace) for name, trace in traces.items()}
    kept = read() if FILE.exists() else Ledger({}, {})
    chosen = kept.scenes if is_whole else {n: s for n, s in kept.scenes.items() if n in now}
    found = [described(one) for one in differences(chosen, now)]
    if other := kept.other_software():
        print(f"not comparable with {FILE.name}: {other}", file=sys.stderr)
    print("\n".join(found) or f"all {len(now)} scenes: every robot drives as before")
    if not is_written:
        return 1 if found else 0
    write(Ledger(note(), now))
    print(f"{FILE.relative_to(ROOT)} is written; the commit says what changed for users")
    return 0


def compare(revision: str, names: Sequence[str]) -> int:
    """Print how robots drive here and in a commit; the exit code is 1 if any drives otherwise."""
    there = built(revision)
    with TemporaryDirectory(prefix="swarmd-behaviour-") as temporary:
        folder = Path(temporary)
        before = simulated(folder / "before", there, names)
        after = simulated(folder / "after", ROOT, names)
    drives = [
        {name: drives_of(trace) for name, trace in traces.items()} for traces in (before, after)
    ]
    found = [*differences(*drives)]
    for scene, robot, text in found:
        more = ""
        if text.startswith("drives"):
            more = f" ({by_how_much(before[scene], after[scene], robot)})"
        print(f"{described((scene, robot, text))}{more}")
    if not found:
        print(f"all {len(after)} scenes: every robot drives as in {revision}")
    return 1 if found else 0


def simulated(
    folder: Path, checkout: Path, names: Sequence[str], *, is_compiled: bool = True
) -> dict[str, Trace]:
    """The traces of scenes by the code of a checkout, in pinned processes.

    Without those that an earlier commit cannot make. SwarmError if this checkout cannot make one,
    and if a process fails.
    """
    folder.mkdir(parents=True, exist_ok=True)
    environment = pinned_environment()
    environment |= {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
    if not is_compiled:
        environment["SWARMD_COMPILED"] = "0"
    count = min(usable_cores(), len(names))
    processes = []
    for number in range(count):
        share = {name: _plain(name) for name in names[number::count]}
        scenes = folder / f"scenes-{number}.json"
        scenes.write_text(json.dumps(share))
        command = [sys.executable, "-P", str(PROGRAM), str(folder), str(scenes)]
        processes.append(subprocess.Popen(command, env=environment, cwd=checkout))
    codes = [process.wait() for process in processes]
    if any(codes):
        raise SwarmError(f"{checkout}: the scenes could not be simulated; see the lines above")
    errors = [f"{one.stem}: {one.read_text().strip()}" for one in sorted(folder.glob("*.error"))]
    if errors and checkout == ROOT:
        raise SwarmError("; ".join(errors))
    for text in errors:  # an earlier commit may lack a scene
        print(f"{checkout.name[:8]}: {text}", file=sys.stderr)
    return {path.stem: load_trace(path) for path in sorted(folder.glob("*.npz"))}


def _plain(name: str) -> Mapping[str, object]:
    scene: dict[str, object] = msgspec.to_builtins(SCENES[name])
    return {**scene, "seed": SEED}


def built(revision: str) -> Path:
    """The folder of a commit, with compiled kernels; ConfigError if there is no such commit.

    A build takes two CPU-minutes, since files of an archive are newer than those of this checkout.
    """
    done = subprocess.run(
        ["git", "-C", str(ROOT), "rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}"],
        capture_output=True,
        text=True,
        check=False,
    )
    commit = done.stdout.strip()
    if not commit:
        raise ConfigError(f"--against {revision}: no such commit here; see git log")
    folder = BUILDS / commit
    if (folder / "built").exists():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    archive = subprocess.run(
        ["git", "-C", str(ROOT), "archive", commit], capture_output=True, check=True
    )
    with tarfile.open(fileobj=BytesIO(archive.stdout)) as tar:
        tar.extractall(folder, filter="data")
    for cached in ("cython", "joined"):
        if (ROOT / "build" / cached).is_dir():
            shutil.copytree(ROOT / "build" / cached, folder / "build" / cached)
    for library in ROOT.glob("*/**/*.so"):
        place = library.relative_to(ROOT)
        if place.parts[0] in ("swarmd", "sim", "patterns", "drivers") and not _is_link(place):
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(library, folder / place)
    print(f"{revision} is built in {folder.relative_to(ROOT)}", file=sys.stderr, flush=True)
    subprocess.run(
        [sys.executable, "setup.py", "--quiet", "build_ext", "--inplace"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        check=True,
        stdout=sys.stderr,
    )
    (folder / "built").touch()
    return folder


def _is_link(place: Path) -> bool:
    """Whether a path leads through a link of `swarmd/` to another top-level folder."""
    return any((ROOT / parent).is_symlink() for parent in place.parents)


if __name__ == "__main__":
    try:
        raise SystemExit(main())
    except SwarmError as error:
        raise SystemExit(f"error: {error}") from error
