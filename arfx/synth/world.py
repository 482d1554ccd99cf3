"""The scene as rows for the tracer: what stands where at a moment, with which texture, under which light."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from arfx.core.camera import Camera
from arfx.core.pose import Pose
from arfx.synth.description import Box, Marker, Plane, SceneFile, Sphere
from arfx.synth.environment import environment_lamps, environment_picture
from arfx.synth.motion import camera_from_room, room_from_object
from arfx.synth.textures import sheet_albedo, texture_albedo


@dataclass(frozen=True, eq=False)
class Moment:
    """The scene at one time: tracer rows, room_from_object by object number - 1."""

    rects: np.ndarray
    spheres: np.ndarray
    lamps: np.ndarray
    room_from_object: tuple[Pose, ...]


class World:
    """Everything of a scene that does not depend on time, made once.

    camera : the true one;  frame_times_s : (frames,) from 0 at the first frame;  shots : (frames,) shot of each frame
    textures, table : tracer's summed-area tables;  ambient, sky : tracer's light beside the lamps (`lamps_at`)
    """

    def __init__(self, scene: SceneFile, folder: Path | None = None) -> None:
        self.scene = scene
        self.camera = true_camera(scene)
        self.frame_times_s = _frame_times(scene)
        self.shots = np.repeat(np.arange(len(scene.shot)), [s.frames for s in scene.shot])
        self._names = [p.name or (p.spec.key if isinstance(p, Marker) else f"object {i}") for i, p in enumerate(scene.placed)]
        self._pictures: list[tuple[np.ndarray, float]] = []
        self._faces = [self._make(i, folder) for i in range(len(scene.placed))]
        self.textures, self.table = _summed_areas(self._pictures)
        self.ambient = np.asarray(scene.light.ambient_rgb, float)
        self.sky = np.zeros((0, 0, 3))
        if scene.light.environment:
            self.sky = environment_picture(scene.light.environment, folder) * scene.light.environment_scale
            self._sky_lamps = environment_lamps(self.sky, scene.light.environment_lights)
            self.ambient = np.zeros(3)

    @property
    def duration_s(self) -> float:
        return float(self.frame_times_s[-1])

    def lamps_at(self, time_s: float) -> np.ndarray:
        """(n, 7) tracer lamps at a time."""
        if self.scene.light.environment:
            return self._sky_lamps
        rows = []
        for li in self.scene.light.lamps:
            phase = np.sin(2 * np.pi * time_s / li.period_s)
            row = lamp_row(li.azimuth_deg + li.swing_deg[0] * phase, li.elevation_deg + li.swing_deg[1] * phase, li.rgb,
                           li.angular_size_deg)  # fmt: skip
            if li.brightness:  # of two keys at one time the later holds from then on
                row[3:6] *= np.interp(time_s, *np.array(li.brightness).T)
            rows.append(row)
        return np.array(rows).reshape(-1, 7)

    def _add(self, picture: np.ndarray, smooth: bool) -> int:
        self._pictures.append((picture, 1.0 if smooth else 0.0))
        return len(self._pictures) - 1

    def _make(self, i: int, folder: Path | None) -> list[np.ndarray]:
        """Rows of one object in its own axes."""
        p, number, seed = self.scene.placed[i], i + 1, self.scene.seed * 1000 + i
        if isinstance(p, Sphere):
            return [np.array([0, 0, 0, p.radius_m, *p.colour, number], float)]
        if isinstance(p, Plane):
            tex = self._add(texture_albedo(p.texture, p.size_m, seed, folder), smooth=p.texture.kind != "checker")
            return [_rect([0, 0, 0], [1, 0, 0], [0, 1, 0], p.size_m[0] / 2, p.size_m[1] / 2, tex, number)]
        if isinstance(p, Marker):
            hidden = self.scene.hidden
            picture, side = sheet_albedo(p.spec, p.margin_cells, p.ink, p.paper, p.inverted, hidden.worn_ink)
            return [_rect([0, 0, 0], [1, 0, 0], [0, 1, 0], side / 2, side / 2, self._add(picture, False), number, hidden.gloss)]
        assert isinstance(p, Box)
        w, d, h = p.size_m
        tex = self._add(texture_albedo(p.texture, (max(w, d), max(h, d)), seed, folder), smooth=True)
        x, y, z = np.eye(3)
        rows = [_rect([0, 0, s * h], x, y, w / 2, d / 2, tex, number) for s in (0, 1)]
        rows += [_rect([s * w / 2, 0, h / 2], s * y, z, d / 2, h / 2, tex, number) for s in (-1, 1)]
        rows += [_rect([0, s * d / 2, h / 2], -s * x, z, w / 2, h / 2, tex, number) for s in (-1, 1)]
        for row in rows:
            row[17] = 1.0
        return rows

    def poses(self, time_s: float) -> tuple[Pose, ...]:
        """room_from_object of every object."""
        placed = self.scene.placed
        own = [room_from_object(p, time_s, self.duration_s, self.scene.seed, n) for p, n in zip(placed, self._names, strict=True)]
        by_name = {}
        for p, n, pose in zip(placed, self._names, own, strict=True):
            by_name[n] = pose
            if isinstance(p, Marker):
                by_name[p.spec.key] = pose
        return tuple(by_name[p.attached_to] @ pose if p.attached_to else pose for p, pose in zip(placed, own, strict=True))

    def at(self, time_s: float) -> Moment:
        poses = self.poses(time_s)
        rects, spheres = [], []
        for p, faces, pose in zip(self.scene.placed, self._faces, poses, strict=True):
            for row in faces:
                new = row.copy()
                new[:3] = pose.apply(row[:3])
                if isinstance(p, Sphere):
                    spheres.append(new)
                    continue
                for k in (3, 6, 9):
                    new[k : k + 3] = pose.rotation @ row[k : k + 3]
                rects.append(new)
        return Moment(np.array(rects).reshape(-1, 18), np.array(spheres).reshape(-1, 8), self.lamps_at(time_s), poses)

    def camera_at(self, frame: int, time_s: float) -> Pose:
        """camera_from_room at a time during (or next to) a frame, on the path of the frame's shot."""
        shot = int(self.shots[frame])
        first = int(np.searchsorted(self.shots, shot))
        last = int(np.searchsorted(self.shots, shot, side="right")) - 1
        began = self.frame_times_s[first]
        return camera_from_room(
            self.scene.shot[shot].path, time_s - began, self.frame_times_s[last] - began, self.scene.seed, f"shot {shot}"
        )


