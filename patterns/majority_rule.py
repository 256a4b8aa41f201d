"""Majority rule: adopt the opinion that most neighbours held in the last window.

Source: pattern "majority rule" of Kaiser et al., ICRA 2022; tumbling windows of 5 s and a random
choice among equals as in ROS2swarm, where the own opinion does not count either.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from swarmd.api import Ties, VotingParams, VotingPattern, about, majority


class MajorityRuleParams(VotingParams, frozen=True):
    """What every voting pattern has, and what to do when there is no single majority."""

    ties: Annotated[
        Ties,
        about(
            "between equals: a random one of them, keep the own opinion, or the lowest",
            source="ROS2swarm",
        ),
    ] = "random"


class MajorityRule(VotingPattern[MajorityRuleParams]):
    """Stands, shares an opinion and adopts the majority's at the end of every window."""

    params_type = MajorityRuleParams

    def decide(self, heard: Mapping[str, int]) -> int:
        """The most frequent opinion of the neighbours."""
        ties = self.params.ties
        return majority(heard.values(), self.opinion, ties=ties, rng=self.context.rng)
