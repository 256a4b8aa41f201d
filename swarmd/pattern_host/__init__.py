"""Child processes that load and step patterns, and the daemon's side of them.

Restarts after a failure, and the age limit of a requested command: `robot/pattern_run.py`.
"""
