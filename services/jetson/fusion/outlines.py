"""When do two moving outlines touch? Oriented boxes against the vehicle's own, along the way that each of them takes.

The separating axis theorem (Gottschalk, Lin and Manocha 1996) swept over time: two boxes are apart as long as their
shadows on one of four axes are. Between two steps every shadow moves linearly, so each axis gives the span in which the
shadows overlap, and the boxes touch in what all spans have in common. The vehicle keeps its speed and yaw rate, so it
drives an arc; everything else keeps its velocity and heading. Pure; frame: the vehicle's of now, x forward, y left.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from common.message_types import Motion
from common.path import pose_after

STEP_S = 0.1


class Boxes(NamedTuple):
    """N oriented boxes that move, in the vehicle's frame of now."""

    centre_m: np.ndarray  # (N, 2)
    velocity_mps: np.ndarray  # (N, 2) over ground
    heading_rad: np.ndarray  # (N,) of the longer side
    half_m: np.ndarray  # (N, 2) half length, half width
    covariance: np.ndarray  # (N, 4, 4) of centre and velocity


class Outline(NamedTuple):
    """The vehicle from above, from its origin, and how it moves."""

    front_m: float
    rear_m: float
    half_width_m: float
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0

    def pose_after(self, t_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heading (K,) and place (K, 2) of the origin after so many seconds, on the arc that it drives."""
        turned, place = pose_after(Motion(self.speed_mps, self.yaw_rate_radps), t_s)
        return turned, place.T


def time_to_touch(boxes: Boxes, own: Outline, horizon_s: float, sigmas: float) -> np.ndarray:
    """(N,) seconds until each box touches the vehicle's outline; 0 = it does, inf = not within the horizon.

    The outline is widened by ``sigmas`` of the box's uncertainty across its relative motion; how far along it a box is
    does not move the moment of contact.
    """
    t_s = np.arange(0.0, horizon_s + STEP_S, STEP_S)
    turned, place = own.pose_after(t_s)
    # 1. every box at every step, from the vehicle as it will be then: (K, N)
    cos, sin = np.cos(turned)[:, None], np.sin(turned)[:, None]
    away = boxes.centre_m + t_s[:, None, None] * boxes.velocity_mps - place[:, None, :]
    x = cos * away[..., 0] + sin * away[..., 1] - (own.front_m - own.rear_m) / 2
    y = cos * away[..., 1] - sin * away[..., 0]
    heading = boxes.heading_rad - turned[:, None]
    # 2. the distance between the shadows on each axis, from both sides: positive = apart, (K, N, 8)
    apart = _shadows(x, y, heading, boxes.half_m, own)
    apart -= sigmas * _spread(boxes, own, t_s, turned, heading)
    # 3. the first moment at which none is apart
    return _first_common(apart, t_s, horizon_s)


def _axes(heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four directions (K, N, 4): the vehicle's x and y, then along and across the box."""
    one, nought = np.ones_like(heading), np.zeros_like(heading)
    cos, sin = np.cos(heading), np.sin(heading)
    return np.stack([one, nought, cos, -sin], axis=-1), np.stack([nought, one, sin, cos], axis=-1)


def _shadows(x: np.ndarray, y: np.ndarray, heading: np.ndarray, half_m: np.ndarray, own: Outline) -> np.ndarray:
    axis_x, axis_y = _axes(heading)
    along = axis_x * x[..., None] + axis_y * y[..., None]
    cos, sin = np.cos(heading)[..., None], np.sin(heading)[..., None]
    length, width = half_m[:, 0, None], half_m[:, 1, None]
    own_reach = (own.front_m + own.rear_m) / 2 * np.abs(axis_x) + own.half_width_m * np.abs(axis_y)
    reach = length * np.abs(axis_x * cos + axis_y * sin) + width * np.abs(axis_y * cos - axis_x * sin)
    return np.concatenate([along - own_reach - reach, -along - own_reach - reach], axis=-1)


def _spread(boxes: Boxes, own: Outline, t_s: np.ndarray, turned: np.ndarray, heading: np.ndarray) -> np.ndarray:
    """(K, N, 8) standard deviation across the relative motion, seen along each axis."""
    relative = boxes.velocity_mps - np.array([own.speed_mps, 0.0])
    speed = np.maximum(np.linalg.norm(relative, axis=1), 1e-9)
    across = np.column_stack([-relative[:, 1], relative[:, 0]]) / speed[:, None]
    P, t = boxes.covariance, t_s[:, None]
    place, both, velocity = (
        np.einsum("ni,nij,nj->n", across, block, across)
        for block in (P[:, :2, :2], P[:, :2, 2:] + P[:, 2:, :2], P[:, 2:, 2:])
    )
    sigma_m = np.sqrt(np.maximum(place + t * both + t**2 * velocity, 0.0))
    axis_x, axis_y = _axes(heading)
    cos, sin = np.cos(turned)[:, None, None], np.sin(turned)[:, None, None]
    across_x, across_y = across[:, 0, None], across[:, 1, None]
    share = np.abs(axis_x * (cos * across_x + sin * across_y) + axis_y * (cos * across_y - sin * across_x))
    seen = share * sigma_m[..., None]
    return np.concatenate([seen, seen], axis=-1)


def _first_common(apart: np.ndarray, t_s: np.ndarray, horizon_s: float) -> np.ndarray:
    """(N,) the first moment at which all of (K, N, 8) linearly joined values are at most 0."""
    touching = (apart[0] <= 0.0).all(axis=-1)
    before, after = apart[:-1], apart[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = before / (before - after)
    begins = np.where(before <= 0.0, 0.0, np.where(after <= 0.0, crossing, np.inf)).max(axis=-1)
    ends = np.where(after <= 0.0, 1.0, np.where(before <= 0.0, crossing, -np.inf)).min(axis=-1)
    moment_s = np.where(begins <= ends, t_s[:-1, None] + STEP_S * begins, np.inf)
    first_s = moment_s.min(axis=0, initial=np.inf)
    return np.where(touching, 0.0, np.where(first_s <= horizon_s, first_s, np.inf))
