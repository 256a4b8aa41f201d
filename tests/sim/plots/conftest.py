"""The folder of a real experiment."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

GATHERING = """\
duration: 3
arena: {size: [5, 5]}
groups:
  all: {platform: burger, count: 3, prefix: r, pattern: attraction, start: {layout: random}}
"""


@pytest.fixture(scope="session")
def conducted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an experiment of two variants and three seeds, for reading alone."""
    pytest.importorskip("mujoco")
    from swarmd.sim.experiments.simulate import simulate

    folder = tmp_path_factory.mktemp("conducted")
    (folder / "gathering.yaml").write_text(GATHERING)
    laws = {"groups.all.parameters.law": ["settling", "paper"]}
    simulate(folder / "gathering.yaml", 3, sweep=laws, out=folder / "x")
    return folder / "x"


@pytest.fixture
def experiment(conducted: Path, tmp_path: Path) -> Path:
    """The same for a test's own use."""
    return Path(shutil.copytree(conducted, tmp_path / "x"))
