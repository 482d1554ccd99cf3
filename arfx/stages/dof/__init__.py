"""Depth of field of a stated lens, equal on real and virtual pixels (docs/methods/dof.md)."""

from arfx.stages.dof.stage import Dof

__all__ = ["Dof"]
