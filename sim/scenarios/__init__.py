"""Scenarios: complete descriptions of a run except its seed, from checked YAML files."""
