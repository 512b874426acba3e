"""Whether numbers can be what they are said to be: metres from the sensor, intensities, rings. No I/O.

Nothing is guessed: what cannot be is refused with what was found.
"""

from __future__ import annotations

import numpy as np

from services.infra_lidar.input.pcd import FrameError

ENOUGH_POINTS = 10_000  # to tell how far half of them are
FARTHEST_MEDIAN_M = 400.0  # half of the points are farther: then these are no metres
FARTHEST_M = 1000.0  # beyond the range of every lidar here
FAR_SHARE = 0.001  # as many may be odd; they are left out
NEAREST_M = 0.1  # closer than lidars measure
NEAR_SHARE = 0.9  # as many may be closer: a frame in kilometres has more
MAX_INTENSITY = 65535
RINGS = 256


def in_metres(points: np.ndarray) -> np.ndarray:
    """The points that are finite and within ``FARTHEST_M``. Points at 0 0 0, "no return", stay.

    Raises:
        FrameError: there are none, or too many are too far away or too close to be metres from the sensor.
    """
    size_m = _largest_coordinate(points)
    finite = np.isfinite(size_m)
    if not finite.all():
        points, size_m = points[finite], size_m[finite]
    if not len(points):
        raise FrameError("no points")
    returned = np.flatnonzero(size_m)
    if not len(returned):
        raise FrameError(f"all {len(points)} points are 0 0 0: none is a return")
    _expect_near_median(points[returned[:: len(returned) // ENOUGH_POINTS | 1], :3])  # odd: of every beam
    near = np.count_nonzero(size_m[returned] < NEAREST_M)
    if near > NEAR_SHARE * len(returned):
        raise FrameError(
            f"{near} of {len(returned)} points lie within {NEAREST_M * 100:.0f} cm of the sensor: expected metres; are "
            f"these kilometres, or other numbers than float32?"
        )
    far = size_m > FARTHEST_M
    count = np.count_nonzero(far)
    if count > max(1.0, FAR_SHARE * len(points)):
        raise FrameError(
            f"{count} of {len(points)} points lie beyond {FARTHEST_M:.0f} m, up to {size_m.max():.3g}: expected metres"
        )
    return points[~far] if count else points


def _largest_coordinate(points: np.ndarray) -> np.ndarray:
    """(N,) the largest of |x|, |y| and |z|; not finite where one of them is not."""
    x, y, z = (np.abs(points[:, k]) for k in range(3))
    return np.maximum(np.maximum(x, y), z)


def _expect_near_median(sample: np.ndarray) -> None:
    xyz = sample.astype(float)
    median_m = _half_within_m(xyz)
    if median_m <= FARTHEST_MEDIAN_M:
        return
    if 0.0 < _half_within_m(xyz - np.median(xyz, axis=0)) < min(FARTHEST_MEDIAN_M, 0.1 * median_m):
        raise FrameError(
            f"the points lie about {median_m:.0f} m away: coordinates of a map? The sensor has to be the origin"
        )
    raise FrameError(f"half of the points are farther than {median_m:.6g}: expected metres; are these millimetres?")


def _half_within_m(xyz: np.ndarray) -> float:
    """How far from the origin half of the points lie."""
    return float(np.median(np.linalg.norm(xyz, axis=1)))


def wrong_intensity(values: np.ndarray) -> str:
    """What was expected of intensities and found instead; "" = nothing speaks against them."""
    wrong = values[~((values >= 0) & (values <= MAX_INTENSITY))]
    return f"expected 0 to {MAX_INTENSITY}, found {wrong[0]:g}" if len(wrong) else ""


def wrong_ring(values: np.ndarray) -> str:
    """What was expected of rings and found instead; "" = nothing speaks against them."""
    wrong = values[~((values >= 0) & (values < RINGS) & (values == np.floor(values)))]
    return f"whole numbers from 0 to {RINGS - 1} are expected, found {wrong[0]:g}" if len(wrong) else ""


def with_plausible_columns(points: np.ndarray) -> np.ndarray:
    """(N, 3..5) points as they are.

    Raises:
        FrameError: the fourth column cannot be intensities, or the fifth no rings.
    """
    for name, column, wrong in (("intensity", 3, wrong_intensity), ("ring", 4, wrong_ring)):
        found = wrong(points[:, column]) if points.shape[1] > column else ""
        if found:
            raise FrameError(f"{name}: {found}; leave it out, or give it another name")
    return points
