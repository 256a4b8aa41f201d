"""The verbs that list robots: members, describe and members forget."""
