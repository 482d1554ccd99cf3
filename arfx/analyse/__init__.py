"""Reads a clip once, and makes one small FrameFacts of each frame."""
