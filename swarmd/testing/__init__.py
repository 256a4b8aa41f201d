"""Fakes and conformance suites for plugin authors."""

from swarmd.testing.pattern_contract import PatternContract as PatternContract
