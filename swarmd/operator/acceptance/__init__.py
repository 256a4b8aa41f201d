"""The acceptance test of a robot: steps, dialogue, verdicts and the file that remains. Pure."""
