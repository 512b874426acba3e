"""The swept separating axes against corners, edges and small steps."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from services.jetson.fusion.outlines import Boxes, Outline, time_to_touch

HORIZON_S = 3.0
Box = tuple[float, float, float, float, float, float, float]  # x, y, vx, vy, heading, length, width


def corners(x: float, y: float, heading: float, front: float, rear: float, half_width: float) -> np.ndarray:
    """(4, 2) in order."""
    own = np.array([[front, half_width], [-rear, half_width], [-rear, -half_width], [front, -half_width]])
    turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
    return own @ turn.T + [x, y]


def overlap(one: np.ndarray, other: np.ndarray) -> bool:
    """Plain: a corner of one lies in the other, or two edges cross."""
    return (
        any(inside(corner, other) for corner in one)
        or any(inside(corner, one) for corner in other)
        or any(cross(*edge, *counter) for edge in edges(one) for counter in edges(other))
    )


def edges(polygon: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(zip(polygon, np.roll(polygon, -1, axis=0), strict=True))


def side(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def inside(point: np.ndarray, polygon: np.ndarray) -> bool:
    return all(side(a, b, point) >= 0.0 for a, b in edges(polygon))


def cross(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> bool:
    return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0


def touch_by_small_steps(row: Box, own: Outline, step_s: float) -> float:
    x, y, vx, vy, heading, length, width = row
    for t in np.arange(0.0, HORIZON_S + step_s / 2, step_s):
        turned = own.yaw_rate_radps * t
        if abs(own.yaw_rate_radps) > 1e-9:
            radius = own.speed_mps / own.yaw_rate_radps
            place = (radius * math.sin(turned), radius * (1 - math.cos(turned)))
        else:
            place = (own.speed_mps * t, 0.0)
        us = corners(*place, turned, own.front_m, own.rear_m, own.half_width_m)
        them = corners(x + vx * t, y + vy * t, heading, length / 2, length / 2, width / 2)
        if overlap(us, them):
            return float(t)
    return math.inf


METRES = st.integers(-8000, 8000).map(lambda value: value / 1000)
SPEEDS = st.integers(-8000, 8000).map(lambda value: value / 1000)
SIDES = st.integers(200, 6000).map(lambda value: value / 1000)
ROWS = st.tuples(METRES, METRES, SPEEDS, SPEEDS, st.integers(-31, 31).map(lambda value: value / 10), SIDES, SIDES)


@settings(max_examples=30, deadline=None)
@given(ROWS, st.sampled_from([(0.0, 0.0), (2.0, 0.0), (-1.0, 0.0), (2.0, 0.6), (3.0, -0.4), (-1.0, 0.5)]))
def test_it_agrees_with_small_steps(row: Box, motion: tuple[float, float]) -> None:
    """To a step, and to a graze: a box smaller or larger by 2 cm brackets what the linear joints of an arc cost."""
    own = Outline(0.6, 0.3, 0.4, *motion)
    table = np.array([row])
    moving = Boxes(table[:, :2], table[:, 2:4], table[:, 4], table[:, 5:] / 2, np.zeros((1, 4, 4)))
    (swept_s,) = time_to_touch(moving, own, HORIZON_S, 0.0)
    smaller, larger = ((*row[:5], row[5] + grow, row[6] + grow) for grow in (-0.04, 0.04))
    step_s = 0.02
    early, late = touch_by_small_steps(larger, own, step_s), touch_by_small_steps(smaller, own, step_s)
    assert early - step_s - 1e-9 <= swept_s <= late + 1e-9
