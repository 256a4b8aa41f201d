"""The check of .ci/build-wheels and of a release: has a wheel all compiled kernels?"""

from __future__ import annotations

import runpy
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECK = runpy.run_path(str(ROOT / ".ci" / "check-wheel"))


def test_a_wheel_that_lacks_a_library_is_named() -> None:
    sources = [path.relative_to(ROOT) for path in ROOT.glob("swarmd/**/*.py")]
    assert "swarmd._trusted" in CHECK["lacking"]([str(path) for path in sources])
    complete = [
        name if name.endswith(".pxd") else f"{name.replace('.', '/')}.abi3.so"
        for name in CHECK["lacking"]([])
    ]
    assert "swarmd/_trusted.abi3.so" in complete
    assert CHECK["lacking"](complete) == []
    assert CHECK["lacking"](complete[1:]) == [complete[0].partition(".")[0].replace("/", ".")]
