"""Light from the footage: shading of the virtual object, its shadow on itself and on the
plane that it stands on.
"""

from arfx.stages.lightmap.stage import Lightmap, LightmapParams

__all__ = ["Lightmap", "LightmapParams"]
