"""Which calibration is in use, and whether the pole still stands as it did."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from services.infra_lidar.calibration import Calibration, Calibrator, fit_level_surface
from services.infra_lidar.config import CalibrationConfig
from services.infra_lidar.ground import Levelled
from services.infra_lidar.range_image import Returns, points_of

LOOKED_AT, WATCH_POINTS = 10_000, 1000  # points of a frame, and of the road near the sensor, that a check goes by
WATCH_BAND_M = 0.4  # a nudge up to this height error at 20 m is measured, a larger one loses the road and says so
CHECKS_TO_BELIEVE = 3


class CalibrationKeeper:
    """Calibrates from the first frames, then watches for a nudge: tilt and height against the calibration in use."""

    def __init__(self, config: CalibrationConfig, stored: Calibration | None = None) -> None:
        self._config = config
        self._calibrator: Calibrator | None = None
        self._current: Calibration | None = stored
        self._next_check_ns = 0
        self._suspicious = 0
        self._seen_lost = 0
        self.nudge_deg = 0.0
        self.nudge_m = 0.0
        if stored is None:
            self.restart()

    def restart(self) -> None:
        """Forget the calibration and begin again with the next frame."""
        self._calibrator = Calibrator(self._config)
        self._suspicious = 0
        self._seen_lost = 0
        self.nudge_deg = self.nudge_m = 0.0

    @property
    def settled(self) -> bool:
        """True when the calibration no longer changes from frame to frame."""
        return self._calibrator is None

    @property
    def settled_calibration(self) -> Calibration | None:
        """The calibration once it is final, usable and measured once by the nudge watch."""
        usable = self.settled and self._current is not None and self._current.baseline is not None
        return self._current if usable else None

    @property
    def complaint(self) -> str:
        """Why the calibration should not be relied on; empty when it may."""
        if self._current is not None and self._current.refused:
            return f"not calibrated: {self._current.refused}"
        if self._suspicious >= CHECKS_TO_BELIEVE:
            return (
                f"the sensor has moved: {self.nudge_deg:.2f} deg and {self.nudge_m * 100:+.0f} cm "
                "against its calibration; recalibrate"
            )
        if self._seen_lost >= CHECKS_TO_BELIEVE:
            return "the road near the sensor is no longer where it was calibrated; recalibrate"
        return ""

    def update(self, returns: Returns) -> Calibration:
        """The calibration for this frame."""
        if self._calibrator is not None:
            fresh = self._calibrator.add(points_of(returns))
            if self._calibrator.complete:
                self._calibrator = Calibrator(self._config) if fresh.refused else None
            if self._current is None or not fresh.refused or self._current.refused:
                self._current = fresh
        assert self._current is not None
        return self._current

    def due(self, stamp_ns: int) -> bool:
        """True when the road is to be measured again."""
        return self.settled and stamp_ns >= self._next_check_ns

    def look_after(self, stamp_ns: int, frame: Levelled) -> None:
        """Measure the road again every ``check_period_s``, in the level frame of ``frame``."""
        if not self.due(stamp_ns):
            return
        self._next_check_ns = stamp_ns + int(self._config.check_period_s * 1e9)
        every = len(frame.x) // LOOKED_AT | 1  # odd: so that every beam is among them
        x, y, z = frame.x[::every], frame.y[::every], frame.z[::every]
        (near,) = np.nonzero((x * x + y * y < self._config.radius_m**2) & (np.abs(z) < WATCH_BAND_M))
        near = near[:: len(near) // WATCH_POINTS + 1]
        road = np.array([x[near], y[near], z[near]], np.float64).T
        if len(road) < 50:
            self._seen_lost += 1
            return
        self._seen_lost = 0
        coefficients, _ = fit_level_surface(road, WATCH_BAND_M)
        assert self._current is not None
        if self._current.baseline is None:  # the watch sees kerbs and verges too: only changes of what it sees count
            m, slope_x, slope_y = (float(c) for c in coefficients)
            self._current = replace(self._current, baseline=(m, slope_x, slope_y))
        change = coefficients - np.array(self._current.baseline)
        self.nudge_deg = float(np.degrees(np.hypot(change[1], change[2])))
        self.nudge_m = float(change[0])
        moved = self.nudge_deg > self._config.nudge_tilt_deg or abs(self.nudge_m) > self._config.nudge_height_m
        self._suspicious = self._suspicious + 1 if moved else 0
