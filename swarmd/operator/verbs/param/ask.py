"""The parameters of running patterns: asked, and changed until the next run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from swarmd.core.messages import Member, Param
from swarmd.core.verbs import ParamRequest
from swarmd.operator.session.outcome import Outcome

if TYPE_CHECKING:
    from swarmd.operator.session.session import TargetedView


def set_params(targeted: TargetedView, values: Mapping[str, Any]) -> Outcome:
    """Change parameters of the running pattern, until the next run."""
    return targeted.request(ParamRequest, params=dict(values))


def params_of(member: Member) -> dict[str, Param]:
    """The parameters in force on a robot, with the source of each; empty if no pattern runs."""
    return member.status.params if member.status is not None else {}
