"""Experiments: a scenario over seeds and parameters, kept, compared and made again."""
