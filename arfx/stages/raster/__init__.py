"""The raster stage: one door (`Raster`), two back ends, and what `arfx doctor` asks about them."""

from arfx.stages.raster.backends import backend_report, choose_backend
from arfx.stages.raster.stage import Raster, RasterParams

__all__ = ["Raster", "RasterParams", "backend_report", "choose_backend"]
