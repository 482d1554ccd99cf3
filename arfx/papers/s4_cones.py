"""Step 4 of Yao, Tao, Wu 2018: cones through the octree's volumes.

One narrow cone about the mirrored direction, several wide ones over the hemisphere: here six.
Samples lie half a cone's width apart, on the level whose voxels are as wide as the cone there,
linear between voxels and between levels. A step of length ds through voxels of side s takes 1 - (1
- alpha)^(ds / s) of what lies behind; the voxels' radiance counts whole, whatever the step.

What V_eta, the volume of normals, is for is not said. Here voxels that face away from a cone's
start neither send nor hide, or a surface would hide the light from itself; where normals cancel (a
thin wall, a coarse voxel) both sides count.

Its errors: docs/methods/gi.md#errata."""

# mypy: disable-error-code="no-untyped-def"
import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.parallel import parallel_rows
from arfx.papers.s4_volumes import Octree, Volumes, node_below

_DARK = np.float32(0.005)  # less of the background than this is none
_FRONT = np.float32(4.0)  # 1 over the cosine from which on a voxel is seen whole
SPACING = 0.5  # of samples, widths of the cone
_FEW = 256  # points: below it threads cost more than they save
# Cosine of the tilt of the five: a cosine lobe leaves 2/3 and 1/4 of the first two degrees of what
# is around, and with cones of 30 degrees this tilt leaves .667 and .247.
TILT_COSINE = 0.619
WIDE_DEG = 30.0  # half-angle of the six


def six_cones() -> tuple[ndarray, ndarray, float]:
    """(directions (6, 3) about +z, weights (6,), tangent of the half-angle): one up, five 52
    degrees from it."""
    turn = np.arange(5) * 2 * np.pi / 5
    aside = np.sqrt(1 - TILT_COSINE**2)
    ring = np.stack(
        [aside * np.cos(turn), aside * np.sin(turn), np.full(5, TILT_COSINE)], -1
    )
    directions = np.concatenate([[[0.0, 0.0, 1.0]], ring]).astype(np.float32)
    weights = np.array([0.25] + [0.15] * 5, np.float32)
    return directions, weights, float(np.tan(np.radians(WIDE_DEG)))


def around_normals(normals: ndarray, directions: ndarray) -> ndarray:
    """(m, k, 3) float32: directions (k, 3) about +z turned to each of the unit normals (m, 3)."""
    x, y, z = np.asarray(normals, np.float32).T
    a = 1 / np.maximum(1 + z, np.float32(1e-5))
    b = -x * y * a
    u = np.stack([1 - x * x * a, b, -x], -1)
    v = np.stack([b, 1 - y * y * a, -y], -1)
    down = z < -0.99999
    u[down], v[down] = (0, -1, 0), (-1, 0, 0)
    frame = np.stack([u, v, np.stack([x, y, z], -1)], 1)
    return np.asarray(directions @ frame, np.float32)


def cone_steps(tan_half: float, n: int) -> ndarray:
    """(k, 3) float32 of a cone through n^3 voxels: distance of each sample, voxels; its level; ds /
    s. From where the cone is a voxel wide, or one voxel off, to 8 n, beyond which nothing is larger
    than a few degrees."""
    out = []
    t = min(0.5 / tan_half, 1.0)
    while t < 8 * n:
        ds = SPACING * max(2 * tan_half * t, 1.0)
        level = min(np.log2(max(2 * tan_half * (t + ds / 2), 1.0)), np.log2(n))
        out.append((t + ds / 2, level, ds / 2**level))
        t += ds
    return np.array(out, np.float32)


def cone_trace(
    volumes: Volumes,
    V: ndarray,
    steps: ndarray,
    positions_m: ndarray,
    directions: ndarray,
) -> ndarray:
    """(m, k, 4) radiance of V, and share of the background that is left, of cones from positions
    (m, 3), metres, anchor axes, in directions (m, k, 3), unit. V (nodes, 3) float32
    steps : of `cone_steps`"""
    start = volumes.in_voxels(positions_m).astype(np.float32)
    d = np.ascontiguousarray(directions, np.float32)
    parts = parallel_rows(
        lambda a, b: _cone_trace(volumes.tree, V, steps, start[a:b], d[a:b]),
        len(start),
        least=_FEW,
    )
    return np.concatenate([np.zeros((0, d.shape[1], 4), np.float32), *parts])


