"""Recorded runs and simulated worlds on the page of `swarmd.operator.view`."""
