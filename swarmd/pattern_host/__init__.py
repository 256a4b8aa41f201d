"""Child processes that load and step patterns, and the daemon's side of them."""
