"""The one light model that every effect shares: ambient and up to two directional lights."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from arfx.core.numerics import normalise


@dataclass(frozen=True)
class DirectionalLight:
    """direction : unit, WORLD frame, towards the light;  rgb : irradiance on a surface that faces it, such that a
    white diffuse surface shows radiance rgb (the factor pi is folded in);  angular_size_deg : full angle of its disc;
    confidence_deg : half-angle of its confidence cone, inf = not measured."""

    direction: tuple[float, float, float]
    rgb: tuple[float, float, float]
    angular_size_deg: float = 0.5
    confidence_deg: float = float("inf")

    @property
    def unit(self) -> np.ndarray:
        return normalise(np.asarray(self.direction, float))


@dataclass(frozen=True)
class Light:
    """ambient_rgb : radiance of a white diffuse surface without any directional light.

    source : what it was taken from ("default", "given", "marker", ...).
    """

    ambient_rgb: tuple[float, float, float] = (0.45, 0.45, 0.45)
    lights: tuple[DirectionalLight, ...] = field(
        default_factory=lambda: (DirectionalLight((0.35, 0.45, 0.82), (0.5, 0.5, 0.5), 20.0),)
    )
    source: str = "default"

    def to_json(self) -> dict:
        return {
            "source": self.source,
            "ambient_rgb": list(self.ambient_rgb),
            "lights": [
                {
                    "direction": list(li.direction), "rgb": list(li.rgb), "angular_size_deg": li.angular_size_deg,
                    "confidence_deg": li.confidence_deg if np.isfinite(li.confidence_deg) else None,
                }
                for li in self.lights
            ],
        }  # fmt: skip

    @staticmethod
    def from_json(d: dict) -> Light:
        lights = tuple(
            DirectionalLight(
                tuple(x["direction"]), tuple(x["rgb"]), x["angular_size_deg"],
                float("inf") if x["confidence_deg"] is None else x["confidence_deg"],
            )
            for x in d["lights"]
        )  # fmt: skip
        return Light(tuple(d["ambient_rgb"]), lights, d["source"])
