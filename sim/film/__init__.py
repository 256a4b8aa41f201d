"""Films of simulated runs, rendered by MuJoCo."""
