"""What all drivers have in common: their contract, the base's deadman, recordings."""
