"""Missions: patterns composed of others in a YAML file, and conditions that end a run."""
