"""Voter model: adopt the opinion of one random neighbour of the last window.

Source: pattern "voter model" of Kaiser et al., ICRA 2022. As in their code ROS2swarm, a window
lasts 2 s, and a robot does not count its own opinion. The model itself: Clifford and Sudbury,
Biometrika 60(3), 1973; Holley and Liggett, Annals of Probability 3(4), 1975.
"""

from __future__ import annotations

from collections.abc import Mapping

from swarmd.api import VotingParams, VotingPattern, WindowLength


class VoterModelParams(VotingParams, frozen=True):
    """Those of every voting pattern, with shorter windows."""

    window: WindowLength = 2.0


class VoterModel(VotingPattern[VoterModelParams]):
    """Sends its opinion and adopts a random neighbour's after each window; it does not move."""

    group = "decide"
    params_type = VoterModelParams

    def decide(self, votes: Mapping[str, int]) -> int:
        """The opinion of one neighbour, each with equal probability."""
        opinions = list(votes.values())
        return opinions[int(self.context.rng.integers(len(opinions)))]
