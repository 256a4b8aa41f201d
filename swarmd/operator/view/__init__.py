"""Views of a swarm: the page and its server, the terminal view, and what they show."""
