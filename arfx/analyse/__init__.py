"""Reads a clip once, in order, and folds it into one small FrameFacts per frame."""
