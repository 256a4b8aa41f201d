"""Response thresholds: the more work there is, the more robots work.

Source: Bonabeau, Theraulaz and Deneubourg, "Quantitative study of the fixed threshold model for the
regulation of division of labour in insect societies", Proc. Royal Society B 263, 1996. An idle
robot that meets the stimulus s begins to work with probability s^2 / (s^2 + theta^2). A working
robot stops with a fixed probability. Robots with a low threshold theta begin first. Robots with a
high threshold follow if the stimulus stays high although the first robots work.

Ours: a driver measures the stimulus as a reading: the objects left, the fill of a store, a light.
"""

from __future__ import annotations

from typing import Annotated

from swarmd.api import Context, Inputs, Outputs, Params, Pattern, Recovery, about


class ResponseThresholdParams(Params, frozen=True, kw_only=True):
    """The threshold and when a robot decides."""

    threshold: Annotated[
        float,
        about(
            "stimulus at which half of all decisions are to work",
            ge=1e-6,
            le=1e6,
            unit="of the reading",
            source="Bonabeau et al. 1996, theta",
        ),
    ] = 5.0
    steepness: Annotated[
        float,
        about(
            "exponent of the stimulus and the threshold",
            ge=1.0,
            le=20.0,
            source="Bonabeau et al. 1996, n",
        ),
    ] = 2.0
    stop: Annotated[
        float,
        about(
            "probability with which a working robot stops at a decision",
            ge=0.0,
            le=1.0,
            source="Bonabeau et al. 1996, p",
        ),
    ] = 0.2
    decide_period: Annotated[
        float,
        about("time between two decisions", ge=0.1, le=600.0, unit="s", source="ours"),
    ] = 1.0
    recovery: Recovery = False


class ResponseThreshold(Pattern[ResponseThresholdParams]):
    """Reports whether the robot works, and decides anew once a period; the robot stands."""

    group = "decide"
    params_type = ResponseThresholdParams
    needs = frozenset({"reading:stimulus"})

    def __init__(self, params: ResponseThresholdParams, context: Context) -> None:
        super().__init__(params, context)
        self._works = False
        self._switches = 0
        self._decide_at: float | None = None

    def step(self, inputs: Inputs) -> Outputs:
        """Begin or stop to work when a decision is due."""
        stimulus = inputs.readings.get("stimulus")
        if self._decide_at is None:
            self._decide_at = inputs.now + float(self.context.rng.random()) * self._period
        if stimulus is not None and inputs.now >= self._decide_at:
            if inputs.now >= self._decide_at + self._period:  # it was suspended
                self._decide_at = inputs.now
            self._decide_at += self._period
            self._decide(stimulus)
        return Outputs(report={"works": self._works, "switches": self._switches})

    @property
    def _period(self) -> float:
        return self.params.decide_period

    def _decide(self, stimulus: float) -> None:
        share = self.params.stop if self._works else self._response(stimulus)
        if float(self.context.rng.random()) < share:
            self._works = not self._works
            self._switches += 1

    def _response(self, stimulus: float) -> float:
        """The probability with which an idle robot begins to work."""
        if not stimulus > 0.0:
            return 0.0
        ratio = min(self.params.threshold / stimulus, 1e9) ** self.params.steepness
        return float(1.0 / (1.0 + ratio))
