"""Compiled measures of grouped clusters: extent along the axes of the footprint, height, local frames."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import kernel


@kernel
def measure(x, y, z, above, order, offsets, box):  # type: ignore[no-untyped-def]
    """Oriented extents of each cluster.

    Points of cluster k are order[offsets[k]:offsets[k + 1]]. box (K, 8) float32 is written: centre x, y, z, length,
    width, height (m, length along the larger principal axis of the footprint), yaw (rad), lowest height above road.
    """
    for k in range(offsets.shape[0] - 1):
        first, last = offsets[k], offsets[k + 1]
        n = last - first
        if n <= 0:
            box[k, :] = 0.0
            continue
        x0, y0 = x[order[first]], y[order[first]]
        sx = sy = sxx = sxy = syy = 0.0
        for j in range(first, last):
            i = order[j]
            dx, dy = np.float64(x[i] - x0), np.float64(y[i] - y0)
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
        mx, my = sx / n, sy / n
        cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
        yaw = 0.5 * np.arctan2(2.0 * cxy, cxx - cyy)
        c, s = np.float32(np.cos(yaw)), np.float32(np.sin(yaw))
        u0 = v0 = w0 = a0 = np.float32(np.inf)
        u1 = v1 = w1 = np.float32(-np.inf)
        for j in range(first, last):
            i = order[j]
            dx, dy = x[i] - x0, y[i] - y0
            u, v = c * dx + s * dy, c * dy - s * dx
            u0, u1 = min(u0, u), max(u1, u)
            v0, v1 = min(v0, v), max(v1, v)
            w0, w1 = min(w0, z[i]), max(w1, z[i])
            a0 = min(a0, above[i])
        u, v = (u0 + u1) * np.float32(0.5), (v0 + v1) * np.float32(0.5)
        box[k, 0] = x0 + c * u - s * v
        box[k, 1] = y0 + s * u + c * v
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
def renumber(label, keep):  # type: ignore[no-untyped-def]
    """label -> keep[label] (-1 stays -1)."""
    for i in range(label.shape[0]):
        if label[i] >= 0:
            label[i] = keep[label[i]]


@kernel
def write_ids(label, source, cluster_id, order, offsets, x, y, z, grouped):  # type: ignore[no-untyped-def]
    """Cluster id per point of the frame, and the points (M, 3) in cluster order."""
    cluster_id[:] = -1
    for i in range(label.shape[0]):
        if label[i] >= 0:
            cluster_id[source[i]] = label[i]
    for j in range(offsets[-1]):
        i = order[j]
        grouped[j, 0], grouped[j, 1], grouped[j, 2] = x[i], y[i], z[i]
