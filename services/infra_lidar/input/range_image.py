"""A revolution as the sensor measures it: ranges. Points are made of them only where a step needs points.

Once the scene is learned, the range alone shows of most returns that they belong to the fixed background.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from services.infra_lidar.jit import kernel

MOST_BEAMS = 128


@dataclass(frozen=True, eq=False)
class RangeImage:
    """R rows of W ranges: what a bank of W beams has measured at one heading of the head.

    range_m: (R, W) float32, 0 = no return. intensity: (R, W) uint8. cos, sin: (R,) float32 of the heading, the angle
    about z by which the head had turned in the sensor frame. bank: (R,) uint8, bank b holds the beams b W to b W + W;
    of W = 128, each bank has all beams, in another firing order. W divides 128.
    beams: (7, B) float32, for each beam in the frame that turns with the head: its direction x, y, z, the point x, y, z
    (m) from which its range is measured, and its ring, 0 = lowest.

    Raises:
        ValueError: rows of another width.
    """

    range_m: np.ndarray
    intensity: np.ndarray
    cos: np.ndarray
    sin: np.ndarray
    bank: np.ndarray
    beams: np.ndarray

    def __post_init__(self) -> None:
        width = self.range_m.shape[1]
        if not width or MOST_BEAMS % width:
            raise ValueError(f"range_m: rows of {width} ranges, expected a number that divides {MOST_BEAMS}")

    def __len__(self) -> int:
        """Number of ranges, including those without a return."""
        return self.range_m.size

    @property
    def arrays(self) -> RangeImageArrays:
        """All arrays, for kernels."""
        return RangeImageArrays(self.range_m, self.intensity, self.cos, self.sin, self.bank, self.beams)

    @property
    def returns(self) -> int:
        """Number of returns."""
        return int(np.count_nonzero(self.range_m))

    @cached_property
    def points(self) -> np.ndarray:
        """(R W, 5) float32 x, y, z (m, sensor frame), intensity, ring; zeros where there is no return."""
        return project(self.arrays)

    def sample(self, every: int) -> np.ndarray:
        """(M, 5) float32: the returns of each ``every``-th row as points."""
        return project_returns(self.arrays, every)


Returns: TypeAlias = np.ndarray | RangeImage
"""A revolution: (N, 3+) float32 points x, y, z (m, sensor frame), intensity, ring; or a range image."""


def points_of(returns: Returns) -> np.ndarray:
    """(N, 3+) float32, one point for each return, or for each range of an image."""
    return returns.points if isinstance(returns, RangeImage) else returns


def count_of(returns: Returns) -> int:
    """Number of returns; of points, all count."""
    return returns.returns if isinstance(returns, RangeImage) else len(returns)


def sample_of(returns: Returns, every: int) -> np.ndarray:
    """(M, 3+) float32: each ``every``-th point, or the returns of each ``every``-th row of an image."""
    return returns.sample(every) if isinstance(returns, RangeImage) else np.ascontiguousarray(returns[::every])


class RangeImageArrays(NamedTuple):
    """The arrays of a ``RangeImage``, described there."""

    range_m: np.ndarray
    intensity: np.ndarray
    cos: np.ndarray
    sin: np.ndarray
    bank: np.ndarray
    beams: np.ndarray


@kernel
def write_xyz(image: RangeImageArrays, row: int, i: int, point: np.ndarray) -> None:
    """Write x, y, z (m, sensor frame) of range ``i`` of ``row`` to point (3 or more,) float32."""
    r, beam, cos, sin = image.range_m[row, i], image.bank[row] * image.range_m.shape[1] + i, image.cos, image.sin
    x = r * image.beams[0, beam] + image.beams[3, beam]
    y = r * image.beams[1, beam] + image.beams[4, beam]
    point[0] = cos[row] * x - sin[row] * y
    point[1] = sin[row] * x + cos[row] * y
    point[2] = r * image.beams[2, beam] + image.beams[5, beam]


@kernel
def _write_point(image: RangeImageArrays, row: int, i: int, point: np.ndarray) -> None:
    """Write x, y, z (m, sensor frame), intensity and ring of range ``i`` of ``row`` to point (5,) float32."""
    write_xyz(image, row, i, point)
    point[3] = image.intensity[row, i]
    point[4] = image.beams[6, image.bank[row] * image.range_m.shape[1] + i]


@kernel
def project(image: RangeImageArrays) -> np.ndarray:
    """(R W, 5) float32: the point of each range, zeros where there is no return."""
    rows, width = image.range_m.shape
    points = np.zeros((rows * width, 5), np.float32)
    for row in range(rows):
        for i in range(width):
            if image.range_m[row, i] > 0.0:
                _write_point(image, row, i, points[row * width + i])
    return points


@kernel
def project_returns(image: RangeImageArrays, every: int) -> np.ndarray:
    """(M, 5) float32: the points of the returns of each ``every``-th row."""
    rows, width = image.range_m.shape
    points = np.empty(((rows + every - 1) // every * width, 5), np.float32)
    m = 0
    for row in range(0, rows, every):
        for i in range(width):
            if image.range_m[row, i] > 0.0:
                _write_point(image, row, i, points[m])
                m += 1
    return points[:m]
