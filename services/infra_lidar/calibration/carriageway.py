"""Where the carriageway is: the cross section of the street, its kerbs and the crown line.

Near the pole a street is a profile drawn along a line: z = f(u) + b v + c v^2, u across and v along it. Its direction
is the one in which f, free in every narrow strip, leaves least (additive model, Hastie and Tibshirani 1990, robust by
Tukey's weight). f is then cut into straight pieces by dynamic programming (segmented least squares, Bellman and Roth
1969). A step up between two pieces is a kerb; pieces between kerbs are the carriageway; of a carriageway with a crown
line the piece nearest to the foot counts, because that is the plane the road has there.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from services.infra_lidar.jit import kernel

COARSE_M, FINE_M = 0.4, 0.25  # strips for the direction and for the profile
SEARCHED_POINTS = 3000
TURNS_DEG = ((6.0, 15), (1.5, 4), (0.4, 4))  # step and number of steps to either side
MISFIT_M = 0.05  # half width of Tukey's weight
FIT_SCALES = (6.0, 3.0, 1.5, 1.0, 1.0)  # of that width, one fit after the other
STRIP_POINTS, STRIP_ERROR_M, PIECE_COST = 4, 0.006, 14.0  # for the cut; cost in squared errors
MIN_PIECE_M = 0.7
KERB_M, VALLEY, VALLEY_M = 0.04, 0.03, 0.025  # least step of a kerb; VALLEY_M where the slope rises by VALLEY: a gutter
CONVEX_M, CONCAVE_M = 0.9, 0.35  # lines of two pieces that cross this near to their ends: no step; farther at a crown
STEEP, STEEP_M = 0.07, 2.0  # change of slope at the foot of a piece shorter than that: it is the face of a kerb
CROWN, CROWN_FOOT_M = 0.015, 2.5  # smallest change of slope that is a crown line; so near, the foot stands on it
MIN_LANE_M = 1.2  # wider than a gutter
EDGE_M = 0.2  # left out beside the ends of a piece


@dataclass(frozen=True)
class Piece:
    """A straight part of the profile: z = level + slope u from ``start_m`` to ``end_m``."""

    start_m: float
    end_m: float
    level_m: float
    slope: float

    def at(self, u_m: float) -> float:
        """Its height, also beyond its ends."""
        return self.level_m + self.slope * u_m


def find_carriageway(local: np.ndarray) -> tuple[np.ndarray | None, float]:
    """Which points (N, 3) lie on the plane of the carriageway at the foot (0, 0), in a roughly level frame.

    Returns (N,) bool, or None where the profile shows neither kerb nor crown line: then all ground is road. And Tukey's
    loss of the profile, 0 to 1: from about 0.4 on the ground is no straight street (a junction).
    """
    low = _lowest(local)
    direction_rad = _direction(local[low])
    across, along = _turned(local, direction_rad)
    strip, height_m, weight, loss = _profile(across[low], along[low], local[low, 2], FINE_M)
    piece = choose(cut(strip, height_m, weight))
    if piece is None:
        return None, loss
    return low & (across > piece.start_m + EDGE_M) & (across < piece.end_m - EDGE_M), loss


def _lowest(local: np.ndarray) -> np.ndarray:
    """(N,) bool: not more than a kerb and a slope above the lowest points of its square: no cars, no people."""
    cell = np.floor(local[:, :2] / 1.5).astype(np.int64) @ np.array([1, 4096])
    _, number = np.unique(cell, return_inverse=True)
    floor = np.full(number.max() + 1 if len(number) else 0, np.inf)
    np.minimum.at(floor, number, local[:, 2])
    return np.asarray(local[:, 2] < floor[number] + 0.25)


def _turned(local: np.ndarray, direction_rad: float) -> tuple[np.ndarray, np.ndarray]:
    """Metres across and along a street of that direction."""
    c, s = np.cos(direction_rad), np.sin(direction_rad)
    return local[:, 0] * c + local[:, 1] * s, local[:, 1] * c - local[:, 0] * s


def _direction(local: np.ndarray) -> float:
    """Direction of the axis across the street, radians from x: where the additive model leaves least."""
    sample = local[:: max(1, len(local) // SEARCHED_POINTS)]
    best_deg = 0.0
    for step_deg, count in TURNS_DEG:
        tried = best_deg + step_deg * np.arange(-count, count + 1)
        best_deg = min(tried.tolist(), key=lambda turn: _misfit(sample, float(np.radians(turn))))
    return float(np.radians(best_deg))


def _misfit(local: np.ndarray, direction_rad: float) -> float:
    return _profile(*_turned(local, direction_rad), np.ascontiguousarray(local[:, 2]), COARSE_M)[3]


@kernel
def _profile(
    across: np.ndarray, along: np.ndarray, z: np.ndarray, strip_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Middles (S,), heights (S,) and sums of weights (S,) of the strips seen, and Tukey's loss, 0 to 1.

    across, along, z: (N,) float64 m, places of points across and along the street, and their heights. strip_m: width.
    """
    strip = np.floor(across / strip_m).astype(np.int64)
    first = strip.min()
    strip -= first
    near = 1.0 / (1.0 + (across**2 + along**2) / 12.0**2)
    weight, slope, loss = near * (np.abs(z) < 0.5), np.zeros(2), 0.0
    mean = np.zeros((strip.max() + 1, 4))
    for scale_m in FIT_SCALES:
        mean = _strip_means(strip, along, z, weight, len(mean))
        slope = _common_slope(strip, along, z, weight, mean)
        loss = 0.0
        for i in range(len(z)):
            _, level, linear, square = mean[strip[i]]
            rest = z[i] - level - slope[0] * (along[i] - linear) - slope[1] * (along[i] ** 2 - square)
            fit = max(0.0, 1.0 - (rest / (scale_m * MISFIT_M)) ** 2)
            weight[i] = near[i] * fit**2
            loss += near[i] * (1.0 - fit**3)
    points, support = np.zeros(len(mean), np.int64), np.zeros(len(mean))
    for i in range(len(z)):
        points[strip[i]] += weight[i] > 0.0
        support[strip[i]] += weight[i] / near[i]
    seen = points >= STRIP_POINTS
    height_m = mean[:, 1] - slope[0] * mean[:, 2] - slope[1] * mean[:, 3]
    middle = (np.arange(len(mean)) + first + 0.5) * strip_m
    return middle[seen], height_m[seen], support[seen], loss / near.sum()


