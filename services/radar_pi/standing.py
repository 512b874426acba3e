"""Does a track stand, and if so, how far off the vehicle's line must it be?

From a vehicle at speed v a standing echo at bearing b closes in with v cos(b) (Doppler beam sharpening; Richards,
Fundamentals of Radar Signal Processing, section 8.2). With z the squared share of the vehicle's speed, R the range, y
the distance from the line of travel and s the error of the speedometer: z = s^2 - s^2 y^2 / R^2, a line over 1 / R^2.
Its two parameters are estimated per track by recursive least squares; the speedometer's error is shared by all tracks,
so that whatever is passed calibrates it, and a wrong one cannot push what stands ahead off the way.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from common.messages import Motion
from services.radar_pi.config import PathAlarmConfig, RadarConfig
from services.radar_pi.detection import Echo

_WIDE_M2 = 16.0  # standard deviation of y^2 before anything is known
_MISFIT = 9.0  # normalised innovation squared: 3 sigma
_SURGES = 3  # so many times faster than a standing thing would: it moves
_SMOOTHING = 0.3  # of a track's newest height
_MEMORY_S = 60.0  # of the speedometer's calibration: tyres and loads change slowly
_SURE_SIDE_SIGMAS = 2.0  # an azimuth that many of its standard deviations off decides the side
_TURNING_RADPS = 0.1  # the line of travel turns: each frame stands for itself


class SpeedScale:
    """The squared error of the speedometer, as all tracks have shown it: mean and variance."""

    def __init__(self, config: PathAlarmConfig) -> None:
        self._prior = 1.0 / (2.0 * config.speed_tolerance) ** 2
        self._precision, self._weighted = self._prior, self._prior

    @property
    def mean(self) -> float:
        """Estimate of the squared scale between true speed and speedometer."""
        return self._weighted / self._precision

    @property
    def variance(self) -> float:
        """Variance of that estimate."""
        return 1.0 / self._precision

    def age(self, dt_s: float) -> None:
        """Forget slowly what tracks have shown."""
        kept = float(np.exp(-dt_s / _MEMORY_S))
        self._precision = self._prior + kept * (self._precision - self._prior)
        self._weighted = self._prior + kept * (self._weighted - self._prior)

    def learn(self, precision: float, weighted: float) -> None:
        """What one measurement of one track adds; negative to take it back."""
        self._precision = max(self._precision + precision, self._prior)
        self._weighted += weighted


class Standing:
    """One track. ``has_moved`` tells that its speed cannot be that of a standing thing."""

    def __init__(self, config: RadarConfig, scale: SpeedScale) -> None:
        self._config, self._scale = config, scale
        self._place = np.array([config.mounting.x_m, config.mounting.y_m])
        self._cos_edge = float(np.cos(config.azimuth.field_of_view_rad))
        self._course_rad = 0.0  # the radar's own direction of travel, vehicle's frame
        self._height_m: float | None = None  # of the echo above or below the radar, smoothed
        self._line: tuple[np.ndarray, np.ndarray] | None = None  # s^2 and s^2 y^2, covariance
        self._information = np.zeros(2)  # to the scale: precision, and weighted with the mean
        self._surges = 0
        self._plain = config.on_path.way_frames  # frames in a row whose speed a standing thing may have

    @property
    def has_moved(self) -> bool:
        """It moves over ground: of late too fast or too slow for what stands, or often faster than it would be."""
        return self._surges >= _SURGES or self._plain < self._config.on_path.way_frames

    def update(self, echo: Echo, motion: Motion) -> None:
        """One measurement of the track's strongest echo."""
        x, y = self._place
        velocity = np.array([motion.speed_mps - motion.yaw_rate_radps * y, motion.yaw_rate_radps * x])
        self._course_rad = float(np.arctan2(velocity[1], velocity[0]))
        speed_mps, moving_mps = float(np.hypot(*velocity)), self._config.tracking.moving_mps
        closing_mps = -echo.velocity_mps
        if not speed_mps * self._cos_edge - moving_mps <= closing_mps <= speed_mps + moving_mps:
            self._plain = 0
            self._start_over()
            return
        self._plain += 1
        self._note_height(echo)
        turning = abs(motion.yaw_rate_radps) > _TURNING_RADPS
        if turning:
            self._start_over(keep=True)
        error_mps = float(np.hypot(self._config.on_path.doppler_mps, motion.speed_sigma_mps))
        self._fit(closing_mps / speed_mps, echo.range_m, error_mps / speed_mps, learns=not turning)

    def _note_height(self, echo: Echo) -> None:
        if echo.elevation_rad is None:
            self._height_m = None
            return
        height_m = echo.range_m * abs(float(np.sin(echo.elevation_rad)))
        before_m = height_m if self._height_m is None else self._height_m
        self._height_m = before_m + _SMOOTHING * (height_m - before_m)

    def _start_over(self, *, keep: bool = False) -> None:
        """Nothing is known of the track's place; unless ``keep``, what it told the scale was wrong."""
        if not keep:
            self._scale.learn(-self._information[0], -self._information[1])
        self._information = np.zeros(2)
        self._line = None

    def _fit(self, share: float, range_m: float, error: float, *, learns: bool) -> None:
        """One step of recursive least squares: z = s^2 - (s y)^2 / R^2."""
        fresh = self._line is None
        state, P = self._line or (np.array([self._scale.mean, 0.0]), np.diag([self._scale.variance, _WIDE_M2**2]))
        H = np.array([1.0, -1.0 / max(range_m, 0.1) ** 2])
        noise = (2.0 * share * error) ** 2
        innovation, S = share**2 - float(H @ state), float(H @ P @ H) + noise
        if innovation**2 > _MISFIT * S and not fresh:
            self._surges += innovation > 0.0
            self._start_over()
            self._fit(share, range_m, error, learns=learns)
            return
        gain = P @ H / S
        after = state + gain * innovation, P - np.outer(gain, H @ P)
        self._line = after
        if learns:
            gained = 1.0 / after[1][0, 0] - 1.0 / P[0, 0]
            information = np.array([gained, after[0][0] / after[1][0, 0] - state[0] / P[0, 0]])
            self._scale.learn(*information)
            self._information += information

    def least_beside_m(self, sigmas: float) -> float:
        """How far off the line of travel it is at least, so many standard deviations sure, without its height."""
        if self._line is None or self._height_m is None:
            return 0.0
        state, P = self._line
        lowest = (state[1] - sigmas * P[1, 1] ** 0.5) / max(state[0], 0.25)
        return float(max(lowest - self._height_m**2, 0.0) ** 0.5)

    def beside_m(self, sigmas: float) -> tuple[float, float] | None:
        """How far off the line of travel its speed lets it stand, least and most, so many standard deviations sure.

        None = it moves, or nothing is known of its speed.
        """
        if self._line is None or self.has_moved:
            return None
        state, P = self._line
        highest = (state[1] + sigmas * P[1, 1] ** 0.5) / max(state[0], 0.25)
        return self.least_beside_m(sigmas), float(max(highest, 0.0) ** 0.5)

    def places(
        self, place_m: np.ndarray, sigma_m: float, range_m: float, least_m: float
    ) -> Iterable[tuple[np.ndarray, float]]:
        """Where it may stand, with the standard deviation sideways: as measured, or ``least_m`` off the line of travel.

        The latter to one side or, when the azimuth does not tell which, to both.
        """
        offset = place_m - self._place
        bearing_rad = float(np.arctan2(offset[1], offset[0])) - self._course_rad
        reach_m = max(range_m, 1e-3)
        beside_m, least_m = reach_m * abs(float(np.sin(bearing_rad))), min(least_m, reach_m)
        if beside_m - sigma_m >= least_m:
            yield place_m, sigma_m
            return
        sides = (np.sign(bearing_rad),) if beside_m > _SURE_SIDE_SIGMAS * sigma_m else (1.0, -1.0)
        angle_rad = float(np.arcsin(max(beside_m, least_m) / reach_m))
        for side in sides:
            at_rad = self._course_rad + side * angle_rad
            at_m = self._place + reach_m * np.array([np.cos(at_rad), np.sin(at_rad)])
            yield at_m, sigma_m if least_m == 0.0 else max(beside_m - least_m, 0.0)
