"""Where somebody may stand unseen beside the way: behind a parked car, past the end of a wall.

Whoever steps out from there is seen too late for a fast vehicle, however good its sensors are. So it passes such a
place only as fast as it can brake to rest within ``rules.hidden_stop_s``; on the way there it may be faster by what its
brakes still take off. A speed limit by what is out of sight: Koschi and Althoff, Set-based prediction of traffic
participants considering occlusions and traffic rules, IEEE T-IV 2021; here with a fixed time instead of a model of who
may come. Pure.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from common.messages import Cover
from common.path import Path, PathConfig

CELL_M = 0.1  # along the way and across it
ROOM_M = 0.9  # a hidden place that begins farther from the vehicle's outline leaves time to see who comes
PERSON_M = 0.5  # nobody hides behind less, along the way or across it
_PERSON_CELLS = round(PERSON_M / CELL_M)
BEHIND_M = (0.1, 1.0)  # whoever hides stands close behind: the shadow of a post is wide only far behind it


def nearest_hidden_m(path: Path, covers: Collection[Cover | None], up_to_m: float) -> float | None:
    """How far ahead of the bumper the first place beside the way begins that could hide a person.

    Args:
        path: the way to drive.
        covers: of the sensors that are online; a view that ends at something (a sector shorter than the longest) hides
            what is behind. None = the sensor does not say.
        up_to_m: beyond this the way itself is not seen, and nothing is asked.

    Returns:
        Metres along the way, or None.
    """
    rows, first_m = int(up_to_m / CELL_M + 1e-9), math.inf
    if rows < _PERSON_CELLS:
        return None
    for cells in beside(path, rows):
        hidden = np.zeros(len(cells), bool)
        for cover in covers:
            if cover is not None and cover.standing:
                hidden |= hides(cover, cells)
        first_m = min(first_m, _first_place_m(hidden.reshape(rows, -1)))
    return None if math.isinf(first_m) else first_m


def pass_speed_mps(hidden_m: float, config: PathConfig, stop_s: float) -> float:
    """How fast the vehicle may be now to pass a hidden place ``hidden_m`` ahead at no more than its brakes stop within
    ``stop_s``: v with v * reaction + (v^2 - passing^2) / (2 * brake) = distance."""
    passing_mps = config.brake_mps2 * stop_s
    lost_mps = config.brake_mps2 * config.reaction_s
    now_mps = math.sqrt(lost_mps**2 + passing_mps**2 + 2.0 * config.brake_mps2 * hidden_m) - lost_mps
    return max(passing_mps, now_mps)


def shows_what_hides(cover: Cover | None) -> bool:
    """Whether a sensor measures where its view ends: sector by sector, not one reach for all of its cone."""
    return cover is not None and cover.standing and len(cover.far_m) > 1 and any(cover.far_m)


def hides(cover: Cover, cells: np.ndarray) -> np.ndarray:
    """(N,) bool: places (N, 2) in the vehicle's frame close behind something at which this sensor's view ends.

    It has to end there half a sector to either side too: a sector is as near as the nearest thing in it.
    """
    longest_m = max(cover.far_m, default=0.0)
    if cover.step_rad <= 0.0 or not any(0.0 < far_m < longest_m for far_m in cover.far_m):
        return np.zeros(len(cells), bool)
    x, y = cells[:, 0] - cover.x_m, cells[:, 1] - cover.y_m
    range_m, bearing_rad = np.hypot(x, y), np.arctan2(y, x)
    hidden = np.ones(len(cells), bool)
    for aside_rad in (-0.5 * cover.step_rad, 0.5 * cover.step_rad):
        far_m = cover_far_m(cover, bearing_rad + aside_rad)
        behind_m = range_m - far_m
        hidden &= (far_m > 0.0) & (far_m < longest_m) & (behind_m > BEHIND_M[0]) & (behind_m <= BEHIND_M[1])
    return hidden


def cover_far_m(cover: Cover, bearing_rad: np.ndarray) -> np.ndarray:
    """(N,) how far the sensor could have seen in each of these directions; 0 where it does not look."""
    far_m = np.array(cover.far_m)
    sector = np.floor((bearing_rad - cover.first_rad) / cover.step_rad + 1e-9).astype(np.int64)
    inside = (sector >= 0) & (sector < len(far_m))
    return np.asarray(np.where(inside, far_m[np.clip(sector, 0, len(far_m) - 1)], 0.0))


def beside(path: Path, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """(rows * K, 2) places in the vehicle's frame on the left and on the right of the way, from its edge outwards."""
    ahead = (np.arange(rows) + 0.5) * CELL_M
    aside = np.arange(CELL_M / 2, ROOM_M + PERSON_M, CELL_M)
    along, across = (grid.ravel() for grid in np.meshgrid(ahead, aside, indexing="ij"))
    return path.place(along, path.left_m + across), path.place(along, -path.right_m - across)


def _first_place_m(hidden: np.ndarray) -> float:
    """Where in (rows, K) the first run of rows begins that is as long and as wide as a person; inf = nowhere."""
    wide = hidden.sum(axis=1) >= _PERSON_CELLS
    long = np.lib.stride_tricks.sliding_window_view(wide, _PERSON_CELLS).all(axis=1)
    return float(np.argmax(long) * CELL_M) if long.any() else math.inf
