"""What the object changes on the real planes, as textures that pixels look up.

Places of a plane see the object by few rays, so what they gain is known coarsely; how much
of their hemisphere it hides is known finely, by silhouettes. Their quotient, the radiance
of what hides less that of what is hidden, is even: so the change is the fine share times
the coarse quotient, sharp where the object stands. Planes that it does not stand on have
the coarse share. Source: docs/methods/gi.md#delta."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy import ndarray

from arfx.core.layers import Layer, Layers
from arfx.core.numerics import divide, normalise
from arfx.core.pose import Pose
from arfx.core.stage import View
from arfx.stages.holdout import plane_dioptres
from arfx.stages.light.plane_lookup import PlaneTexture, PlaneView
from arfx.stages.light.plane_shadow import texel_places
from arfx.stages.light.planes import SHOWS, Planes, on_plane, warped
from arfx.stages.light.transport import Indirect
from arfx.stages.viewing import between_nodes

Rows = tuple[ndarray, ndarray]  # rows and columns of some pixels
SeenPlaces = tuple[int, Rows, ndarray, ndarray, ndarray]

DARKEST = np.float32(0.002)  # radiance below which a pixel is no base for a ratio
# of the distance: measured depth that is off by less lies on the plane; by twice that, not
SAME_DEPTH = 0.02
_EVENED_TEXELS = 0.8  # blur of what few rays bring
_EVENED_FOR_SIZE = 2.0  # the same, where a single ray must not count
_OTHER_SIDE = 192  # texels of a plane that the object does not stand on
_RIM = 0.85  # share of a plane's texture from which on the change fades out


def measured(layers: Layers) -> ndarray:
    """(h, w) the layer REAL_DEPTH; (0, 0) where the job has none."""
    if (
        layers.extent(Layer.REAL_DEPTH).empty
        or not np.isfinite(layers[Layer.REAL_DEPTH]).any()
    ):
        return np.zeros((0, 0), np.float32)
    return np.array(layers[Layer.REAL_DEPTH], np.float32, order="C")


def plane_pose(axes: ndarray) -> Pose:
    """The plane's own axes from the anchor's. axes (4, 3) : of `Planes`"""
    rotation = np.asarray(axes[1:], float)
    return Pose(rotation, -rotation @ np.asarray(axes[0], float))


def change_textures(
    light: Indirect, hidden: ndarray, planes: Planes, soft: Sequence[PlaneTexture]
) -> list[list[PlaneTexture]]:
    """Of each plane, textures (3, rows, columns) that add up: share of all the plane's light
    that the object adds.

    hidden (p, side, side) : of `Transport`;  soft : pictures of the first plane that add
    up, in the anchor's axes; the
    other planes' textures are in their own"""
    out = []
    for k, axes in enumerate(planes.axes.astype(float)):
        gain, dark = (
            cv2.GaussianBlur(a, (0, 0), _EVENED_TEXELS)
            for a in (light.gain[k], hidden[k])
        )
        turn, shift = np.eye(2), np.zeros(2)
        if k == 0:
            turn, shift = axes[1:3, :2], -axes[1:3] @ axes[0]
        blank = _even_picture(planes.half_m, -np.linalg.solve(turn, shift))
        shares = [(p, p.dark[0]) for p in soft] if k == 0 else [(blank, dark)]
        quotient = divide(gain, dark[..., None] * light.total[k])
        beside = light.spread[k] / light.total[k]
        textures: list[PlaneTexture] = []
        for texture, share in shares:
            places = (texel_places(texture) @ turn.T + shift) / planes.half_m
            if texture is blank:
                share = sampled(share[..., None], places)[..., 0]
            change = share[..., None] * sampled(quotient, places)
            if not textures:  # the others are parts of the first
                change += sampled(beside, places)
            rim = (1 - np.linalg.norm(places, axis=-1)) / (1 - _RIM)
            change = np.moveaxis(change * np.clip(rim, 0, 1)[..., None], 2, 0)
            inner = np.pad(change[:, 1:-1, 1:-1], ((0, 0), (1, 1), (1, 1)))
            change = inner.astype(np.float32, "C")
            textures.append(PlaneTexture(change, texture.texel_from_m))
        out.append(textures)
    return out


def _even_picture(half_m: float, middle_m: ndarray) -> PlaneTexture:
    """Nothing, about a place of the plane."""
    scale = (_OTHER_SIDE - 1) / (2 * half_m)
    corner = (_OTHER_SIDE - 1) / 2 - scale * middle_m
    matrix = np.column_stack([scale * np.eye(2), corner])
    return PlaneTexture(np.zeros((_OTHER_SIDE, _OTHER_SIDE), np.float32), matrix)


