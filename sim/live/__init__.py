"""A world in real time for ordinary daemons, and what starts and watches them."""
