"""The check of .ci/build-wheels and of a release: has a wheel all compiled kernels?"""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
CHECK = runpy.run_path(str(ROOT / ".ci" / "check-wheel"))


@pytest.mark.parametrize("kind", ["abi3", "cpython-312-x86_64-linux-gnu"])
def test_a_wheel_that_lacks_a_library_is_named(kind: str) -> None:
    sources = [path.relative_to(ROOT) for path in ROOT.glob("swarmd/**/*.py")]
    assert "swarmd._trusted" in CHECK["lacking"]([str(path) for path in sources])
    complete = [
        name if name.endswith(".pxd") else f"{name.replace('.', '/')}.{kind}.so"
        for name in CHECK["lacking"]([])
    ]
    assert f"swarmd/_trusted.{kind}.so" in complete
    assert CHECK["lacking"](complete) == []
    assert CHECK["lacking"](complete[1:]) == [complete[0].partition(".")[0].replace("/", ".")]
