"""Missions: patterns that a YAML file composes of other patterns, and their conditions."""
