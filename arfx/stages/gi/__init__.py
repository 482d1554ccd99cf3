"""Indirect light: the object in the room's light, and the room in the object's."""
