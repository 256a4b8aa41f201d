"""A stop on its way: sender, relay, and freshness."""
