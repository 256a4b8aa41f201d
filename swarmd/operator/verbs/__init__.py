"""A folder for each verb: its command, what asks for it, its words."""
