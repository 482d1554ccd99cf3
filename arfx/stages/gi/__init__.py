"""Indirect light: the object in the room's light, and the room in the object's."""

from arfx.stages.gi.stage import Gi, GiParams

__all__ = ["Gi", "GiParams"]
