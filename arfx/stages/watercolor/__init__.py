"""Watercolor: the composited picture as one painting."""

from arfx.stages.watercolor.stage import Watercolor

__all__ = ["Watercolor"]
