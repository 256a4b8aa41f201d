"""Tables for pandas."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from msgspec.structs import asdict

from swarmd.core.errors import ConfigError
from swarmd.operator.session.states import RobotState
from swarmd.plugins import need

if TYPE_CHECKING:
    from swarmd.operator.verbs.members.ask import Members


def states_frame(states: Iterable[RobotState]) -> Any:
    """A DataFrame with a row for each state; `time` is a time of UTC."""
    need("pandas", extra="table")
    import pandas

    rows = list(states) if isinstance(states, Iterable) else [states]
    if not all(isinstance(state, RobotState) for state in rows):
        raise ConfigError("frame takes what `states` gives: a list of RobotState")
    table = pandas.DataFrame([_flat(state) for state in rows])
    if len(table):
        table["time"] = pandas.to_datetime(table["time"], unit="s", utc=True)
    return table


def members_frame(members: Members) -> Any:
    """A DataFrame with a row for each robot, by name."""
    need("pandas", extra="table")
    import pandas

    table = pandas.DataFrame(members.rows())
    return table.set_index("name") if len(table) else table


def _flat(state: RobotState) -> dict[str, Any]:
    row = asdict(state)
    for key, prefix in (("report", "report"), ("readings", "reading")):
        row |= {f"{prefix}.{name}": value for name, value in row.pop(key).items()}
    return {key: getattr(value, "value", value) for key, value in row.items()}
