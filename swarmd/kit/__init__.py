"""Base classes and functions for patterns; authors import them from `swarmd.api`."""
