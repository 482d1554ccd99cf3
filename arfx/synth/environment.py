"""Environment light as a set of directional lights: median cut of an HDR panorama (Debevec 2005).

Panoramas are equirectangular with the room's z up: the middle column looks along x, the left half holds +y.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from arfx.errors import InputError
from arfx.media.images import decode_picture


def environment_picture(source: str | Path, folder: Path | None = None) -> np.ndarray:
    """(h, 2h, 3) float64 linear radiance. `source`: "studio", "sunset" or an .hdr file beside the scene.

    Raises InputError if the file cannot be read or holds values that are not finite and >= 0.
    """
    if str(source) in ("studio", "sunset"):
        return _made(str(source))
    path = (folder or Path()) / source
    picture = decode_picture(path, "image", cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    rgb = picture[..., ::-1].astype(float)
    if not np.isfinite(rgb).all() or rgb.min() < 0:
        raise InputError(f"environment {path} holds values that are not finite and >= 0")
    return cv2.resize(rgb, (256, 128), interpolation=cv2.INTER_AREA)


def _made(name: str) -> np.ndarray:
    h, w = 128, 256
    z, towards = _directions(h, w)
    boxes: tuple[tuple[tuple[float, float, float], int, tuple[float, float, float]], ...]
    if name == "studio":  # grey room, two soft boxes and a warm strip
        base = np.repeat((0.25 + 0.1 * z)[..., None], 3, axis=2)
        boxes = (
            ((0.5, -0.6, 0.62), 14, (5.5, 5.6, 6.0)),
            ((-0.7, 0.3, 0.65), 10, (2.6, 2.5, 2.3)),
            ((-0.1, 0.9, 0.4), 8, (2.0, 1.4, 0.8)),
        )
    else:
        sky = np.stack([0.25 + 0.5 * (1 - np.abs(z)) ** 3, 0.3 + 0.25 * (1 - np.abs(z)) ** 3, 0.5 - 0.1 * np.abs(z)], -1)
        base = np.where((z > 0)[..., None], sky, [0.12, 0.11, 0.1])
        boxes = (((0.85, 0.35, 0.4), 4, (70.0, 52.0, 30.0)),)
    for centre, radius_deg, rgb in boxes:
        unit = np.asarray(centre) / np.linalg.norm(centre)
        base = np.where((towards @ unit > np.cos(np.radians(radius_deg)))[..., None], rgb, base)
    return base


def _directions(h: int, w: int) -> tuple[np.ndarray, np.ndarray]:
    elevation = np.pi * (0.5 - (np.arange(h) + 0.5) / h)
    azimuth = 2 * np.pi * (0.5 - (np.arange(w) + 0.5) / w)
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    towards = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    return towards[..., 2], towards


def environment_lamps(picture: np.ndarray, count: int) -> np.ndarray:
    """(count, 7) tracer lamps that together light a surface as the panorama does.

    A region's radiance times its solid angle / pi is the rgb of its lamp (arfx.core.light folds pi in).
    """
    h, w = picture.shape[:2]
    _, towards = _directions(h, w)
    solid = np.repeat((np.cos(np.pi * (0.5 - (np.arange(h) + 0.5) / h)) * (np.pi / h) * (2 * np.pi / w))[:, None], w, 1)
    power = picture.mean(-1) * solid
    regions = [(0, h, 0, w)]
    while len(regions) < count:
        sizes = [power[a:b, c:d].sum() if (b - a) * (d - c) > 1 else -1.0 for a, b, c, d in regions]
        pick = int(np.argmax(sizes))
        if sizes[pick] <= 0:
            break
        a, b, c, d = regions.pop(pick)
        part = power[a:b, c:d]
        middle = np.cos(np.pi * (0.5 - (a + b) / 2 / h))
        down = (b - a) > (d - c) * 2 * h / w * middle if d - c > 1 else True
        sums = part.sum(1 if down else 0).cumsum()
        cut = int(np.clip(np.searchsorted(sums, sums[-1] / 2) + 1, 1, len(sums) - 1))
        regions += [(a, a + cut, c, d), (a + cut, b, c, d)] if down else [(a, b, c, c + cut), (a, b, c + cut, d)]
    rows = []
    for a, b, c, d in regions:
        weight = power[a:b, c:d]
        mean = (towards[a:b, c:d] * weight[..., None]).sum((0, 1))
        size = float(np.linalg.norm(mean))
        if size <= 0:
            continue
        rgb = (picture[a:b, c:d] * solid[a:b, c:d, None]).sum((0, 1)) / np.pi
        rows.append([*(mean / size), *rgb, 0.0])
    return np.array(rows, float).reshape(-1, 7)
