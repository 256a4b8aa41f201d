"""Stands: the control of a benchmark task, `swarmctl exp bench --pattern studies/stand.py`."""

from __future__ import annotations

from swarmd.api import ZERO, Inputs, MovementPattern, Params, Twist


class Stand(MovementPattern[Params]):
    """Never moves, and sends nothing."""

    params_type = Params
    needs = frozenset[str]()
    is_symmetric = True

    def drive(self, inputs: Inputs) -> Twist:
        """Zero."""
        return ZERO
