"""Gives each robot a chance of its own, also where a node uses the generators of the process."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from uuid import UUID

import numpy as np
from numpy.random import Generator

# Taken here: while a contract of patterns is tested, the names of the modules are forbidden.
_get_state: Callable[[], Any] = random.getstate
_set_state: Callable[[Any], None] = random.setstate
_seed: Callable[..., None] = random.seed
_get_numpy: Callable[[], Any] = getattr(np.random, "get_bit_generator")  # noqa: B009  # no stub
_set_numpy: Callable[[Any], None] = getattr(np.random, "set_bit_generator")  # noqa: B009
_seed_numpy: Callable[..., None] = np.random.seed
_make_numpy: Callable[..., Generator] = np.random.default_rng
_LARGEST = 2**32
_NUMPY_CLASSES = ("RandomState", "SeedSequence", "PCG64", "PCG64DXSM", "MT19937", "Philox", "SFC64")
"""Classes of `numpy.random` that take their seed from the operating system if none is given."""


class Chance:
    """The generators of one robot, which take the place of those of the process while it runs.

    `random` and `numpy.random` have one generator each for the whole process; seven robots that
    share a process, or seven processes, would else draw other numbers. A generator that a node
    makes without a seed is seeded from `rng` here.
    """

    def __init__(self, rng: Generator) -> None:
        self._rng = rng
        self._python: Any = random.Random(self._drawn()).getstate()
        self._numpy: Any = np.random.MT19937(self._drawn())
        self._own: dict[str, Any] = {
            name: _seeded(getattr(np.random, name), self._drawn) for name in _NUMPY_CLASSES
        }
        self._own["default_rng"] = self._default_rng
        self._own["seed"] = self._seed_of_numpy

    @contextmanager
    def used(self) -> Iterator[None]:
        """A block in which `random` and `numpy.random` draw from the generators of this robot."""
        python = _get_state()
        numpy = _get_numpy()
        module = vars(np.random)
        real = {name: module[name] for name in self._own}
        _set_state(self._python)
        _set_numpy(self._numpy)
        module.update(self._own)
        try:
            yield
        finally:
            self._python = _get_state()
            self._numpy = _get_numpy()
            _set_state(python)
            _set_numpy(numpy)
            module.update(real)

    def seed(self, a: Any = None, version: int = 2) -> None:
        """What a node calls as `random.seed`."""
        _seed(self._drawn() if a is None else a, version)

    def generator_class(self) -> type[random.Random]:
        """What a node calls as `random.Random`: without a seed it is seeded from `rng`."""
        drawn = self._drawn

        class Random(random.Random):
            def seed(self, a: Any = None, version: int = 2) -> None:
                super().seed(drawn() if a is None else a, version)

        return Random

    def uuid(self) -> UUID:
        """A UUID of version 4, drawn from the run."""
        return UUID(bytes=self._rng.bytes(16), version=4)

    def _seed_of_numpy(self, seed: Any = None) -> None:
        _seed_numpy(self._drawn() if seed is None else seed)

    def _default_rng(self, seed: Any = None) -> Generator:
        return _make_numpy(self._drawn() if seed is None else seed)

    def _drawn(self) -> int:
        return int(self._rng.integers(_LARGEST))


def _seeded(kind: Any, drawn: Callable[[], int]) -> Any:
    """A class of `numpy.random` that is seeded by `drawn` where no argument is given."""

    class Seeded(kind):  # type: ignore[misc]  # a class that is handed in
        def __init__(self, *args: Any, **named: Any) -> None:
            if all(one is None for one in (*args, *named.values())):
                super().__init__(drawn())
            else:
                super().__init__(*args, **named)

    Seeded.__name__ = kind.__name__
    return Seeded
