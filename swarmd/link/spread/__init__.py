"""What spreads among robots: goals, latches, rosters, and pulled blobs."""
