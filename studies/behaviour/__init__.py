"""The ledger of behaviours: how every pattern and part of a robot drives, second by second."""
