"""Majority rule: adopt the opinion that most neighbours held in the last window.

Source: pattern "majority rule" of Kaiser et al., ICRA 2022. As in their code ROS2swarm, windows of
5 s follow each other without overlap, a tie is decided at random, and a robot does not count its
own opinion.
"""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.api import TieRule, VotingParams, VotingPattern, majority


class MajorityRuleParams(VotingParams, frozen=True):
    """Those of every voting pattern, and the rule for ties."""

    ties: TieRule = "random"


class MajorityRule(VotingPattern[MajorityRuleParams]):
    """Sends its opinion and adopts the majority's at the end of each window; it does not move."""

    group = "decide"
    params_type = MajorityRuleParams

    def decide(self, votes: Mapping[str, int]) -> int:
        """The most frequent opinion of the neighbours."""
        ties = self.params.ties
        return majority(votes.values(), self.opinion, ties=ties, rng=self.context.rng)
