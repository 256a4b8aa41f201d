"""Simulation: world, live server, lockstep, scenarios, experiments, metrics and plots."""
