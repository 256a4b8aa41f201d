"""Pictures of runs and of experiments."""
