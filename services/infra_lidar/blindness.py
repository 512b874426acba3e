"""Can the sensor see? Beams, directions, near returns, losses and time, against what this sensor usually shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from services.infra_lidar.config import BlindnessConfig
from services.infra_lidar.jit import kernel
from services.infra_lidar.ordering import sort_rising

_Typical = tuple[float, float, float, float]  # returns, near ones, beams, sectors
USUAL_GAIN = 0.02  # how fast "usual" follows good frames
MEDIANS, SUMS = 5, 3  # of what is counted of a frame: as ``_Typical``, and ms; packets, lost ones, and whether partial


@dataclass(frozen=True)
class FrameQuality:
    """What the source knows about one frame."""

    packets: int = 0
    packets_lost: int = 0
    complete: bool = True
    dropped_frames: int = 0


_FINE = FrameQuality()


@dataclass(frozen=True)
class Seen:
    """What the passes over a frame counted: usable returns, those near the window, beams, sectors."""

    returns: int
    near: int
    beams: int  # 0 = the cloud has no ring column
    sectors: int


class BlindnessWatch:
    """Turns what frames look like into online or degraded with reasons. Judges medians over a window of frames."""

    def __init__(self, config: BlindnessConfig) -> None:
        self._config = config
        self._recent = np.zeros((config.window_frames, MEDIANS + SUMS))
        self._frames = 0
        self._usual: _Typical | None = None

    def judge(
        self, seen: Seen, quality: FrameQuality | None, total_ms: float, complaint: str
    ) -> tuple[Literal["online", "degraded"], str]:
        """State and reason after this frame; ``complaint`` is what calibration has to say."""
        quality = quality or _FINE
        self._frames += 1
        returns, near, beams, sectors, spent_ms, packets, lost, partial = _medians_and_sums(
            self._recent, self._frames, seen.returns, seen.near, seen.beams, seen.sectors, total_ms, quality.packets,
            quality.packets_lost, not quality.complete,
        )  # fmt: skip
        now = returns, near, beams, sectors
        reasons = [complaint] if complaint else []
        reasons += self._sight(now)
        if not reasons:
            self._learn(now)
        reasons += self._losses(packets, lost, partial, spent_ms)
        return ("degraded", "; ".join(reasons)) if reasons else ("online", "")

    def _sight(self, now: _Typical) -> list[str]:
        config, reasons = self._config, []
        returns, near, beams, sectors = now
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

    def _losses(self, packets: float, lost: float, partial: float, slow_ms: float) -> list[str]:
        config, reasons, frames = self._config, [], min(self._frames, len(self._recent))
        if lost > config.max_packet_loss_share * max(packets + lost, 1):
            reasons.append(f"{lost / (packets + lost):.1%} of the packets are lost")
        if partial * 2 > frames:
            reasons.append(f"{partial:.0f} of the last {frames} revolutions are incomplete")
        if slow_ms > config.budget_ms:
            reasons.append(f"processing takes {slow_ms:.0f} ms a frame, {config.budget_ms:g} are allowed")
        return reasons

    def _learn(self, now: _Typical) -> None:
        if self._usual is None:
            self._usual = now
        (a, b, c, d), (e, f, g, h), gain = self._usual, now, USUAL_GAIN
        self._usual = a + gain * (e - a), b + gain * (f - b), c + gain * (g - c), d + gain * (h - d)


@kernel
def _medians_and_sums(
    counted: np.ndarray, frames: int, returns: int, near: int, beams: int, sectors: int, ms: float, packets: int,
    lost: int, partial: bool,
) -> tuple[float, ...]:  # fmt: skip
    """Note the newest of ``frames`` in the ring ``counted`` (window, 8); returns the medians of its first five columns
    and the sums of the others."""
    newest = counted[(frames - 1) % len(counted)]
    newest[0], newest[1], newest[2], newest[3], newest[4] = returns, near, beams, sectors, ms
    newest[5], newest[6], newest[7] = packets, lost, partial
    n, told = min(frames, len(counted)), np.zeros(MEDIANS + SUMS)
    column = np.empty(n)
    for k in range(MEDIANS):
        for i in range(n):
            column[i] = counted[i, k]
        sort_rising(column)
        told[k] = 0.5 * (column[(n - 1) // 2] + column[n // 2])
    for i in range(n):
        for k in range(MEDIANS, MEDIANS + SUMS):
            told[k] += counted[i, k]
    return told[0], told[1], told[2], told[3], told[4], told[5], told[6], told[7]
