"""Which plugins the store of runs takes: those whose source follows from their files alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from swarmd.sim.experiments.plugin_look import look_at

ROOT = Path(__file__).resolve().parents[3]
SELF_CONTAINED = sorted(
    (
        *(ROOT / "examples" / f"{name}.py" for name in ("beeclust", "diffusion", "push", "shy")),
        *(ROOT / "examples" / f"{name}.py" for name in ("approach_tag", "waiting_walk")),
        ROOT / "examples" / "metrics" / "warm.py",
    )
)
PURE = {
    "numpy": "import numpy as np\nx = np.hypot(3.0, 4.0) + np.linalg.norm(np.zeros(2))",
    "a generator in an annotation": "import numpy as np\ndef f(rng: np.random.Generator): ...",
    "a generator by its name": "from numpy.random import Generator\ndef f(rng: Generator): ...",
    "own random numbers": "def f(rng):\n    return rng.random() + rng.uniform(0, 1)",
    "a generator with a seed": "import numpy as np\nrng = np.random.default_rng(3)",
    "the same, imported": "from numpy.random import default_rng\nrng = default_rng(seed=3)",
    "methods of these names": "class A:\n    def load(self): return self.open()",
    "an attribute by its name": "x = getattr(1.0, 'real')",
    "standard library": "import math, heapq\nfrom collections import deque\nx = math.pi",
    "scipy": "from scipy.spatial import cKDTree\nfrom scipy.optimize import linear_sum_assignment",
    "msgspec": "import msgspec\nfrom msgspec import Meta",
    "a trace": "from swarmd.sim.trace import Trace\ndef f(trace: Trace): return trace.pose.sum()",
    "a metric": "from swarmd.sim.metrics.own import metric\n@metric(unit='m')\ndef f(trace): ...",
    "patterns of ours": "from swarmd.patterns.attraction.pattern import Attraction",
}
OPEN = {
    "an operating system": "import os",
    "a part of it": "from os import environ",
    "a module below": "import os.path as path",
    "another package": "import torch",
    "metrics beside a pattern": "from swarmd.patterns.flocking.metrics import parts",
    "the same as a module": "from swarmd.patterns.flocking import metrics",
    "a sibling by its name": "import helper",
    "a relative import of a single file": "from .gains import TURN",
    "a file": "x = open('weights.txt').read()",
    "a path": "from pathlib import Path",
    "a file by numpy": "import numpy as np\nx = np.load('w.npy')",
    "a file by another name of numpy": "import numpy\nx = numpy.loadtxt('w.txt')",
    "a file by an imported function": "from numpy import fromfile",
    "a file by a deep name": "import numpy as np\nx = np.lib.npyio.DataSource('w')",
    "a module that is handed on": "import numpy as np\nn = np\nx = n.load('w.npy')",
    "a file by an array": "def f(x):\n    x.tofile('w')",
    "a file of a trace": "from swarmd.sim.trace import load_trace",
    "a method of a class": "from swarmd.sim.trace import Trace\nt = Trace.load('x')",
    "a module of ours that reads": "from swarmd.core.files import read_regular",
    "swarmd itself": "import swarmd",
    "a simulation": "from swarmd import simulate",
    "a metric that loads a file": "from swarmd.sim.metrics.own import metric_of_file",
    "the clock": "import time",
    "today": "from datetime import date",
    "random numbers": "import random",
    "random numbers of numpy": "import numpy as np\nx = np.random.rand()",
    "a generator without a seed": "import numpy as np\nrng = np.random.default_rng()",
    "a generator with None": "import numpy as np\nrng = np.random.default_rng(None)",
    "a generator with a word of no default": (
        "import numpy as np\ndef make(seed=None): return np.random.default_rng(seed)"
    ),
    "a generator with a field that is None": (
        "import numpy as np\nclass A:\n    seed: int | None = None\n"
        "    def make(self): return np.random.default_rng(self.seed)"
    ),
    "eigenvectors from a start by chance": "from scipy.sparse.linalg import eigsh",
    "a matrix by chance": "from scipy import sparse\nx = sparse.random_array((2, 2))",
    "samples": "import statistics\nx = statistics.NormalDist(0, 1).samples(3)",
    "the time of day": "import numpy as np\nx = np.datetime64('now')",
    "a generator that is handed on": "from numpy.random import default_rng\nx = [default_rng]",
    "a hash of a text": "x = hash('a')",
    "an address": "x = id([])",
    "code in a text": "x = eval('1')",
    "an import by a function": "x = __import__('os')",
    "an import by a module": "import importlib",
    "where it lies": "x = __file__",
    "an attribute by a computed name": "def f(a, b):\n    return getattr(a, b)",
    "an attribute that is hidden": "import numpy as np\nx = getattr(np.lib, 'load')",
    "builtins by a class": "x = ().__class__.__base__.__subclasses__()",
    "builtins by a function": "def f(): ...\nx = f.__globals__",
    "all names": "from numpy import *",
    "a process": "import subprocess",
    "native code": "import ctypes",
    "native code of numpy": "import numpy as np\nx = np.ctypeslib.load_library('a', 'b')",
    "in a function": "def f():\n    import os",
    "in a class": "class A:\n    import os",
    "what is no Python": "def f(:",
}


@pytest.mark.parametrize("file", SELF_CONTAINED, ids=lambda file: file.stem)
def test_examples_are_self_contained(file: Path) -> None:
    assert look_at(file).fault == ""


@pytest.mark.parametrize("source", PURE.values(), ids=PURE)
def test_arithmetic_is_self_contained(tmp_path: Path, source: str) -> None:
    (tmp_path / "mine.py").write_text(source)
    assert look_at(tmp_path / "mine.py").fault == ""


@pytest.mark.parametrize("source", OPEN.values(), ids=OPEN)
def test_what_leads_outside_is_refused(tmp_path: Path, source: str) -> None:
    (tmp_path / "mine.py").write_text(source)
    assert look_at(tmp_path / "mine.py").fault.startswith("mine.py")


def test_the_line_is_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import math\n\nimport os\nimport sys\n")
    assert look_at(tmp_path / "mine.py").fault.startswith("mine.py:3 ")


def test_the_modules_of_a_folder_are_followed(tmp_path: Path) -> None:
    folder = tmp_path / "swirl"
    (folder / "parts").mkdir(parents=True)
    (folder / "pattern.py").write_text("from .gains import TURN\nfrom . import parts\n")
    (folder / "gains.py").write_text("from .parts.deep import TURN\n")
    (folder / "parts" / "__init__.py").write_text("")
    (folder / "parts" / "deep.py").write_text("from .. import more\nTURN = 'dispersion'\n")
    (folder / "more.py").write_text("")
    (folder / "plots.py").write_text("import matplotlib\n")  # nothing imports it
    found = look_at(folder / "pattern.py")
    assert found.fault == ""
    assert "dispersion" in found.texts
    (folder / "more.py").write_text("import os\n")
    assert look_at(folder / "pattern.py").fault.startswith("more.py:1 ")
    (folder / "more.py").write_text("from ... import outside\n")
    assert look_at(folder / "pattern.py").fault.startswith("more.py:1 ")
    (folder / "more.py").unlink()
    (folder / "gains.py").unlink()
    assert look_at(folder / "pattern.py").fault.startswith("pattern.py:1 ")


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    assert look_at(tmp_path / "none.py").fault.startswith("none.py")
    (tmp_path / "latin.py").write_bytes(b"x = '\xff'")
    assert look_at(tmp_path / "latin.py").fault.startswith("latin.py")