@kernel
def _strip_means(strip: np.ndarray, along: np.ndarray, z: np.ndarray, weight: np.ndarray, strips: int) -> np.ndarray:
    """(S, 4) of each strip: sum of the weights, and weighted means of z, ``along`` and its square."""
    mean = np.zeros((strips, 4))
    for i in range(len(z)):
        mean[strip[i], 0] += weight[i]
        mean[strip[i], 1] += weight[i] * z[i]
        mean[strip[i], 2] += weight[i] * along[i]
        mean[strip[i], 3] += weight[i] * along[i] ** 2
    for row in mean:
        row[0] += 1e-12
        row[1:] /= row[0]
    return mean


@kernel
def _common_slope(
    strip: np.ndarray, along: np.ndarray, z: np.ndarray, weight: np.ndarray, mean: np.ndarray
) -> np.ndarray:
    """(2,) b and c of b v + c v^2, the same in all strips: least squares about the strips' means (S, 4)."""
    aa, ab, bb, az, bz = 1e-6, 0.0, 1e-6, 0.0, 0.0
    for i in range(len(z)):
        _, level, linear, square = mean[strip[i]]
        a, b, rise = along[i] - linear, along[i] ** 2 - square, z[i] - level
        aa, ab, bb = aa + weight[i] * a * a, ab + weight[i] * a * b, bb + weight[i] * b * b
        az, bz = az + weight[i] * a * rise, bz + weight[i] * b * rise
    return np.array([az * bb - bz * ab, bz * aa - az * ab]) / (aa * bb - ab * ab)


def cut(u: np.ndarray, z: np.ndarray, weight: np.ndarray) -> list[Piece]:
    """The straight pieces of a profile: heights z (S,) at u (S,) with the number of points behind each."""
    variance = STRIP_ERROR_M**2 + 0.015**2 / np.maximum(weight, 1.0)
    cost, level, slope = _lines(u, z, 1.0 / variance)
    best, start = np.zeros(len(u) + 1), np.zeros(len(u) + 1, int)
    for end in range(1, len(u) + 1):
        total = best[:end] + cost[:end, end - 1] + PIECE_COST
        start[end] = int(np.argmin(total))
        best[end] = total[start[end]]
    pieces, end = [], len(u)
    while end > 0:
        i = start[end]
        half = 0.5 * FINE_M
        pieces.append(Piece(u[i] - half, u[end - 1] + half, level[i, end - 1], slope[i, end - 1]))
        end = i
    return pieces[::-1]


