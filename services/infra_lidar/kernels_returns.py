"""What all passes over the returns of a frame share: reading rows as vectors, and their direction."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.jit import inline, inner, kernel
from services.infra_lidar.vectors import (
    LANES,
    every,
    fma,
    gather,
    lanes,
    larger,
    magnitude,
    prefetch,
    select,
    smaller,
)

PI, HALF_PI = np.float32(np.pi), np.float32(np.pi / 2)
TINY = np.float32(1e-20)
AHEAD = 256  # returns that are fetched before they are read: processors do so themselves, but stop at every page
BLOCK = 1024  # returns that are handled together: what one step leaves behind is near when the next one comes


@inline
def columns_of(flat, at, width):  # type: ignore[no-untyped-def]
    """x, y, z and fifth column, the ring (0 without), of LANES rows of points (N, width) float32, flat from ``at``."""
    if width == 5:
        return every(flat, at, 5, 0), every(flat, at, 5, 1), every(flat, at, 5, 2), every(flat, at, 5, 4)
    if width == 4:
        z = every(flat, at, 4, 2)
        return every(flat, at, 4, 0), every(flat, at, 4, 1), z, z * np.float32(0.0)
    if width == 3:
        z = every(flat, at, 3, 2)
        return every(flat, at, 3, 0), every(flat, at, 3, 1), z, z * np.float32(0.0)
    row = lanes() * np.int32(width) + np.int32(at)
    return gather(flat, row), gather(flat, row + 1), gather(flat, row + 2), gather(flat, row + 4)


@inline
def fetch_ahead(flat, at, width):  # type: ignore[no-untyped-def]
    """Bring rows nearer that come AHEAD of those at ``at``, LANES of them."""
    first = at + AHEAD * width
    if width == 5 and LANES == 16:  # spelled out: a loop of five costs more than they do
        prefetch(flat, first)
        prefetch(flat, first + 16)
        prefetch(flat, first + 32)
        prefetch(flat, first + 48)
        prefetch(flat, first + 64)
    else:
        for k in range(0, LANES * width, 16):
            prefetch(flat, first + k)


@inner
def whole_block(flat, width, start, n):  # type: ignore[no-untyped-def]
    """A block's rows so that whole vectors can be read: the array and where they begin in it.

    The last block of a frame is copied, with rows of zeros, which are no returns, behind it.
    """
    if start + BLOCK <= n:
        return flat, start * width
    copy = np.zeros((n - start + LANES) * width, np.float32)
    for i in range((n - start) * width):
        copy[i] = flat[start * width + i]
    return copy, 0


@inline
def angle(y, x):  # type: ignore[no-untyped-def]
    """Angle of (x, y) in radians, error under 2e-6: odd polynomial on [0, 1] and octant folding."""
    ax, ay = magnitude(x), magnitude(y)
    a = smaller(ax, ay) / larger(larger(ax, ay), TINY)
    s = a * a
    p = fma(s, np.float32(-0.0117212), np.float32(0.05265332))
    p = fma(p, s, np.float32(-0.11643287))
    p = fma(p, s, np.float32(0.19354346))
    p = fma(p, s, np.float32(-0.33262347))
    p = fma(p, s, np.float32(0.99997726)) * a
    p = select(ay > ax, HALF_PI - p, p)
    p = select(x < np.float32(0.0), PI - p, p)
    return select(y < np.float32(0.0), p * np.float32(-1.0), p)


@kernel
def beams_seen(rings, seen):  # type: ignore[no-untyped-def]
    """Number of different rings. rings (N,) float32, seen (256,) bool scratch."""
    seen[:] = False
    for i in range(rings.shape[0]):
        seen[np.uint8(rings[i])] = True
    number = 0
    for ring in range(256):
        number += seen[ring]
    return number
