"""Can the sensor see? Returns, beams, directions, losses and time, against what this sensor usually measures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from services.infra_lidar.config import VisibilityConfig

_Sight = tuple[float, float, float, float]  # returns, near returns, beams, sectors
USUAL_GAIN = 0.02  # share of a good frame in the running mean of what is usual
MEDIANS = 5  # columns of the window that are judged by their median; of the others the sum counts


@dataclass(frozen=True)
class FrameQuality:
    """What the source knows about one frame."""

    packets: int = 0
    packets_lost: int = 0
    complete: bool = True


_FINE = FrameQuality()


@dataclass(frozen=True)
class FrameStatistics:
    """What one frame shows of the sensor's sight.

    returns: usable ones. near: those within ``near_m``. beams: with a return, 0 = the cloud has no ring column.
    sectors: of ``ground.sector_deg``, with a return.
    """

    returns: int
    near: int
    beams: int
    sectors: int


class VisibilityMonitor:
    """Decides from the last frames whether the sensor is online or degraded, and why."""

    def __init__(self, config: VisibilityConfig) -> None:
        self._config = config
        # Of each frame: returns, near, beams, sectors, time in ms; packets, lost packets, whether incomplete
        self._window = np.zeros((config.window_frames, MEDIANS + 3))
        self._frames = 0
        self._usual: _Sight | None = None

    def update(
        self, statistics: FrameStatistics, quality: FrameQuality | None, total_ms: float, fault: str
    ) -> tuple[Literal["online", "degraded"], str]:
        """State and reason after this frame.

        total_ms: what processing it took. fault: why the calibration should not be relied on, empty if it may.
        """
        quality = quality or _FINE
        self._window[self._frames % len(self._window)] = (
            statistics.returns, statistics.near, statistics.beams, statistics.sectors, total_ms,
            quality.packets, quality.packets_lost, not quality.complete,
        )  # fmt: skip
        self._frames += 1
        window = self._window[: self._frames]
        returns, near, beams, sectors, typical_ms = _medians(window[:, :MEDIANS])
        packets, lost, incomplete = window[:, MEDIANS:].sum(axis=0).tolist()
        sight = returns, near, beams, sectors
        reasons = [fault] if fault else []
        reasons += self._sight_reasons(sight)
        if not reasons:
            self._learn(sight)
        reasons += self._loss_reasons(packets, lost, incomplete)
        if typical_ms > self._config.budget_ms:
            reasons.append(f"processing takes {typical_ms:.0f} ms a frame, {self._config.budget_ms:g} are allowed")
        return ("degraded", "; ".join(reasons)) if reasons else ("online", "")

    def _sight_reasons(self, sight: _Sight) -> list[str]:
        config, reasons = self._config, []
        returns, near, beams, sectors = sight
        if returns < config.min_points:
            return [f"only {returns:.0f} returns a frame: covered, or switched off"]
        if near > config.max_near_share * returns:
            reasons.append(f"{near / returns:.0%} of the returns are within {config.near_m:g} m: rain, fog or dirt")
        if self._usual is None:
            return reasons
        usual_returns, _, usual_beams, usual_sectors = self._usual
        if returns < config.min_points_share * usual_returns:
            reasons.append(f"{returns:.0f} returns a frame instead of {usual_returns:.0f}")
        if beams < (1.0 - config.max_lost_beams_share) * usual_beams:
            reasons.append(f"{usual_beams - beams:.0f} of {usual_beams:.0f} beams are lost")
        if sectors < config.min_sectors_share * usual_sectors:
            reasons.append(f"{usual_sectors - sectors:.0f} of {usual_sectors:.0f} directions are covered")
        return reasons

    def _loss_reasons(self, packets: float, lost: float, incomplete: float) -> list[str]:
        reasons, frames = [], min(self._frames, len(self._window))
        if lost > self._config.max_packet_loss_share * max(packets + lost, 1):
            reasons.append(f"{lost / (packets + lost):.1%} of the packets are lost")
        if incomplete * 2 > frames:
            reasons.append(f"{incomplete:.0f} of the last {frames} revolutions are incomplete")
        return reasons

    def _learn(self, sight: _Sight) -> None:
        """Add a good frame to the running mean of what is usual."""
        if self._usual is None:
            self._usual = sight
        (a, b, c, d), (e, f, g, h), gain = self._usual, sight, USUAL_GAIN
        self._usual = a + gain * (e - a), b + gain * (f - b), c + gain * (g - c), d + gain * (h - d)


def _medians(values: np.ndarray) -> list[float]:
    """Of each column (n, m). A sort of ten rows takes a tenth of the time of ``np.median``."""
    ordered, n = np.sort(values, axis=0), len(values)
    medians: list[float] = (0.5 * (ordered[(n - 1) // 2] + ordered[n // 2])).tolist()
    return medians
