"""What the clip saw of its surroundings: maps at times, in the axes that are at rest, about
the place where the object stands.

Small pictures are kept now and then. When all poses are known, each texel of a map finds
its pixel in each of them; near in time counts most, so that the map follows the clip and
what is at rest does not flicker. What was seen once in a shot stays known. Around what was
seen the map goes on smoothly, less and less known: there the guess of surroundings.py takes
over.

A camera beside the object sees a wall in another direction than the object does. The
surroundings are taken for a sphere about the object; its radius is the one at which the
pictures agree best, infinite where they do not tell.

Radiance is a share of the frame's light (`Light.mean_radiance`), so exposure does not
matter. A lamp that is a light of its own is cut out. Source:
docs/methods/gi.md#environment; the radius: plane sweep (Collins 1996), with spheres. Leaves
out: things at several distances, people who walk through. Cost: some 10 ms for a snapshot, some
30 ms for a shot's radius."""

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy import ndarray

from arfx.analyse.light.surroundings import (
    PANORAMA_PX,
    camera_axes,
    from_panorama,
    turned,
)
from arfx.core.camera import Camera
from arfx.core.cube import CubeMap, SeenEnvironment, face_directions, resampled
from arfx.core.facts import FrameFacts
from arfx.core.light import Light
from arfx.core.numerics import divide, smoothstep

FACE_PX = 64  # of a map
SNAPSHOT_PX = 128  # width of the pictures that are kept
KEY_S = 1.0  # from map to map
MOST_MAPS = (
    64  # in a clip, beside one for each shot: beyond that they lie farther apart
)
NEAR_S = 1.0  # time in which a snapshot's weight falls to 1 / e, before and after it
LASTING = 1e-3  # weight of any other snapshot of the shot
EDGE = 0.12  # of a picture's shorter side, along which its weight falls to 0
NEARNESSES = (
    0.0,
    0.05,
    0.07,
    0.1,
    0.13,
    0.17,
    0.22,
    0.28,
    0.36,
    0.46,
    0.6,
)  # the camera's mean distance over the radius
SWEEP_PX, SWEEP_LOOKS = 24, 10
BETTER, ALIKE = (
    0.95,
    1e-4,
)  # nearer surroundings have to bring the disagreement down to this share of it, and by that much
COARSEST_PX, GROWS = (
    4,
    3.0,
)  # how far, and how much at each step to coarser texels, what was seen reaches beyond its border
BRIGHT = 2.0  # times the mean of what was seen
LAMP_DEG = 15.0  # around a lamp in which bright pixels are the lamp
LAMP = (0.75, 0.95)  # linear light from which they are partly and wholly


class Snapshot(NamedTuple):
    """A small picture of one frame. picture : (h, w, 3) float16 or float32, linear
    darkest : (3,) linear light of the frame's darkest hundredth, channel by channel"""

    frame: int
    picture: ndarray
    darkest: ndarray


Seen = tuple[
    tuple[FrameFacts, ...], dict[str, ndarray]
]  # facts with `seen_environment`, and the maps that they name


def with_seen(
    facts: Sequence[FrameFacts],
    snapshots: Sequence[Snapshot],
    camera: Camera,
    still_camera: bool,
    centre_m: ndarray,
    up: ndarray,
) -> Seen:
    """still_camera : the axes at rest are the camera's, else the world's;  centre_m, up
    (3,) : of the anchor, WORLD
    """
    by_shot: dict[int, list[_Posed]] = {}
    for snapshot in snapshots:
        f = facts[snapshot.frame]
        if f.camera_from_world is not None and f.light is not None:
            by_shot.setdefault(f.shot, []).append(
                _Posed(snapshot, f, f.light, camera, still_camera, centre_m)
            )
    maps: dict[str, ndarray] = {}
    keys: dict[int, tuple[ndarray, list[str]]] = {}
    apart_s = max(
        KEY_S, sum(p[-1].time_s - p[0].time_s for p in by_shot.values()) / MOST_MAPS
    )
    for shot, posed in by_shot.items():
        inverse_radius = 0.0 if still_camera else _inverse_radius(posed, up)
        first, last = posed[0].time_s, posed[-1].time_s
        times = np.linspace(first, last, 1 + int(np.ceil((last - first) / apart_s)))
        keys[shot] = (
            times,
            [_named(m, maps) for m in _maps(posed, times, inverse_radius)],
        )
    out = []
    for f in facts:
        if f.camera_from_world is not None and f.shot in keys:
            times, names = keys[f.shot]
            place = np.interp(f.time_s, times, np.arange(len(times)))
            k = min(int(place), len(names) - 1)
            pair = names[k], names[min(k + 1, len(names) - 1)]
            axes = camera_axes(f) if still_camera else None
            between = SeenEnvironment(pair, round(float(place - k), 4), axes)
            f = f.with_(seen_environment=between)
        out.append(f)
    return tuple(out), maps