@kernel(error_model="numpy")
def _cone_trace(
    tree: Octree, V, steps, start, directions
):  # pragma: no cover - compiled
    """`cone_trace` of some. start (m, 3) : voxels"""
    out = np.zeros((start.shape[0], directions.shape[1], 4), np.float32)
    seen, above = np.empty((2, 4), np.float32)
    size = np.float32(1 << tree.depth)
    half = np.float32(0.5)
    one = np.float32(1)
    for i in range(start.shape[0]):
        for c in range(directions.shape[1]):
            d = directions[i, c]
            transmittance = one
            for k in range(steps.shape[0]):
                t = steps[k, 0]
                level = int(steps[k, 1])
                exponent = steps[k, 2]
                coarser = steps[k, 1] - np.float32(level)
                reach = half * np.float32(1 << level) * (one + coarser)
                at = (
                    start[i, 0] + t * d[0],
                    start[i, 1] + t * d[1],
                    start[i, 2] + t * d[2],
                )
                if min(at) < -reach or max(at) > size + reach:
                    continue
                sample(tree, V, level, at, d, seen)
                if coarser > 0:
                    sample(tree, V, level + 1, at, d, above)
                    for channel in range(4):
                        seen[channel] += coarser * (above[channel] - seen[channel])
                alpha = seen[3]
                if alpha <= 0:
                    continue
                left = (one - min(alpha, one)) ** exponent
                for channel in range(3):
                    out[i, c, channel] += transmittance * seen[channel]
                transmittance *= left
                if transmittance < _DARK:
                    transmittance = np.float32(0)
                    break
            out[i, c, 3] = transmittance
    return out


@kernel(error_model="numpy")
def sample(tree: Octree, V, level, at, d, out):  # pragma: no cover - compiled
    """out (4,) : r, g, b, opacity as seen along d, linear between the level's eight voxels around
    `at`, in voxels of the lowest."""
    zero = np.float32(0)
    half = np.float32(0.5)
    one = np.float32(1)
    s = one / np.float32(1 << level)
    x, y, z = at[0] * s - half, at[1] * s - half, at[2] * s - half  # whole at centres
    ix = int(np.floor(x))
    iy = int(np.floor(y))
    iz = int(np.floor(z))
    fx = x - np.float32(ix)
    fy = y - np.float32(iy)
    fz = z - np.float32(iz)
    out[:] = zero
    # the eight are looked for from the lowest node that holds them all: most often there is none
    bits = tree.depth - level
    up = 0
    differ = (ix ^ (ix + 1)) | (iy ^ (iy + 1)) | (iz ^ (iz + 1))
    while up < bits and differ >> up:
        up += 1
    shared = node_below(tree, 0, bits - up, ix >> up, iy >> up, iz >> up)
    if shared < 0:
        return
    for corner in range(8):
        jx = ix + (corner & 1)
        jy = iy + (corner >> 1 & 1)
        jz = iz + (corner >> 2)
        w = (
            (fx if jx > ix else one - fx)
            * (fy if jy > iy else one - fy)
            * (fz if jz > iz else one - fz)
        )
        if w <= 0:
            continue
        if min(jx, jy, jz) < 0 or max(jx, jy, jz) >> bits:
            continue
        node = node_below(tree, shared, up, jx, jy, jz)
        if node < 0 or tree.eta[node, 3] <= 0:
            continue
        alpha = tree.eta[node, 3]
        cosine = zero
        length2 = zero
        for k in range(3):
            normal = tree.eta[node, k] / alpha
            cosine += normal * d[k]
            length2 += normal * normal
        facing = max(-_FRONT * cosine, zero)
        w *= min(facing + max(one - np.sqrt(length2), zero), one)
        for k in range(3):
            out[k] += w * V[node, k]
        out[3] += w * alpha
