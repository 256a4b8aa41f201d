"""Scenarios: a run but for its seed, from YAML files, checked before anything moves."""
