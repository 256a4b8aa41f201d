"""Majority rule: adopt the opinion that most neighbours held in the last window.

Source: pattern "majority rule" of Kaiser et al., ICRA 2022; tumbling windows of 5 s and a random
choice among equals as in ROS2swarm, where the own opinion does not count either.
"""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.api import TieRule, VotingParams, VotingPattern, majority


class MajorityRuleParams(VotingParams, frozen=True):
    """What every voting pattern has, and what to do when there is no single majority."""

    ties: TieRule = "random"


class MajorityRule(VotingPattern[MajorityRuleParams]):
    """Stands, shares an opinion and adopts the majority's at the end of every window."""

    params_type = MajorityRuleParams

    def decide(self, heard: Mapping[str, int]) -> int:
        """The most frequent opinion of the neighbours."""
        ties = self.params.ties
        return majority(heard.values(), self.opinion, ties=ties, rng=self.context.rng)
