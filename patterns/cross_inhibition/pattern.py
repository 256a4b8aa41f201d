"""Cross-inhibition: a robot that hears another opinion drops its own; one opinion prevails.

Source: the stop signal of honeybees (Seeley et al., Science 335, 2012) as a rule of robots: Reina,
Valentini, Fernandez-Oto, Dorigo and Trianni, PLoS ONE 10(10), 2015. A committed robot that hears
another opinion becomes uncommitted. An uncommitted robot adopts the opinion that it hears. Stubborn
robots never change their opinion. With stubborn robots of both opinions the voter model leaves the
swarm undecided, but cross-inhibition lets one opinion prevail: Reina, Zakir, De Masi and Ferrante,
Communications Physics 6:236, 2023.

Ours: windows, expiry and messages are those of every voting pattern. Opinion 0 is "uncommitted".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from swarmd.api import VotingParams, VotingPattern, WindowLength, about

UNCOMMITTED = 0


class CrossInhibitionParams(VotingParams, frozen=True, kw_only=True):
    """The rule, and those of every voting pattern with shorter windows; opinion 0: uncommitted."""

    rule: Annotated[
        Literal["cross_inhibition", "direct"],
        about(
            "cross_inhibition: another opinion makes it uncommitted; direct: it adopts the other",
            source="Reina et al. 2023",
        ),
    ] = "cross_inhibition"
    is_stubborn: Annotated[
        bool, about("never change the initial opinion", source="Reina et al. 2023: zealots")
    ] = False
    window: WindowLength = 2.0


class CrossInhibition(VotingPattern[CrossInhibitionParams]):
    """Draws one neighbour's opinion after each window; it does not move."""

    group = "decide"
    params_type = CrossInhibitionParams

    def decide(self, votes: Mapping[str, int]) -> int:
        """The opinion after one of the neighbours, each with equal probability, was heard."""
        opinions = list(votes.values())
        heard = opinions[int(self.context.rng.integers(len(opinions)))]
        if self.params.is_stubborn or heard in (UNCOMMITTED, self.opinion):
            return self.opinion
        if self.params.rule == "direct" or self.opinion == UNCOMMITTED:
            return heard
        return UNCOMMITTED
