"""Environments for learning: lockstep runs whose robots request the actions of a learner."""
