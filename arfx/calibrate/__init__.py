"""Boards in pictures to camera intrinsics, with their uncertainty and a verdict."""
