"""Light on a surface whose normal map leans: none comes from below the surface itself."""

import numpy as np
from numpy import ndarray

from arfx.core.layers import Layer, Layers, packed


def smooth_normal(normal: ndarray, layers: Layers) -> ndarray:
    """(h, w, 3) without the normal map; `normal` itself where nothing has one."""
    if layers.extent(Layer.SMOOTH_NORMAL).empty:
        return normal
    smooth = packed(layers[Layer.SMOOTH_NORMAL])
    return np.where(smooth.any(-1, keepdims=True), smooth, normal)


def share_above_surface(normal: ndarray, smooth: ndarray) -> ndarray:
    """(h, w) of even light around `normal` (h, w, 3), the part that is not below the surface."""
    return np.asarray((1 + (normal * smooth).sum(-1)) / 2)
