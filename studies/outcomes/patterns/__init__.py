"""A module a pattern, with `outcomes(seeds, jobs)`: numbers over seeds beside the wanted ones."""
