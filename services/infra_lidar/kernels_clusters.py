"""Compiled measures of grouped clusters: extent along the axes of the footprint, height, local frames."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.extremes import LARGEST, SMALLEST, low_high, ordered, unordered
from services.infra_lidar.jit import kernel, sum_kernel


@kernel
def count_labels(label, counts):  # type: ignore[no-untyped-def]
    """counts (K,) int32: points per label."""
    counts[:] = 0
    for i in range(label.shape[0]):
        if label[i] >= 0:
            counts[np.uint32(label[i])] += 1


@kernel
def arrange(label, number, offsets, x, y, z, above, source, ax, ay, az, aa, asource):  # type: ignore[no-untyped-def]
    """Copy the points so that those of cluster ``number[label]`` lie together, in their order; -1 is left out.

    offsets (K + 1,) int64 is where each cluster begins.
    """
    slot = offsets[:-1].astype(np.uint32)  # unsigned indices need no check for a negative one
    for i in range(label.shape[0]):
        if label[i] >= 0:
            k = number[np.uint32(label[i])]
            if k >= 0:
                j = slot[np.uint32(k)]
                ax[j], ay[j], az[j], aa[j], asource[j] = x[i], y[i], z[i], above[i], source[i]
                slot[np.uint32(k)] = j + np.uint32(1)


@sum_kernel
def _moments(x, y):  # type: ignore[no-untyped-def]
    """Sums of x, y, x x, x y, y y about the first point."""
    x0, y0 = x[0], y[0]
    sx = sy = sxx = sxy = syy = np.float32(0.0)
    for i in range(len(x)):
        dx, dy = x[i] - x0, y[i] - y0
        sx += dx
        sy += dy
        sxx += dx * dx
        sxy += dx * dy
        syy += dy * dy
    return sx, sy, sxx, sxy, syy


@kernel
def _extent_along(x, y, x0, y0, c, s):  # type: ignore[no-untyped-def]
    """Smallest and largest c (x - x0) + s (y - y0)."""
    low, high = LARGEST, SMALLEST
    for i in range(len(x)):
        low = np.int32(min(low, ordered(c * (x[i] - x0) + s * (y[i] - y0))))
    for i in range(len(x)):
        high = np.int32(max(high, ordered(c * (x[i] - x0) + s * (y[i] - y0))))
    return unordered(low), unordered(high)


@kernel
def measure(x, y, z, above, offsets, box):  # type: ignore[no-untyped-def]
    """Oriented extents of clusters whose points lie together: cluster k is offsets[k] to offsets[k + 1].

    box (K, 8) float32 is written: centre x, y, z, length, width, height (m, length along the larger principal axis of
    the footprint), yaw (rad), lowest height above the road.
    """
    for k in range(offsets.shape[0] - 1):
        first, last = offsets[k], offsets[k + 1]
        n = last - first
        if n <= 0:
            box[k, :] = 0.0
            continue
        if n == 1:  # most pieces are a single return
            box[k, 0], box[k, 1], box[k, 2], box[k, 7] = x[first], y[first], z[first], above[first]
            box[k, 3:7] = 0.0
            continue
        bx, by = x[first:last], y[first:last]
        sx, sy, sxx, sxy, syy = _moments(bx, by)
        mx, my = sx / n, sy / n
        cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        yaw = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy)
        c, s = np.float32(np.cos(yaw)), np.float32(np.sin(yaw))
        u0, u1 = _extent_along(bx, by, bx[0], by[0], c, s)
        v0, v1 = _extent_along(bx, by, bx[0], by[0], -s, c)
        w0, w1 = low_high(z[first:last])
        a0, _ = low_high(above[first:last])
        u, v = (u0 + u1) * np.float32(0.5), (v0 + v1) * np.float32(0.5)
        box[k, 0] = bx[0] + c * u - s * v
        box[k, 1] = by[0] + s * u + c * v
        box[k, 2] = (w0 + w1) * np.float32(0.5)
        box[k, 3], box[k, 4], box[k, 5] = u1 - u0, v1 - v0, w1 - w0
        box[k, 6] = yaw
        box[k, 7] = a0


@kernel
def gather_points(rest, x, y, z, above, below_body, gx, gy, gz, ga, source):  # type: ignore[no-untyped-def]
    """Planar copies of the points to be clustered: the rest of a frame, lower than ``below_body`` above the road
    (all if it is 0 or less). Those above come after them. Returns (low, all)."""
    m = rest.shape[0]
    low = 0
    for j in range(m):
        if below_body <= 0 or above[j] < below_body:
            i = rest[j]
            gx[low], gy[low], gz[low], ga[low], source[low] = x[i], y[i], z[i], above[j], i
            low += 1
    high = low
    if below_body > 0:
        for j in range(m):
            if above[j] >= below_body:
                i = rest[j]
                gx[high], gy[high], gz[high], ga[high], source[high] = x[i], y[i], z[i], above[j], i
                high += 1
    return low, high


@kernel
def tall_components(label, above, components, band_low, band_high, share, in_band, total, tall):  # type: ignore[no-untyped-def]
    """Which components reach the top of the body band: their upper points belong to them, not to a tree above."""
    in_band[:components] = 0
    total[:components] = 0
    for i in range(label.shape[0]):
        k = label[i]
        if k >= 0:
            total[k] += 1
            in_band[k] += (above[i] >= band_low) & (above[i] < band_high)
    for k in range(components):
        tall[k] = in_band[k] >= max(3.0, share * total[k])


@kernel
def drop_high_of_low(label, low, tall):  # type: ignore[no-untyped-def]
    """Labels of points [low:] are kept only for tall components."""
    for i in range(low, label.shape[0]):
        if label[i] >= 0 and not tall[label[i]]:
            label[i] = -1


@kernel
def write_ids(source, offsets, cluster_id):  # type: ignore[no-untyped-def]
    """cluster_id (N,) of the frame, from the index of points that lie together by cluster."""
    cluster_id[:] = -1
    for k in range(offsets.shape[0] - 1):
        for i in range(offsets[k], offsets[k + 1]):
            cluster_id[np.uint32(source[i])] = k