def true_camera(scene: SceneFile) -> Camera:
    """The camera that the frames are rendered with. Raises InputError for a wrong number of coefficients."""
    w, h, lens = scene.clip.width, scene.clip.height, scene.lens
    f = w / 2 / np.tan(np.radians(lens.fov_deg) / 2)
    cx, cy = (w - 1) / 2 + lens.centre_offset_px[0], (h - 1) / 2 + lens.centre_offset_px[1]
    return Camera(w, h, np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]), np.array(lens.distortion), lens.model, "scene")


def lamp_row(azimuth_deg: float, elevation_deg: float, rgb: Iterable[float], angular_size_deg: float) -> np.ndarray:
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    towards = [np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]
    return np.array([*towards, *rgb, np.tan(np.radians(angular_size_deg) / 2)])


def _rect(centre, u, v, half_w, half_h, texture, number, gloss=0.0) -> np.ndarray:
    u, v = np.asarray(u, float), np.asarray(v, float)
    return np.array([*centre, *u, *v, *np.cross(u, v), half_w, half_h, texture, number, gloss, 0.0], float)


def _summed_areas(pictures: list[tuple[np.ndarray, float]]) -> tuple[np.ndarray, np.ndarray]:
    rows, tables, offset = [], [], 0
    for picture, smallest in pictures:
        h, w = picture.shape[:2]
        sums = np.zeros((h + 1, w + 1, 3))
        sums[1:, 1:] = np.broadcast_to(picture, (h, w, 3)).astype(float).cumsum(0).cumsum(1)
        rows.append([offset, w, h, smallest])
        tables.append(sums.ravel())
        offset += sums.size
    return np.array(rows, float).reshape(-1, 4), np.concatenate(tables) if tables else np.zeros(1)


def _frame_times(scene: SceneFile) -> np.ndarray:
    """Seconds from the first frame, on the clip's 1/90000 s clock."""
    n = np.arange(scene.frames, dtype=float)
    if scene.clip.frame_times == "variable":
        rng = np.random.default_rng([scene.seed, 90_000])
        n[1:-1] += rng.uniform(-0.35, 0.35, max(scene.frames - 2, 0)) if scene.frames > 2 else 0
    return np.round(n / scene.clip.fps * 90_000) / 90_000


def marker_points(marker: Marker, count: int = 12) -> np.ndarray:
    """(count², 3) points spread evenly over the marker's black square, marker axes, metres."""
    h = marker.spec.size_m / 2
    grid = (np.arange(count) + 0.5) / count * 2 * h - h
    return np.array([(x, y, 0.0) for x, y in itertools.product(grid, grid)])
