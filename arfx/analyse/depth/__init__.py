"""Real depth: its scale, and the scene's planes in it."""
