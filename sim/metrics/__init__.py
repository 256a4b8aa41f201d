"""Numbers of a run: pure functions over a trace."""
