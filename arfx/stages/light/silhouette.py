"""Silhouettes of the triangles on the plane along directions of a light, counted.

The silhouette is what the contour winds around: the edges between triangles that face the
light and triangles that do not. Those are few (some 300 of 6,000 triangles), and any model
has them, whether its surface is closed or not. Every direction shifts the texels' sample
points a little, so that the mean over the directions is antialiased even where the object
touches the plane and all silhouettes agree. Cost: O(directions x (texels + rows that the
contour crosses))"""

# mypy: disable-error-code="no-untyped-def, assignment"
import numpy as np
from numpy import ndarray

from arfx.core.compiled import kernel
from arfx.core.sampling import r2

_F = np.float32
_NEAR = 1e-6  # texels: no gap between two triangles


def covered_fraction(
    points: ndarray,
    edges: ndarray,
    across: ndarray,
    directions: ndarray,
    slopes: ndarray,
    shape: tuple[int, int],
) -> ndarray:
    """(rows, columns) float32: in what share of the directions a texel is covered.

    points (n, 3) float32 : column, row (texel centres at integers) and height above the
    plane, in texels
    edges (e, 5), across (3, m) : see Caster;  directions (k, 3) : towards the light, in the
    axes of `across`
    slopes (k, 2) : columns and rows by which a point one texel high is displaced
    """
    offsets = r2(len(slopes)) - 0.5
    offsets -= offsets.mean(0)
    towards, moved, shifts = (
        a.astype(np.float32) for a in (directions, slopes, offsets)
    )
    count = _count(points, edges, across, towards, moved, shifts, *shape)
    return np.asarray(count / _F(len(slopes)))


@kernel()
def _count(
    points, edges, across, directions, slopes, offsets, rows, columns
):  # pragma: no cover - compiled
    count = np.zeros((rows, columns), np.float32)
    turns = np.empty((rows, columns + 1), np.int32)
    u, v = (
        np.empty(points.shape[0], np.float32),
        np.empty(points.shape[0], np.float32),
    )
    side = np.empty(across.shape[1] + 1, np.int32)
    for k in range(slopes.shape[0]):
        for i in range(points.shape[0]):
            u[i] = points[i, 0] + slopes[k, 0] * points[i, 2] + offsets[k, 0]
            v[i] = points[i, 1] + slopes[k, 1] * points[i, 2] + offsets[k, 1]
        dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
        for f in range(across.shape[1]):
            rise = across[0, f] * dx + across[1, f] * dy + across[2, f] * dz
            side[f] = np.int32(1) if rise > 0 else np.int32(-1)
        side[across.shape[1]] = 0  # the face that an open edge lacks, found as -1
        turns[:] = 0
        for e in range(edges.shape[0]):
            weight = side[edges[e, 2]] + edges[e, 4] * side[edges[e, 3]]
            if weight != 0:
                _add_edge(turns, u, v, edges[e, 0], edges[e, 1], weight)
        for y in range(rows):
            total = np.int32(0)
            for x in range(columns):
                total += turns[y, x]
                count[y, x] += total != 0
    return count


@kernel()
def _add_edge(turns, u, v, a, b, weight):  # pragma: no cover - compiled
    """turns (rows, columns + 1) += how often the contour turns around all texels to the
    right of an edge from point a to b.

    A vertex belongs to the row above it, whichever edge asks, so that the sums of every row
    end at 0."""
    if v[b] < v[a]:
        a, b, weight = b, a, -weight
    zero, last_column = np.int64(0), np.int64(turns.shape[1] - 1)
    first = max(np.int64(np.ceil(v[a])), zero)
    last = min(np.int64(np.ceil(v[b])), np.int64(turns.shape[0]))
    for y in range(first, last):
        slope = (u[b] - u[a]) / (v[b] - v[a])
        x = np.int64(np.ceil(u[a] + (_F(y) - v[a]) * slope))
        turns[y, min(max(x, zero), last_column)] += weight


@kernel()
def height_map(
    u, v, height, faces, rows, columns, empty
):  # pragma: no cover - compiled
    """(rows, columns) float32: the greatest height of the triangles at each texel's centre;
    `empty` where there is none.

    u, v, height : (n,) of the vertices, texels (centres at integers)"""
    out = np.full((rows, columns), empty, np.float32)
    for f in range(faces.shape[0]):
        i, j, k = np.uintp(faces[f, 0]), np.uintp(faces[f, 1]), np.uintp(faces[f, 2])
        across, down = u[j] - u[i], v[j] - v[i]
        far, low = u[k] - u[i], v[k] - v[i]
        area = across * low - down * far
        if area == 0:
            continue
        bottom = min(height[i], height[j], height[k])
        top = max(height[i], height[j], height[k])
        first = max(int(np.ceil(min(v[i], v[j], v[k]))), 0)
        last = min(int(np.floor(max(v[i], v[j], v[k]))), rows - 1)
        for y in range(first, last + 1):
            # shares of the second and the third corner at column 0, and what a column adds
            second = (-u[i] * low - (y - v[i]) * far) / area
            third = (across * (y - v[i]) + u[i] * down) / area
            more, less = low / area, -down / area
            begin, end = 0.0, columns - 1.0
            for share, slope in (
                (second, more),
                (third, less),
                (1 - second - third, -more - less),
            ):
                if slope > 0:
                    begin = max(begin, -share / slope)
                elif slope < 0:
                    end = min(end, -share / slope)
                elif share < 0:
                    end = -1.0
            for x in range(
                int(np.ceil(begin - _NEAR)), int(np.floor(end + _NEAR)) + 1
            ):
                h = height[i] + (second + x * more) * (height[j] - height[i])
                h += (third + x * less) * (height[k] - height[i])
                # slivers have slopes without bound: never beyond their own corners
                out[y, x] = max(out[y, x], min(max(h, bottom), top))
    return out
