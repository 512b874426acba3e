"""Whether the radar can see: settling, saturation, noise floor and transmitter leakage against what was learned.

The transmitter always leaks into the receivers: the first range bins hold a strong echo that no scene changes. When it
falls, transmitter or receiver is gone or detuned; when it rises, something covers the antenna. The noise floor falls
with the receiver's gain and rises with interference. Interference that is there from the start would be learned with
it, so it is also told by itself: another radar hits some chirps of a frame and not others, a body reflects all alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from common.messages import SelfReport
from services.radar_pi.config import HealthConfig

ADC_MAX = 4095


@dataclass(frozen=True)
class Health:
    """The radar's own report: its state, and why."""

    state: SelfReport
    reason: str


@dataclass(frozen=True)
class Signals:
    """What one frame tells of the receiver."""

    saturated: float  # share of samples at the converter's limits
    noise_floor_db: float
    leakage_db: float  # static clutter at the antenna
    chirp_spread_db: float = 0.0  # the strong chirps of the frame above the weak ones


def saturated_fraction(frame: np.ndarray) -> float:
    """Share of ADC samples at either limit. Underflow of the FIFO reads as the upper limit too."""
    if frame.min() > 0 and frame.max() < ADC_MAX:  # as always, and soon told
        return 0.0
    return float(np.count_nonzero((frame == 0) | (frame >= ADC_MAX)) / frame.size)


def chirp_spread_db(moving: np.ndarray) -> float:
    """How far the chirps of a frame differ in power: 90th over 10th percentile, in dB.

    Args:
        moving: (rx, chirp, bin) complex, without the standing background.
    """
    power = np.einsum("rcb,rcb->c", moving.real, moving.real) + np.einsum("rcb,rcb->c", moving.imag, moving.imag)
    low, high = np.percentile(power, [10, 90])
    return float(10 * np.log10(max(float(high), 1e-12) / max(float(low), 1e-12)))


class Learned:
    """A level in dB that is given, or learned as the median of the first frames, and watched from then on."""

    def __init__(self, given_db: float | None, learn_frames: int, limit_db: float, hold_frames: int) -> None:
        self.expected_db = given_db
        self._learn_frames = learn_frames
        self._limit_db = limit_db
        self._hold_frames = hold_frames
        self._seen: list[float] = []
        self._off = 0
        self._good = 0

    def deviation_db(self, value_db: float) -> float | None:
        """How far the value has been off for ``hold_frames`` in a row; None = it is not. Three good frames recover."""
        if self.expected_db is None:
            self._seen.append(value_db)
            if len(self._seen) == self._learn_frames:
                self.expected_db = float(np.median(self._seen))
            return None
        deviation_db = value_db - self.expected_db
        if abs(deviation_db) > self._limit_db:
            self._off, self._good = self._off + 1, 0
        else:
            self._good += 1
            if self._good >= RECOVERY_FRAMES:
                self._off = 0
        return deviation_db if self._off >= self._hold_frames else None


RECOVERY_FRAMES = 3


class HealthMonitor:
    """Counts and learned levels over time; ``judge`` is called once per frame."""

    def __init__(self, config: HealthConfig) -> None:
        self._config = config
        self._noise = Learned(config.noise_floor_db, config.learn_frames, config.noise_db, config.hold_frames)
        self._leakage = Learned(config.leakage_db, config.learn_frames, config.clutter_db, config.hold_frames)
        self._spread = Learned(0.0, config.learn_frames, config.interference_db, config.hold_frames)
        self._saturated = 0

    def judge(self, settled: bool, signals: Signals, note: str = "") -> Health:
        """State and reason of this frame. While settling nothing is learned. ``note`` is the driver's."""
        self._saturated = self._saturated + 1 if signals.saturated > self._config.saturated_fraction else 0
        reasons = [note] if note else []
        if not settled:
            reasons.append("settling: the background is not learned yet")
        else:
            reasons += self._off_learned(signals.noise_floor_db, signals.leakage_db)
        spread_db = self._spread.deviation_db(signals.chirp_spread_db)
        if spread_db is not None:
            reasons.append(f"interference: chirps of one frame differ by {spread_db:.0f} dB; another radar near by?")
        if self._saturated >= self._config.saturated_frames:
            reasons.append("saturated: samples at the converter's limits; something large is near, or lower if_gain_db")
        return Health("degraded" if reasons else "online", "; ".join(reasons))

    def _off_learned(self, noise_floor_db: float, leakage_db: float) -> list[str]:
        reasons = []
        noise_db = self._noise.deviation_db(noise_floor_db)
        if noise_db is not None:
            cause = "interference or another gain" if noise_db > 0 else "receiver detuned or without supply"
            reasons.append(f"noise floor {noise_db:+.0f} dB off its learned value: {cause}")
        clutter_db = self._leakage.deviation_db(leakage_db)
        if clutter_db is not None:
            cause = "antenna covered" if clutter_db > 0 else "transmitter or receiver detuned"
            reasons.append(f"static clutter at the antenna {clutter_db:+.0f} dB off its learned value: {cause}")
        return reasons
