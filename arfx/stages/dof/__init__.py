"""Depth of field of a stated lens, equal on real and virtual pixels (stage S2)."""

from arfx.stages.dof.stage import Dof

__all__ = ["Dof"]
