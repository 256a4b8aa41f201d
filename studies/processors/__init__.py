"""Which bits of a run depend on the processor, and which function is the first cause."""
