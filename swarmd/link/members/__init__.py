"""The members of a swarm as a robot hears them."""
