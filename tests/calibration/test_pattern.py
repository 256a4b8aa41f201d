"""The calibration keeps the contract of every pattern."""

from __future__ import annotations

from swarmd.calibration.pattern import Calibration
from swarmd.testing.pattern_contract import PatternContract


class TestCalibration(PatternContract):
    pattern = Calibration
