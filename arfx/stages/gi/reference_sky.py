"""The environment as the reference's rays see it, and samples of its bright parts.

A ray in the direction that a surface's own reflection suggests meets a small lamp once in hundreds,
and then counts hundredfold: single pixels far too bright. So directions are also drawn from the
environment itself."""

import numpy as np
from numpy import ndarray

from arfx.core.cube import look_up, on_cube, on_faces, solid_angles
from arfx.core.numerics import divide, normalise

# An environment whose brightest texel is less than so many times its mean needs no samples of its
# own.
BRIGHT = 3.0
# Share of the mean that every texel is chosen with: what lies between texels is never left out.
FLOOR = 0.1
GREY = np.array([0.2126, 0.7152, 0.0722])


class Environment:
    """Radiance from far away. cubes : (narrow, broad), (6, n, n, 3) each, as a mirror sees it and
    as a matt surface does
    turn (3, 3) : to the cubes' axes from the anchor's;  bright : whether its brightest parts need
    samples of their own"""

    def __init__(self, cubes: tuple[ndarray, ndarray], turn: ndarray) -> None:
        from scipy.ndimage import maximum_filter

        self._cubes = cubes
        self.turn, self._size = np.asarray(turn, float), cubes[1].shape[1]
        grey = cubes[1] @ GREY
        solid = np.tile(solid_angles(self._size), (6, 1, 1))
        mean = float((grey * solid).sum() / solid.sum())
        self.bright = mean > 0 and float(grey.max()) > BRIGHT * mean
        # the largest of a texel and its neighbours, as radiance is linear between them
        chance = (maximum_filter(grey, (1, 3, 3)) + FLOOR * mean) * solid
        self._chance = divide(chance, chance.sum()).ravel()
        self._up_to = np.cumsum(self._chance)
        self._corners = on_faces(np.linspace(-1, 1, self._size + 1))

    def radiance(self, directions: ndarray, wide: ndarray) -> ndarray:
        """(n, 3) in unit directions. wide (n, 3) : 0 as a mirror sees it, 1 as a matt surface
        does"""
        turned = directions @ self.turn.T
        narrow, broad = (look_up(cube, turned) for cube in self._cubes)
        return np.asarray(narrow + wide * (broad - narrow))

    def density(self, directions: ndarray) -> ndarray:
        """(n, 1) per steradian with which `samples` takes unit directions; 0 if it is not used."""
        if not self.bright:
            return np.zeros((len(directions), 1))
        n = self._size
        face, *places = on_cube(directions @ self.turn.T)
        uv = np.array(places)
        column, row = np.clip((uv + 1) / 2 * n, 0, n - 1).astype(int)
        per_texel = n**2 / 4 * (1 + (uv**2).sum(0)) ** 1.5
        chance = self._chance[(face * n + row) * n + column]
        return np.asarray((chance * per_texel)[:, None])

    def samples(self, numbers: ndarray) -> ndarray:
        """(m, 3) unit directions, more where it is brighter, from numbers (m, 2) in [0, 1)."""
        n, corners = self._size, self._corners
        x, down = numbers[:, :1] * self._up_to[-1], numbers[:, 1:]
        texel = np.searchsorted(self._up_to[:-1], x[:, 0], side="right")
        left = divide(self._up_to[texel, None] - x, self._chance[texel, None])
        face, row, column = np.unravel_index(texel, (6, n, n))
        first = corners[face, row, column]
        d = first + down * (corners[face, row + 1, column] - first)
        d += np.clip(left, 0, 1) * (corners[face, row, column + 1] - first)
        return np.asarray(normalise(d) @ self.turn)