def given_everywhere(
    facts: Sequence[FrameFacts], panorama: ndarray, world_from_anchor: ndarray
) -> Seen:
    """The same, and `environment`, of a picture of all surroundings, as
    surroundings.from_panorama takes it.

    world_from_anchor : (3, 3)
    """
    small, faces = (
        turned(from_panorama(panorama, size), world_from_anchor.T)
        for size in (PANORAMA_PX, FACE_PX)
    )
    faces = np.clip(divide(faces, faces.mean()), 0, 6e4)  # its scale means nothing
    maps: dict[str, ndarray] = {}
    name = _named(np.concatenate([faces, np.ones_like(faces[..., :1])], -1), maps)
    seen, given = SeenEnvironment((name, name), 0.0), CubeMap.of(small)
    lit = (
        f
        if f.camera_from_world is None
        else f.with_(environment=given, seen_environment=seen)
        for f in facts
    )
    return tuple(lit), maps


def _named(rgba: ndarray, maps: dict[str, ndarray]) -> str:
    small = rgba.astype(np.float16)
    name = hashlib.blake2b(small.tobytes(), digest_size=8).hexdigest()
    maps[name] = small
    return name


class _Posed:
    """A snapshot in the axes at rest.

    camera_from_static : rotation (3, 3);  centre_m : the anchor, camera axes
    picture : (h, w, 3) float32, without the camera's bias, over `level` (3,);  lamps : (n,
    3) directions, axes at rest
    """

    def __init__(
        self,
        snapshot: Snapshot,
        f: FrameFacts,
        light: Light,
        camera: Camera,
        still_camera: bool,
        centre_m: ndarray,
    ) -> None:
        """centre_m : the anchor, WORLD"""
        self.time_s, self.camera, self.level = f.time_s, camera, light.mean_radiance
        self.centre_m = f.pose.apply(centre_m)
        static, self.camera_from_static = np.eye(3), f.pose.rotation
        if still_camera:
            static, self.camera_from_static = self.camera_from_static, static
        lamps = [static @ li.unit for li in light.lights]
        self.lamps = np.reshape(lamps, (-1, 3))
        shown = snapshot.picture.astype(np.float32) - np.array(f.bias_rgb)
        shares = divide(np.clip(shown, 0, None), self.level)
        self.picture = shares.astype(np.float32)

    def seen(
        self, directions: ndarray, inverse_radius: float
    ) -> tuple[ndarray, ndarray]:
        """((n, 3) shares, (n,) weight 0..1) in directions (n, 3), axes at rest, from the anchor.

        inverse_radius : 1/m, of the sphere about the anchor on which everything lies"""
        h, w = self.picture.shape[:2]
        along = directions @ self.camera_from_static.T
        at = self.camera.project(along + inverse_radius * self.centre_m)
        scale = w / self.camera.width, h / self.camera.height
        at = (np.where(np.isfinite(at), at, -1e4) + 0.5) * scale - 0.5
        inside = np.minimum(at + 0.5, [w - 0.5, h - 0.5] - at).min(1) / (
            EDGE * min(w, h)
        )
        x, y = cv2.split(at[:, None].astype(np.float32))
        border = cv2.BORDER_REPLICATE
        found = cv2.remap(self.picture, x, y, cv2.INTER_LINEAR, borderMode=border)
        rgb, weight = found.reshape(-1, 3), smoothstep(inside)
        bright = ((rgb * self.level).max(1) - LAMP[0]) / (LAMP[1] - LAMP[0])
        at_lamp = directions @ self.lamps.T > np.cos(np.radians(LAMP_DEG))
        return rgb, weight * (1 - smoothstep(bright) * at_lamp.any(1))


