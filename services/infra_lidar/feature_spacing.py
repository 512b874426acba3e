"""How evenly the points of clusters are spaced: the one costly feature, for the clusters that are asked for."""

from __future__ import annotations

import numpy as np

from services.infra_lidar.buffers import Buffers
from services.infra_lidar.feature_kernels import centred
from services.infra_lidar.feature_neighbours import room_for, spacing
from services.infra_lidar.jit import kernel
from services.infra_lidar.vectors import LANES


def cluster_spacing(
    planar: np.ndarray, offsets: np.ndarray, which: np.ndarray, nearest: bool, buffers: Buffers
) -> tuple[np.ndarray, np.ndarray]:
    """Of the J clusters ``which`` of the points ``planar`` (3, M) float32: deviation of the mean distance to the five
    nearest points, and median distance to the nearest (0 without ``nearest``), both (J,) float32, metres."""
    deviation_m, nearest_m = np.zeros((2, len(which)), np.float32)
    if len(which):
        largest = int((offsets[which + 1] - offsets[which]).max())
        size, (room, cells), take = (largest // LANES + 2) * LANES, room_for(largest), buffers.take
        scratch, work = take("cluster", 3 * size, np.float32), take("work", 6 * room, np.float32)
        _each(
            planar, offsets, which, scratch.reshape(3, size), work.reshape(6, room), take("start", cells, np.int32),
            nearest, deviation_m, nearest_m,
        )  # fmt: skip
    return deviation_m, nearest_m


@kernel
def _each(
    planar: np.ndarray, offsets: np.ndarray, which: np.ndarray, scratch: np.ndarray, work: np.ndarray,
    start: np.ndarray, nearest: bool, deviation_m: np.ndarray, nearest_m: np.ndarray,
) -> None:  # fmt: skip
    for j in range(len(which)):
        first, last = offsets[which[j]], offsets[which[j] + 1]
        for axis in range(3):
            centred(planar[axis, first:last], scratch[axis])
        deviation_m[j], nearest_m[j] = spacing(scratch, last - first, work, start, nearest)
