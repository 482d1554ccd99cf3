"""One frame's exact radiance, its per-pixel truth, and what a sensor makes of it: exposure,
noise, clipping, transfer curve.

Samples over pixel, shutter and lens are averaged in linear light."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np

from arfx.core.colour import Transfer
from arfx.core.machine import usable_cores
from arfx.core.pose import Pose
from arfx.synth.description import SceneFile
from arfx.synth.tracer import Lens, Room, Samples, render_rows, surfaces
from arfx.synth.world import World

# a rolling shutter moves the scene once per band: under 2 px of motion in hand-held footage
_BAND_ROWS = 24
_KEEP_BYTES = 400e6  # rays kept from frame to frame


class Picture:
    """Renders frames of a world.

    One instance per clip; it keeps the rays of every sample position.
    """

    def __init__(self, world: World, samples: int | None = None) -> None:
        scene = world.scene
        self.world = world
        self.side = samples or scene.samples
        if samples is None and (scene.lens.aperture_m > 0 or scene.lens.shutter_s > 0):
            self.side = max(
                self.side, 4
            )  # fewer than 16 moments or lens points leave separate copies of an edge
        self._rays: dict[tuple[float, float], np.ndarray] = {}
        self._pool = ThreadPoolExecutor(min(usable_cores(), 8))

    def rays(self, dx: float, dy: float) -> np.ndarray:
        """(h, w, 2) camera directions at pixel centres shifted by (dx, dy) px; NaN where
        the lens maps nothing.
        """
        if (dx, dy) in self._rays:
            return self._rays[dx, dy]
        camera = self.world.camera
        y, x = np.mgrid[0 : camera.height, 0 : camera.width].astype(float)
        made = camera.normalised(np.stack([x + dx, y + dy], -1))
        if made.nbytes * (len(self._rays) + 1) < _KEEP_BYTES:
            self._rays[dx, dy] = made
        return made

    def radiance(self, frame: int) -> np.ndarray:
        """(h, w, 3) float64 linear radiance of a frame, before exposure.
        Where neither a surface nor a shadow ends and nothing moves or blurs, one sample of
        a whole pixel stands for all."""
        world, scene = self.world, self.world.scene
        shape, n = (world.camera.height, world.camera.width), self.side
        out, met = np.zeros((*shape, 3)), np.zeros(shape, np.uint16)
        chosen = np.ones(shape, bool)
        if n == 1 or not (scene.lens.shutter_s or scene.lens.aperture_m):
            self._sample(
                frame, 0.0, (0.0, 0.0), Samples(chosen, 1.0, 1.0, frame * 4096), out, met
            )
            box = np.ones((3, 3), np.uint8)
            chosen = ((met == 0) | (cv2.erode(met, box) != cv2.dilate(met, box))) & (n > 1)
            out[chosen] = 0
        # which moment of the shutter a position gets
        order = np.random.default_rng([scene.seed, 11]).permutation(n * n)
        for k in range(n * n) if chosen.any() else ():
            place = (k % n + 0.5) / n - 0.5, (k // n + 0.5) / n - 0.5
            late = scene.lens.shutter_s * ((order[k] + 0.5) / (n * n) - 0.5)
            samples = Samples(chosen, 1 / n, 1 / (n * n), frame * 4096 + k)
            self._sample(frame, late, place, samples, out, met)
        if (sigma := scene.lens.softness_px) > 0:
            side = 2 * int(np.ceil(4 * sigma)) + 1
            return np.asarray(
                cv2.GaussianBlur(out, (side, side), sigma, borderType=cv2.BORDER_REPLICATE)
            )
        return out

    def _sample(
        self,
        frame: int,
        late_s: float,
        place: tuple[float, float],
        samples: Samples,
        out: np.ndarray,
        met: np.ndarray,
    ) -> None:
        """Add samples of that place in each pixel, so late after the frame's own time."""
        world = self.world
        rows, lens, rays = world.camera.height, world.scene.lens, self.rays(*place)
        roll = world.scene.hidden.rolling_shutter_s
        bands = [(y, min(y + _BAND_ROWS, rows)) for y in range(0, rows, _BAND_ROWS)]
        shared = None if roll else self._seen(frame, late_s)

        def one(band: tuple[int, int]) -> None:
            late = late_s + roll * ((band[0] + band[1]) / 2 / rows - 0.5)
            room, pose = shared or self._seen(frame, late)
            turn = np.ascontiguousarray(pose.rotation)
            size, focus = lens.aperture_m, lens.focus_m or 1.0
            seen = Lens(rays, turn, pose.translation_m, size, focus)
            render_rows(*band, seen, room, samples, out, met)

        list(self._pool.map(one, bands))

    def _seen(self, frame: int, late_s: float = 0.0) -> tuple[Room, Pose]:
        """The room so late after the frame's own time, and room_from_camera."""
        time_s = float(self.world.frame_times_s[frame]) + late_s
        return self.world.at(time_s), self.world.camera_at(frame, time_s).inverse()

    def surfaces(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """(depth (h, w) m along the axis, object number (h, w) uint8) at pixel centres and
        the frame's own time; 0 = nothing.
        """
        room, pose = self._seen(frame)
        return surfaces(self.rays(0.0, 0.0), pose, room)

    def flow(self, frame: int, depth: np.ndarray, owner: np.ndarray) -> np.ndarray:
        """(h, w, 2) float64 motion of each pixel's surface point to the next frame, px.
        NaN where there is nothing, at the last frame, across a cut, and where the point
        leaves the lens's field."""
        out = np.full((*depth.shape, 2), np.nan)
        world = self.world
        if frame + 1 >= world.scene.frames or world.shots[frame + 1] != world.shots[frame]:
            return out
        t0, t1 = (float(world.frame_times_s[i]) for i in (frame, frame + 1))
        rays = self.rays(0.0, 0.0)
        points = np.concatenate([rays, np.ones_like(rays[..., :1])], -1) * depth[..., None]
        room_from_camera = world.camera_at(frame, t0).inverse()
        next_camera = world.camera_at(frame + 1, t1)
        before, after = world.poses(t0), world.poses(t1)
        grid = np.moveaxis(np.indices(depth.shape)[::-1], 0, -1)
        for number in np.unique(owner[owner > 0]):
            here = owner == number
            move = (
                next_camera
                @ after[number - 1]
                @ before[number - 1].inverse()
                @ room_from_camera
            )
            out[here] = world.camera.project(move.apply(points[here])) - grid[here]
        return out


def gain_at(scene: SceneFile, time_s: float) -> float:
    """The exposure's gain at a time: the stated one, wandering as automatic exposure does."""
    stops = (scene.exposure.drift_stops + scene.hidden.drift_stops) * np.sin(
        2 * np.pi * time_s / scene.exposure.drift_period_s
    )
    return float(scene.exposure.gain * 2.0**stops)


def expose(scene: SceneFile, radiance: np.ndarray, frame: int, time_s: float) -> np.ndarray:
    """Coded colours (h, w, 3) float32 in 0..1 of a frame's radiance (h, w, 3).
    Sensor value = gain * radiance + bias + noise, clipped; noise has variance read² + shot
    * value, as read after the gain, correlated over a Gaussian of the stated sigma without
    changing its variance."""
    signal = gain_at(scene, time_s) * radiance + scene.exposure.bias
    noise = scene.noise
    if noise.read > 0 or noise.shot > 0:
        sigma = np.sqrt(noise.read**2 + noise.shot * np.clip(signal, 0, 1))
        rng = np.random.default_rng([scene.seed, 101, frame])
        signal = signal + sigma * unit_noise(
            rng, signal.shape, scene.hidden.noise_correlation_px
        )
    return Transfer(scene.hidden.transfer).encode(np.clip(signal, 0, 1)).astype(np.float32)


def unit_noise(
    rng: np.random.Generator, shape: tuple[int, ...], correlation_px: float
) -> np.ndarray:
    """Normal noise of variance 1, white or with a Gaussian spatial correlation."""
    white = rng.standard_normal(shape, np.float32)
    if correlation_px <= 0:
        return white
    radius = max(int(np.ceil(4 * correlation_px)), 1)
    kernel = cv2.getGaussianKernel(2 * radius + 1, correlation_px, cv2.CV_64F)[:, 0]
    blurred = cv2.sepFilter2D(
        white, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT
    )
    return np.asarray(
        blurred / np.float32((kernel**2).sum())
    )  # variance of a separable filter: (sum k²)², its root
