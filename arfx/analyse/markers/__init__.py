"""Markers in the picture: found, tracked, their corners refined."""
