"""Contracts, rigs and scans for the tests of patterns and drivers."""

from swarmd.testing.pattern_contract import PatternContract as PatternContract
