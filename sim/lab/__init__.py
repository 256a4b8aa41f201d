"""The laboratory: scenarios in lockstep, and experiments over seeds and parameters."""
