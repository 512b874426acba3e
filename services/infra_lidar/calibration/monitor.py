"""Which calibration is in use, and whether the sensor still stands as it did when it was calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.infra_lidar.calibration.plane_fit import Calibration, Calibrator, fit_level_surface
from services.infra_lidar.config import CalibrationConfig
from services.infra_lidar.input.range_image import Returns, points_of

MAX_POINTS, MAX_ROAD_POINTS, MIN_ROAD_POINTS = 10_000, 1000, 50  # used of a frame, and of the road in it
ROAD_BAND_M = 0.4  # a nudge up to this height error at 20 m is measured; with a larger one the road is lost
CHECKS_TO_BELIEVE = 3


class CalibrationMonitor:
    """Calibrates from the first frames, then compares tilt and height of the road with the calibration in use.

    nudge_deg, nudge_m: how far the sensor has moved by the last check.
    """

    def __init__(self, config: CalibrationConfig, stored: Calibration | None = None) -> None:
        self._config = config
        self._calibrator: Calibrator | None = None
        self._current: Calibration | None = stored
        self._refusal = ""  # why the latest fit is refused, while the calibration before it is still in use
        self._next_check_ns = 0
        self._moved_checks = 0
        self._lost_checks = 0
        self.nudge_deg = 0.0
        self.nudge_m = 0.0
        if stored is None:
            self.restart()

    def restart(self) -> None:
        """Forget the calibration and begin again with the next frame."""
        self._calibrator = Calibrator(self._config)
        self._refusal = ""
        self._moved_checks = 0
        self._lost_checks = 0
        self.nudge_deg = self.nudge_m = 0.0

    @property
    def settled(self) -> bool:
        """True when the calibration no longer changes from frame to frame."""
        return self._calibrator is None

    @property
    def settled_calibration(self) -> Calibration | None:
        """The calibration once it is final, usable and checked once; else None."""
        usable = self.settled and self._current is not None and self._current.baseline is not None
        return self._current if usable else None

    @property
    def fault(self) -> str:
        """Why the calibration should not be relied on; empty when it may."""
        if self._current is not None and self._current.refused:
            return f"not calibrated: {self._current.refused}"
        if self._refusal:
            return f"the calibration from before is in use, a new one is refused: {self._refusal}"
        if self._moved_checks >= CHECKS_TO_BELIEVE:
            return (
                f"the sensor has moved: {self.nudge_deg:.2f} deg and {self.nudge_m * 100:+.0f} cm "
                "against its calibration; recalibrate"
            )
        if self._lost_checks >= CHECKS_TO_BELIEVE:
            return "the road near the sensor is no longer where it was calibrated; recalibrate"
        return ""

    def update(self, returns: Returns) -> Calibration:
        """The calibration for this frame; as long as it is not settled, the frame improves it."""
        if self._calibrator is not None:
            latest = self._calibrator.add(points_of(returns))
            self._refusal = latest.refused
            if self._calibrator.complete:
                self._calibrator = Calibrator(self._config) if latest.refused else None
            if self._current is None or not latest.refused or self._current.refused:
                self._current = latest
        assert self._current is not None
        return self._current

    def due(self, stamp_ns: int) -> bool:
        """Whether the road is to be checked with the frame of this time; also when the clock was set back."""
        since_ns = stamp_ns - self._next_check_ns
        return self.settled and not -int(self._config.check_period_s * 1e9) <= since_ns < 0

    def monitor(self, stamp_ns: int, points: np.ndarray) -> None:
        """Check the road every ``check_period_s``, in points (N, 3+) float32, m, level frame."""
        if not self.due(stamp_ns):
            return
        self._next_check_ns = stamp_ns + int(self._config.check_period_s * 1e9)
        x, y, z = points[:: len(points) // MAX_POINTS | 1, :3].T  # an odd step: so that every beam is among them
        (near,) = np.nonzero((x * x + y * y < self._config.radius_m**2) & (np.abs(z) < ROAD_BAND_M))
        near = near[:: len(near) // MAX_ROAD_POINTS + 1]
        if len(near) < MIN_ROAD_POINTS:
            self._lost_checks += 1
            return
        road = np.array([x[near], y[near], z[near]], np.float64).T
        self._lost_checks = 0
        coefficients, _ = fit_level_surface(road, ROAD_BAND_M)
        assert self._current is not None
        if self._current.baseline is None:  # kerbs and verges tilt this fit, too: only changes since then count
            m, slope_x, slope_y = (float(c) for c in coefficients)
            self._current = replace(self._current, baseline=(m, slope_x, slope_y))
        change = coefficients - np.array(self._current.baseline)
        self.nudge_deg = float(np.degrees(np.hypot(change[1], change[2])))
        self.nudge_m = float(change[0])
        moved = self.nudge_deg > self._config.nudge_tilt_deg or abs(self.nudge_m) > self._config.nudge_height_m
        self._moved_checks = self._moved_checks + 1 if moved else 0
