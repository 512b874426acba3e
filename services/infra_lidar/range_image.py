"""A turn as the sensor measures it: ranges. Points are made of them where somebody needs points.

Where the scene is learned, its range alone tells of most returns that they were always there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from services.infra_lidar.kernels_image import project, project_returns


@dataclass(frozen=True, eq=False)
class RangeImage:
    """R rows of W ranges: what a bank of W beams has measured at one heading of the head.

    range_m: (R, W) float32, 0 = no return. intensity: (R, W) uint8. cos, sin: (R,) float32 of the heading, the angle
    about z by which the head had turned in the sensor frame. bank: (R,) uint8, bank b holds the beams b W to b W + W.
    beams: (7, B) float32, of each beam in the frame that turns with the head: its direction x, y, z, the point x, y, z
    (m) from which its range is measured, and its ring, 0 = lowest.
    """

    range_m: np.ndarray
    intensity: np.ndarray
    cos: np.ndarray
    sin: np.ndarray
    bank: np.ndarray
    beams: np.ndarray

    def __len__(self) -> int:
        """How many ranges there are, those without a return, too."""
        return self.range_m.size

    @property
    def returns(self) -> int:
        """How many of them are returns."""
        return int(np.count_nonzero(self.range_m))

    @cached_property
    def points(self) -> np.ndarray:
        """(R W, 5) float32 x, y, z (m, sensor frame), intensity, ring; (0, 0, 0, 0, 0) where there is no return."""
        points = np.empty((self.range_m.size, 5), np.float32)
        project(self.range_m, self.intensity, self.cos, self.sin, self.bank, self.beams, points)
        return points

    def sample(self, every: int) -> np.ndarray:
        """(M, 5) the returns of every so many rows, as points."""
        rows, width = self.range_m.shape
        points = np.empty((-(-rows // every) * width, 5), np.float32)
        m = project_returns(
            self.range_m, self.intensity, self.cos, self.sin, self.bank, self.beams, every, points
        )  # fmt: skip
        return points[:m]


Returns: TypeAlias = np.ndarray | RangeImage
"""A turn: (N, 3+) float32 points x, y, z (m, sensor frame), intensity, ring; or as a range image."""


def points_of(returns: Returns) -> np.ndarray:
    """(N, 3+) float32, one for each return or each place of the image."""
    return returns.points if isinstance(returns, RangeImage) else returns


def count_of(returns: Returns) -> int:
    """How many returns there are; of points, all count."""
    return returns.returns if isinstance(returns, RangeImage) else len(returns)


def sample_of(returns: Returns, every: int) -> np.ndarray:
    """(M, 3+) float32: points of every so many returns, or rows of the image."""
    return returns.sample(every) if isinstance(returns, RangeImage) else np.ascontiguousarray(returns[::every])
