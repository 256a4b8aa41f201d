"""Which bits of a run depend on the processor, and which functions give other bits there."""
