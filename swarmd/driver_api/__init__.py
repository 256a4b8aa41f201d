"""The driver API: contract, command gate, watchdog, recordings, and the wire of simulated bases."""
