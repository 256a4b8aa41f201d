"""Where patterns live: child processes that load and step them, and what is said between."""
