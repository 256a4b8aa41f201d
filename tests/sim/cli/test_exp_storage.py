"""Experiments on a machine whose folders are read-only, full or missing: one line says which."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.swarmctl import SWARMCTL

pytestmark = [
    pytest.mark.integration,
    pytest.mark.long,
    pytest.mark.skipif(
        os.geteuid() != 0 or not all(map(shutil.which, ("unshare", "mount"))),
        reason="needs root, unshare and mount",
    ),
]
SCENARIO = "duration: 0.2\ngroups: {a: {platform: burger, count: 2, pattern: attraction}}\n"
READ_ONLY = "mount --bind {0} {0} && mount -o remount,bind,ro {0}"
NO_ROOM = "mount -t tmpfs -o size=4k none {0} && printf %4096s x > {0}/fill"
MISSING = (
    "mount -t tmpfs none dev && touch dev/null dev/urandom && mount --bind /dev/null dev/null"
    " && mount --bind /dev/urandom dev/urandom && mount --rbind dev /dev"
)
TEMPORARY = (
    "for one in /tmp /var/tmp /usr/tmp . ; do [ ! -d $one ] || { mount --bind $one $one"
    " && mount -o remount,bind,ro $one ; } ; done && cd $PWD && mount -t tmpfs none out"
)
CASES = {
    "shm read-only": (READ_ONLY.format("/dev/shm"), "/dev/shm: Read-only file", "--cores 1"),
    "shm full": (NO_ROOM.format("/dev/shm"), "/dev/shm: No space left", "--cores 1"),
    "shm missing": (MISSING, "/dev/shm: ", "--cores 1"),
    "temporary folders": (TEMPORARY, "No usable temporary directory", "TMPDIR"),
    "results read-only": (READ_ONLY.format("out"), "out/e: Read-only file system", "--out"),
    "results full": (NO_ROOM.format("out"), "out/e: No space left on device", "--out"),
}


@pytest.mark.parametrize("case", CASES)
def test_what_cannot_be_written_is_named_with_a_remedy(tmp_path: Path, case: str) -> None:
    mounts, place, remedy = CASES[case]
    (tmp_path / "one.yaml").write_text(SCENARIO)
    for name in ("dev", "out"):
        (tmp_path / name).mkdir()
    words = ("exp", "run", "one.yaml", "--seeds", "1", "--cores", "2", "--out", "out/e")
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", f'{mounts} && exec "$@"', "sh", *SWARMCTL, *words],
        cwd=tmp_path,
        env={name: value for name, value in os.environ.items() if name not in ("TMPDIR", "TEMP")},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    (line,) = (line for line in done.stderr.splitlines() if place in line)
    assert done.returncode in (1, 2), done.stderr
    assert remedy in line
    assert "Traceback" not in done.stderr