def _lines(u: np.ndarray, z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squared error, level and slope (S, S) of the line through strips i to j, from running sums."""

    def between(value: np.ndarray) -> np.ndarray:
        running = np.concatenate([[0.0], np.cumsum(value)])
        return np.asarray(running[None, 1:] - running[:-1, None])

    s, su, sz, suu, suz, szz = (between(v) for v in (w, w * u, w * z, w * u * u, w * u * z, w * z * z))
    s = np.maximum(s, 1e-12)
    spread = np.maximum(suu - su * su / s, 0.0)
    slope = np.where(spread > 1e-6 * s, (suz - su * sz / s) / np.maximum(spread, 1e-9), 0.0)
    level = (sz - slope * su) / s
    return np.maximum(szz - level * sz - slope * suz, 0.0), level, slope


def choose(pieces: list[Piece]) -> Piece | None:
    """The piece of the carriageway at the foot, or None where there is neither kerb nor crown line."""
    pieces = _without_faces([piece for piece in pieces if _width_m(piece) >= MIN_PIECE_M])
    steps = [_step_m(a, b) for a, b in pairwise(pieces)]
    runs, run = [], [0]
    for k, step_m in enumerate(steps):
        if step_m == 0.0:
            run.append(k + 1)
        else:
            runs.append(run)
            run = [k + 1]
    runs = [run for run in [*runs, run] if pieces]
    roads = [run for run in runs if _between_kerbs(run, steps)]
    lanes = [pieces[k] for run in roads or runs for k in run if _width_m(pieces[k]) >= MIN_LANE_M]
    if not lanes:
        return None
    nearest = min(lanes, key=_distance_m)
    crowns = [pair for pair in pairwise(lanes) if nearest in pair and pair[0].slope - pair[1].slope > CROWN]
    on_crown = any(a.end_m <= CROWN_FOOT_M and b.start_m >= -CROWN_FOOT_M for a, b in crowns)
    return nearest if (roads or crowns) and not on_crown else None  # on the crown line: the plane of both halves


def _step_m(low: Piece, high: Piece) -> float:
    """How much the profile rises from one piece to the next, in the middle between them; 0 at a kink."""
    middle = 0.5 * (low.end_m + high.start_m)
    step_m = high.at(middle) - low.at(middle)
    bend, reach_m = high.slope - low.slope, 0.5 * (high.start_m - low.end_m)
    kink_m = CONCAVE_M * bend if bend > 0.0 else -(CONVEX_M + reach_m) * bend
    return step_m if abs(step_m) > kink_m and abs(step_m) > (KERB_M if bend < VALLEY else VALLEY_M) else 0.0


def _without_faces(pieces: list[Piece]) -> list[Piece]:
    """Without short pieces that rise or fall steeply towards the bottom of a valley: kerbs that the strips smear."""
    slopes = np.array([piece.slope for piece in pieces])
    bend = np.maximum(0.0, np.diff(slopes, prepend=slopes[:1], append=slopes[-1:]))
    away = np.abs(slopes - np.median(slopes)) if len(pieces) else slopes
    face = np.array([_width_m(piece) < STEEP_M for piece in pieces], bool) & (away > 0.5 * STEEP)
    face &= np.maximum(bend[:-1], bend[1:]) > STEEP
    return [piece for piece, smeared in zip(pieces, face, strict=True) if not smeared]


def _width_m(piece: Piece) -> float:
    return piece.end_m - piece.start_m


def _between_kerbs(run: list[int], steps: list[float]) -> bool:
    """Whether a kerb rises at one end of a run of pieces or both, and none falls."""
    left = -steps[run[0] - 1] if run[0] > 0 else 0.0
    right = steps[run[-1]] if run[-1] < len(steps) else 0.0
    return left + right > 0.0 and min(left, right) >= 0.0


def _distance_m(piece: Piece) -> float:
    return max(piece.start_m, -piece.end_m, 0.0)
