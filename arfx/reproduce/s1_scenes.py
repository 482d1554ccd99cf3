"""Scenes of the figures and of table 1 of Tan, Chen, Sun 2009: a card with a marker, turned
before a camera at rest, one lamp, and a model on it. The paper gives neither the scenes nor
the size of the picture."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from arfx.core.numerics import direction_of

SCENE = Path(__file__).with_name("scenes") / "turned-card.toml"
KEYS, REST_FRAMES, FPS = 27, 2, 24.0  # of the card: it rests in the last frames


class Lamp(NamedTuple):
    """Degrees in the room's axes; the card's in its last frames."""

    azimuth_deg: float
    elevation_deg: float
    rgb: tuple[float, float, float] = (0.52, 0.5, 0.46)

    @property
    def towards(self) -> np.ndarray:
        return direction_of(*np.radians([self.azimuth_deg, self.elevation_deg]))


SITUATIONS = (Lamp(200, 48), Lamp(-20, 34))  # of figure 3
AMBIENT = (0.2, 0.205, 0.22)


def turned_card(
    lamp: Lamp, size_px: tuple[int, int], frames: int, samples: int = 2
) -> str:
    """A scene whose card shows normals on a spiral about the line of sight; first and last
    it lies level.

    samples : of a pixel, a side"""
    turning_s = (frames - REST_FRAMES) / FPS
    return SCENE.read_text(encoding="utf-8").format(
        width=size_px[0],
        height=size_px[1],
        frames=frames,
        samples=samples,
        times=[*np.linspace(0, turning_s, KEYS - 1), frames / FPS],
        ambient=list(AMBIENT),
        azimuth=lamp.azimuth_deg,
        elevation=lamp.elevation_deg,
        rgb=list(lamp.rgb),
    )
