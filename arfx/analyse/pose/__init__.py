"""Poses: both solutions of every sighting, the map of the markers, the path through the
clip, its smoothing.
"""