def _inverse_radius(snapshots: Sequence[_Posed], up: ndarray) -> float:
    """1/m: that of NEARNESSES with which the snapshots agree best on what is above the plane;
    the farthest of those as good.
    """
    some = np.unique(np.linspace(0, len(snapshots) - 1, SWEEP_LOOKS).astype(int))
    d = face_directions(SWEEP_PX).reshape(-1, 3)
    d = d[d @ up > 0]
    distances_m = np.linalg.norm([s.centre_m for s in snapshots], axis=1)
    cost, inverse = [], np.array(NEARNESSES) / max(distances_m.mean(), 1e-9)
    for inverse_radius in inverse:
        seen = [snapshots[i].seen(d, inverse_radius) for i in some]
        rgb, weight = map(np.array, zip(*seen, strict=True))
        total, weights = weight.sum(0), weight[..., None]
        # as it looks: a lamp does not outweigh the room
        first = (weights * np.sqrt(rgb)).sum(0)
        varied = ((weights * rgb).sum(0) - divide(first**2, total[:, None])).sum(1)
        twice = (weight > 0).sum(0) > 1
        cost.append(
            float(divide(varied[twice].sum(), total[twice].sum(), where_zero=np.inf))
        )
    good = np.array(cost) * BETTER <= min(cost) + ALIKE
    return float(inverse[good.argmax()])


def _maps(
    snapshots: Sequence[_Posed], times: ndarray, inverse_radius: float
) -> list[ndarray]:
    """(6, n, n, 4) float32 at each of `times`: radiance times the fourth, how well it is known."""
    d = face_directions(FACE_PX).reshape(-1, 3)
    sums, known = np.zeros((len(times), len(d), 4), np.float32), np.zeros(len(d))
    lasting = np.zeros((len(d), 4), np.float32)
    for snapshot in snapshots:
        rgb, weight = snapshot.seen(d, inverse_radius)
        known = np.maximum(known, weight)
        row = np.column_stack([weight[:, None] * rgb, weight]).astype(np.float32)
        lasting += np.float32(LASTING) * row
        near = np.exp(-np.abs(times - snapshot.time_s) / NEAR_S)
        for k in np.flatnonzero(near > LASTING):
            sums[k] += np.float32(near[k]) * row
    out = []
    for one in sums + lasting:
        rgba = np.ones(one.shape)
        rgba[:, :3] = divide(one[:, :3], one[:, 3:])
        rgba = (rgba * known[:, None]).reshape(6, FACE_PX, FACE_PX, 4)
        mean = divide(rgba[..., :3].sum((0, 1, 2)), known.sum())
        most = np.append(BRIGHT * mean, 1).astype(np.float32)
        out.append(
            np.clip(_filled(rgba.astype(np.float32), most), 0, [6e4, 6e4, 6e4, 1])
        )
    return out


def _filled(rgba: ndarray, most: ndarray) -> ndarray:
    """(6, n, n, 4) the map with what is around its known part: the mean of what is near,
    the coarser and less known the farther off (push and pull, Gortler et al. 1996). most
    (4,) : what is brighter, such as a lamp, goes on no brighter"""
    n = rgba.shape[1]
    if n <= COARSEST_PX:
        return rgba
    mean = (
        np.minimum(rgba, most * rgba[..., 3:])
        .reshape(6, n // 2, 2, n // 2, 2, 4)
        .mean((2, 4))
    )
    mean *= divide(np.minimum(GROWS * mean[..., 3:], 1), mean[..., 3:])
    return rgba + (1 - rgba[..., 3:]) * resampled(_filled(mean, most), n)