def sampled(texels: ndarray, places: ndarray) -> ndarray:
    """(h, w, c) of a warped texture (side, side, c) at places (h, w, 2) in half sides from
    its middle.
    """
    side = len(texels)
    at = ((warped(np.clip(places, -1, 1)) + 1) / 2 * side - 0.5).astype(np.float32)
    source = np.ascontiguousarray(texels, np.float32)
    x, y = np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])
    out = cv2.remap(source, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return out.reshape(*places.shape[:2], -1)


def add_change(
    shadow: ndarray,
    layers: Layers,
    grid: ndarray,
    anchor_from_camera: Pose,
    planes: Planes,
    textures: Sequence[Sequence[PlaneTexture]],
    strength: float,
) -> None:
    """shadow (h, w, 3) over the layers' rectangle += strength x the planes' change, never below 0.

    grid : viewing directions;  textures : of `change_textures`
    """
    channels = np.moveaxis(shadow, 2, 0)
    shares = shown_planes(layers, grid, anchor_from_camera, planes)
    for k, share in enumerate(shares):
        own = anchor_from_camera
        if k > 0:
            own = plane_pose(planes.axes[k]) @ own
        if own.translation_m[2] <= 0:
            continue
        view = PlaneView(layers.rect, grid, own)
        for texture in textures[k]:
            view.add(channels, texture, np.full(3, strength), share)
    np.maximum(shadow, 0, out=shadow)


def shown_planes(
    layers: Layers, grid: ndarray, anchor_from_camera: Pose, planes: Planes
) -> list[ndarray]:
    """(h, w) of each plane: is it what a pixel shows, 0..1; of a lone one wherever it is in view.
    What was measured and is on none shows none."""
    real, rect = measured(layers), layers.rect
    if len(planes.axes) == 1 and not real.size:
        return [np.ones((rect.height, rect.width), np.float32)]
    poses = [plane_pose(axes) @ anchor_from_camera for axes in planes.axes]
    dioptres = np.stack([plane_dioptres(grid, p.inverse(), rect) for p in poses])
    dioptres[[pose.translation_m[2] <= 0 for pose in poses]] = -1
    nearest = dioptres.argmax(0)
    agree = np.ones_like(dioptres)
    if real.size:  # planes end: depth says which of them a pixel shows
        known = np.isfinite(real) & (real > 0)
        off = np.abs(np.where(known, real, 0) * dioptres - 1)
        nearest = np.where(known, off.argmin(0), nearest)
        agree = np.stack([on_plane(real, d, SAME_DEPTH) for d in dioptres])
    shown = [(nearest == k) & (dioptres[k] > 0) for k in range(len(poses))]
    return [
        np.where(s, a, 0).astype(np.float32)
        for s, a in zip(shown, agree, strict=True)
    ]


def seen_places(
    view: View, layers: Layers, grid: ndarray, planes: Planes
) -> Iterator[SeenPlaces]:
    """Of each plane that the camera is before: its number, and of the pixels (n,) over the
    layers' rectangle that show it: rows and columns, share, and unit viewing direction and
    place that is met (n, 3), anchor axes."""
    anchor_from_camera = (view.pose @ view.scene.world_from_anchor).inverse()
    eye = anchor_from_camera.translation_m
    nodes = (grid @ anchor_from_camera.rotation.T).astype(np.float32)
    directions = between_nodes(nodes, layers.rect)
    shares = shown_planes(layers, grid, anchor_from_camera, planes)
    for k, (origin, *_, normal) in enumerate(planes.axes.astype(float)):
        height = (eye - origin) @ normal
        shown = (directions @ normal < 0) & (shares[k] > 0) & (height > 0)
        row, column = np.nonzero(shown)
        d = normalise(directions[row, column].astype(float))
        places = eye - (height / (d @ normal))[:, None] * d
        yield k, (row, column), shares[k][row, column], d, places


def visible_radius_m(light: Indirect, planes: Planes, positions: ndarray) -> float:
    """Distance from the planes' origins beyond which no texel's change shows.

    positions (p, side, side, 3) : of the texels"""
    shares = ((light.gain + light.spread) / light.total).astype(np.float32)
    evened = [cv2.GaussianBlur(share, (0, 0), _EVENED_FOR_SIZE) for share in shares]
    change = np.abs(np.stack(evened)).max(-1)
    shows = change >= SHOWS
    away = np.linalg.norm(positions - planes.axes[:, None, None, 0], axis=-1)
    return float(min(away[shows].max() * 1.25, planes.half_m)) if shows.any() else 0.0
