"""Where a track is in the vehicle's frame and how it moves over ground, from range, azimuth, Doppler and ego motion.

An extended Kalman filter per track (Bar-Shalom, Li and Kirubarajan 2001, section 10.3): Cartesian position and velocity
over ground along the vehicle's axes of the moment. Doppler gives the radial part of the velocity at once; the part
across the line of sight is unknown at first and comes from how the azimuth changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.messages import Motion
from common.path import Mount, pose_after
from services.radar_pi.config import PathAlarmConfig, TrackingConfig

_AHEAD = np.cos(0.6)  # farther to the side it comes or goes along the line of sight
_UNKNOWN_AZIMUTH_RAD = 0.7  # half of the field of view: a radar with one receiver knows no more


@dataclass
class OverGround:
    """The filter's state: position and velocity (4,), covariance (4, 4)."""

    state: np.ndarray
    covariance: np.ndarray


class GroundFilter:
    """Starts and carries on the state of every track. ``measured`` is range, velocity and, where known, azimuth."""

    def __init__(self, mount: Mount, tracking: TrackingConfig, config: PathAlarmConfig) -> None:
        self._place = np.array([mount.x_m, mount.y_m])
        self._yaw_rad = mount.yaw_rad
        self._sigmas = np.array([tracking.sigma_range_m, tracking.sigma_velocity_mps, tracking.sigma_azimuth_rad])
        self._moving_mps = tracking.moving_mps
        self._config = config

    def start(self, measured: np.ndarray, motion: Motion) -> OverGround:
        """The state after a track's first measurement."""
        known = len(measured) > 2
        azimuth_rad = self._yaw_rad + (float(measured[2]) if known else 0.0)
        sight = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad)])
        across = np.array([-sight[1], sight[0]])
        radial_mps = float(measured[1]) + float(self._own_mps(motion) @ sight)
        moves = abs(radial_mps) >= self._moving_mps
        azimuth_sigma = self._sigmas[2] if known else _UNKNOWN_AZIMUTH_RAD
        along, beside = np.outer(sight, sight), np.outer(across, across)
        covariance = np.zeros((4, 4))
        covariance[:2, :2] = self._sigmas[0] ** 2 * along + (measured[0] * azimuth_sigma) ** 2 * beside
        sideways_mps = self._config.sideways_mps if moves else self._moving_mps
        covariance[2:, 2:] = self._sigmas[1] ** 2 * along + sideways_mps**2 * beside
        velocity = self._first_guess(radial_mps, sight) if moves else np.zeros(2)
        return OverGround(np.concatenate([self._place + measured[0] * sight, velocity]), covariance)

    def _first_guess(self, radial_mps: float, sight: np.ndarray) -> np.ndarray:
        """Ahead of us: along our way, until its direction says otherwise. Traffic beside us does not come at us."""
        return np.array([radial_mps / sight[0], 0.0]) if sight[0] > _AHEAD else radial_mps * sight

    def predict(self, before: OverGround, motion: Motion, dt_s: float) -> OverGround:
        """Carried on by its own velocity, and seen from where the vehicle is by then."""
        (turned,), place = pose_after(motion, np.array([dt_s]))
        cos, sin = np.cos(turned), np.sin(turned)
        back = np.array([[cos, sin], [-sin, cos]])
        F = np.zeros((4, 4))
        F[:2, :2] = F[2:, 2:] = back
        F[:2, 2:] = dt_s * back
        kick = self._config.acceleration_mps2**2
        Q = np.zeros((4, 4))
        Q[:2, :2] = np.eye(2) * kick * dt_s**4 / 4
        Q[:2, 2:] = Q[2:, :2] = np.eye(2) * kick * dt_s**3 / 2
        Q[2:, 2:] = np.eye(2) * kick * dt_s**2
        state = F @ before.state
        state[:2] -= back @ place[:, 0]
        return OverGround(state, F @ before.covariance @ F.T + Q)

    def correct(self, before: OverGround, measured: np.ndarray, motion: Motion) -> OverGround:
        """After one more measurement of the track."""
        offset = before.state[:2] - self._place
        range_m = max(float(np.hypot(*offset)), 1e-3)
        sight = offset / range_m
        across = np.array([-sight[1], sight[0]])
        relative = before.state[2:] - self._own_mps(motion)
        H = np.zeros((len(measured), 4))
        H[0, :2] = sight
        H[1, :2], H[1, 2:] = (relative @ across) / range_m * across, sight
        expected = [range_m, float(relative @ sight)]
        if len(measured) > 2:
            H[2, :2] = across / range_m
            expected.append(float(np.arctan2(sight[1], sight[0])) - self._yaw_rad)
        residual = measured - expected
        S = H @ before.covariance @ H.T + np.diag(self._sigmas[: len(measured)] ** 2)
        gain = np.linalg.solve(S, H @ before.covariance).T
        covariance = (np.eye(4) - gain @ H) @ before.covariance
        return OverGround(before.state + gain @ residual, (covariance + covariance.T) / 2)

    def _own_mps(self, motion: Motion) -> np.ndarray:
        """The radar's own velocity over ground, vehicle's axes."""
        x, y = self._place
        return np.array([motion.speed_mps - motion.yaw_rate_radps * y, motion.yaw_rate_radps * x])
