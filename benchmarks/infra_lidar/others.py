"""What other people's programs take on the same frames: Patchwork++ for the ground, DBSCAN for the clusters.

Both get what they need and no more: Patchwork++ the raw points of a frame (it finds its own ground), DBSCAN the
obstacle points that our segmentation leaves, seen from above (x, y), with the cell size of our grid as its radius.
Processor time of one thread, median over the frames.
"""

from __future__ import annotations

from collections.abc import Callable
from time import thread_time

import numpy as np
from sklearn.cluster import DBSCAN

from benchmarks.infra_lidar.frames import Frame

EPS_M, MIN_POINTS = 0.5, 10
SENSOR_HEIGHT_M = 5.0


def print_others(frames: list[Frame], obstacles: Callable[[Frame], np.ndarray]) -> None:
    """One line each. obstacles: (M, 3+) float32 points of a frame that are no ground, level frame."""
    print("\nothers on the same frames, processor ms of one thread:")
    ground_ms = patchwork_ms(frames)
    print(f"  Patchwork++, ground alone   {'not installed' if ground_ms is None else f'{ground_ms:7.2f}'}")
    rest = [obstacles(frame) for frame in frames]
    cluster_ms = median_ms([lambda xyz=xyz: dbscan(xyz) for xyz in rest])
    print(f"  scikit-learn's DBSCAN, {len(rest[0])} obstacle points   {cluster_ms:7.2f}")


def dbscan(points: np.ndarray) -> np.ndarray:
    """(M,) int labels of points (M, 3+), seen from above."""
    labels: np.ndarray = DBSCAN(eps=EPS_M, min_samples=MIN_POINTS, n_jobs=1).fit_predict(points[:, :2])
    return labels


def patchwork_ms(frames: list[Frame]) -> float | None:
    """Milliseconds of Patchwork++ with its default parameters; None where it is not installed."""
    try:
        import pypatchworkpp
    except ImportError:
        return None
    parameters = pypatchworkpp.Parameters()
    parameters.sensor_height = SENSOR_HEIGHT_M
    parameters.verbose = False
    estimator = pypatchworkpp.patchworkpp(parameters)
    return median_ms([lambda frame=frame: estimator.estimateGround(frame.points[:, :4]) for frame in frames])


def median_ms(calls: list[Callable[[], object]]) -> float:
    """Median of the calls' times; the first call is repeated, since it pays for what is loaded once."""
    calls[0]()
    spent = []
    for call in calls:
        t = thread_time()
        call()
        spent.append((thread_time() - t) * 1e3)
    return float(np.median(spent))
