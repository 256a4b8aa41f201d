"""One robot without any I/O: what it is, hears and decides; time is handed in."""
