"""Gives each robot a chance of its own, also where a node uses the generators of the process."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

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


class Chance:
    """The generators of one robot, which take the place of those of the process while it runs.

    `random` and `numpy.random` have one generator each for the whole process; seven robots that
    share a process, or seven processes, would else draw other numbers. An unseeded
    `numpy.random.default_rng()` or `seed()` is seeded from `rng` here.
    """

    def __init__(self, rng: Generator) -> None:
        self._rng = rng
        self._python: Any = random.Random(self._drawn()).getstate()
        self._numpy: Any = np.random.MT19937(self._drawn())

    @contextmanager
    def used(self) -> Iterator[None]:
        """A block in which `random` and `numpy.random` draw from the generators of this robot."""
        python = _get_state()
        numpy = _get_numpy()
        default_rng = np.random.default_rng
        seed = np.random.seed
        _set_state(self._python)
        _set_numpy(self._numpy)
        np.random.default_rng = self._default_rng
        np.random.seed = self._seed_of_numpy
        try:
            yield
        finally:
            self._python = _get_state()
            self._numpy = _get_numpy()
            _set_state(python)
            _set_numpy(numpy)
            np.random.default_rng = default_rng
            np.random.seed = seed

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

    def _seed_of_numpy(self, seed: Any = None) -> None:
        _seed_numpy(self._drawn() if seed is None else seed)

    def _default_rng(self, seed: Any = None) -> Generator:
        return _make_numpy(self._drawn() if seed is None else seed)

    def _drawn(self) -> int:
        return int(self._rng.integers(_LARGEST))
