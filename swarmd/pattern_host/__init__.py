"""Child processes that load and step patterns, and the daemon's side of these processes.

`robot/pattern_run.py` decides on restarts after a failure, and when a requested command expires.
"""
