"""The web page of a swarm: a server for one page, and what it shows."""
