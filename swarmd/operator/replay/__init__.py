"""Repeats a recorded run without a robot and compares its commands."""
