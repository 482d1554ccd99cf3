"""How the background moves, for what is to lie still on it."""
