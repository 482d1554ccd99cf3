"""One frame's exact radiance, its per-pixel truth, and what a sensor makes of it: exposure,
noise, clipping, transfer curve.

Samples over pixel, shutter and lens are averaged in linear light."""

from functools import cache, lru_cache, partial

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.colour import Transfer
from arfx.core.parallel import parallel_map
from arfx.core.pose import Pose
from arfx.synth.description import SceneFile
from arfx.synth.rays import Rays, Room, radiance, surfaces
from arfx.synth.world import World

# a rolling shutter moves the scene once per band: under 2 px of motion in hand-held footage
_BAND_ROWS = 24
_KEEP_BYTES = 400_000_000  # rays kept from frame to frame
Arrays = tuple[ndarray, ndarray]


class Picture:
    """Renders frames of a world.

    One instance per clip; it keeps the rays of every sample position.
    """

    def __init__(self, world: World, samples: int | None = None) -> None:
        scene = world.scene
        self.world = world
        self.shape = world.camera.height, world.camera.width
        self.side = samples or scene.samples
        if samples is None and (
            scene.lens.aperture_m > 0 or scene.lens.shutter_s > 0
        ):
            self.side = max(
                self.side, 4
            )  # fewer than 16 moments or lens points leave separate copies of an edge
        centres = _pixels(self.shape)
        # (h, w, 2) camera directions at pixel centres shifted by (dx, dy) px; NaN where
        # the lens maps nothing
        self.rays = lru_cache(_KEEP_BYTES // (16 * world.camera.rect.area))(
            lambda dx, dy: world.camera.normalised(np.add(centres, (dx, dy)))
        )

    def radiance(self, frame: int) -> ndarray:
        """(h, w, 3) float64 linear radiance of a frame, before exposure.
        Where neither a surface nor a shadow ends and nothing moves or blurs, one sample of
        a whole pixel stands for all."""
        scene, n = self.world.scene, self.side
        seed = frame * 4096
        out, chosen = np.zeros((*self.shape, 3)), np.ones(self.shape, bool)
        if n == 1 or not (scene.lens.shutter_s or scene.lens.aperture_m):
            light, number = self._sample(frame, 0.0, (0.0, 0.0), chosen, 1.0, seed)
            out, met = light.reshape(out.shape), number.reshape(self.shape)
            box = np.ones((3, 3), np.uint8)
            differs = cv2.morphologyEx(met, cv2.MORPH_GRADIENT, box) > 0
            chosen = ((met == 0) | differs) & (n > 1)
            out[chosen] = 0
        # which moment of the shutter a position gets
        order = np.random.default_rng([scene.seed, 11]).permutation(n * n)
        for k in range(n * n) if chosen.any() else ():
            place = (k % n + 0.5) / n - 0.5, (k // n + 0.5) / n - 0.5
            late = scene.lens.shutter_s * ((order[k] + 0.5) / (n * n) - 0.5)
            light, _ = self._sample(frame, late, place, chosen, 1 / n, seed + k)
            out[chosen] += light / n**2
        if (sigma := scene.lens.softness_px) > 0:
            size = (2 * int(np.ceil(4 * sigma)) + 1,) * 2
            cv2.GaussianBlur(out, size, sigma, out, borderType=cv2.BORDER_REPLICATE)
        return out

    def _sample(
        self,
        frame: int,
        late_s: float,
        place: tuple[float, float],
        chosen: ndarray,
        footprint: float,
        seed: int,
    ) -> Arrays:
        """Of each chosen pixel (h, w) one sample at that place in it, so late after the frame's
        own time, for a footprint of that width in pixels; as `rays.radiance` gives them."""
        pixels, rays = np.argwhere(chosen), self.rays(*place)
        rows, roll = len(chosen), self.world.scene.hidden.rolling_shutter_s
        cuts = np.searchsorted(pixels[:, 0], range(_BAND_ROWS, rows, _BAND_ROWS))
        seen = cache(partial(self._seen, frame))
        # what pixels span, right and down, as camera directions without z
        right = np.diff(rays, axis=1, append=rays[:, -2:-1])
        down = np.diff(rays, axis=0, append=rays[-2:-1])
        # a neighbour beyond the lens's field: assume square pixels
        right = np.where(np.isfinite(right), right, down[..., ::-1] * [1, -1])
        down = np.where(np.isfinite(down), down, right[..., ::-1] * [-1, 1])
        spans = footprint * np.nan_to_num(np.stack([right, down], 2))
        lens = self.world.scene.lens

        def one(part: ndarray) -> Arrays:
            at = tuple(part.T)
            first = part[0, 0] // _BAND_ROWS * _BAND_ROWS
            middle = (first + min(first + _BAND_ROWS, rows)) / 2
            room, pose = seen(late_s + (roll and roll * (middle / rows - 0.5)))
            number = np.ravel_multi_index(at, chosen.shape)
            ahead, starts, turn = rays[at], np.zeros((len(part), 3)), pose.rotation.T
            if lens.aperture_m > 0:  # through a random point of it
                radius = 0.5 * lens.aperture_m * np.sqrt(_noise(seed, 2 * number))
                angle = 2 * np.pi * _noise(seed, 2 * number + 1)
                starts[:, 0] = radius * np.cos(angle)
                starts[:, 1] = radius * np.sin(angle)
                ahead = ahead - starts[:, :2] / (lens.focus_m or 1.0)
            through = Rays(
                starts @ turn + pose.translation_m,
                ahead @ turn[:2] + turn[2],
                spans[at] @ turn[:2],
                2 * np.pi * _noise(seed + 7, number),
            )
            return radiance(through, room)

        light, met = zip(
            *parallel_map(one, filter(len, np.split(pixels, cuts))), strict=True
        )
        return np.concatenate(light), np.concatenate(met)

    def _seen(self, frame: int, late_s: float = 0.0) -> tuple[Room, Pose]:
        """The room so late after the frame's own time, and room_from_camera."""
        time_s = float(self.world.frame_times_s[frame]) + late_s
        return self.world.at(time_s), self.world.camera_at(frame, time_s).inverse()

    def surfaces(self, frame: int) -> Arrays:
        """(depth (h, w) m along the axis, object number (h, w) uint8) at pixel centres and
        the frame's own time; 0 = nothing.
        """
        return surfaces(self.rays(0.0, 0.0), *self._seen(frame))

    def flow(self, frame: int, depth: ndarray, owner: ndarray) -> ndarray:
        """(h, w, 2) float64 motion of each pixel's surface point to the next frame, px.
        NaN where there is nothing, at the last frame, across a cut, and where the point
        leaves the lens's field."""
        out, world = np.full((*depth.shape, 2), np.nan), self.world
        if world.shots[frame] not in world.shots[frame + 1 : frame + 2]:
            return out
        t0, t1 = world.frame_times_s[[frame, frame + 1]].tolist()
        rays = self.rays(0.0, 0.0)
        points = np.dstack([rays, np.ones(depth.shape)]) * depth[..., None]
        _, room_from_camera = self._seen(frame)
        next_camera = world.camera_at(frame + 1, t1)
        poses = zip(world.poses(t0), world.poses(t1), strict=True)
        grid = _pixels(depth.shape)
        for number, (before, after) in enumerate(poses, 1):
            here = owner == number
            move = next_camera @ after @ before.inverse() @ room_from_camera
            out[here] = world.camera.project(move.apply(points[here])) - grid[here]
        return out


def _pixels(shape: tuple[int, ...]) -> ndarray:
    """(h, w, 2) x and y of every pixel's centre."""
    return np.dstack([*np.indices(shape, float)[::-1]])


def _noise(seed: int, numbers: ndarray) -> ndarray:
    """0..1 from a seed and integers (n,): the finaliser of MurmurHash3."""
    h = numbers.astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)
    h ^= np.uint64(seed * 0x9E3779B97F4A7C15 % 2**64)
    for factor in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53):
        h = (h ^ h >> np.uint64(33)) * np.uint64(factor)
    return (h >> np.uint64(11)) / 2.0**53


def gain_at(scene: SceneFile, time_s: float) -> float:
    """The exposure's gain at a time: the stated one, wandering as automatic exposure does."""
    stops = (scene.exposure.drift_stops + scene.hidden.drift_stops) * np.sin(
        2 * np.pi * time_s / scene.exposure.drift_period_s
    )
    return float(scene.exposure.gain * 2.0**stops)


def expose(scene: SceneFile, radiance: ndarray, frame: int, time_s: float) -> ndarray:
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
    return (
        Transfer(scene.hidden.transfer)
        .encode(np.clip(signal, 0, 1))
        .astype(np.float32)
    )


def unit_noise(
    rng: np.random.Generator, shape: tuple[int, ...], correlation_px: float
) -> ndarray:
    """Normal noise of variance 1, white or with a Gaussian spatial correlation."""
    white = rng.standard_normal(shape, np.float32)
    if correlation_px <= 0:
        return white
    side = 2 * max(int(np.ceil(4 * correlation_px)), 1) + 1
    kernel = cv2.getGaussianKernel(side, correlation_px)
    blurred = cv2.sepFilter2D(
        white, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT
    )
    # variance of a separable filter: (sum k²)², its root
    return np.asarray(blurred / np.float32((kernel**2).sum()))
