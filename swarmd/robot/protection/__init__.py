"""Protection: turns requested commands into safe commands. Pure, and never off."""
