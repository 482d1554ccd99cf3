"""Light: what the markers' cells show of it, the lights that explain that, and every
frame's own.
"""
