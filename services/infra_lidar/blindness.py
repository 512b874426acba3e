"""Can the sensor see? Beams, directions, near returns, losses and time, against what this sensor usually shows."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from services.infra_lidar.config import BlindnessConfig

_Counted = tuple[int, int, int, int, float, int, int, bool]  # of a frame: as ``_Typical``, ms, packets, lost, partial
_Typical = tuple[float, float, float, float]  # returns, near ones, beams, sectors
USUAL_GAIN = 0.02  # how fast "usual" follows good frames


@dataclass(frozen=True)
class FrameQuality:
    """What the source knows about one frame."""

    packets: int = 0
    packets_lost: int = 0
    complete: bool = True
    dropped_frames: int = 0


@dataclass(frozen=True)
class Seen:
    """What the passes over a frame counted: points, usable returns, returns near the window, beams, sectors."""

    points: int
    returns: int
    near: int
    beams: int  # 0 = the cloud has no ring column
    sectors: int


class BlindnessWatch:
    """Turns what frames look like into online or degraded with reasons. Judges medians over a window of frames."""

    def __init__(self, config: BlindnessConfig) -> None:
        self._config = config
        self._recent: deque[_Counted] = deque(maxlen=config.window_frames)
        self._usual: _Typical | None = None

    def judge(
        self, seen: Seen, quality: FrameQuality | None, total_ms: float, complaint: str
    ) -> tuple[Literal["online", "degraded"], str]:
        """State and reason after this frame; ``complaint`` is what calibration has to say."""
        quality = quality or FrameQuality()
        self._recent.append((
            seen.returns, seen.near, seen.beams, seen.sectors, total_ms, quality.packets, quality.packets_lost,
            not quality.complete,
        ))  # fmt: skip
        returns, near, beams, sectors, spent_ms, packets, lost, partial = zip(*self._recent, strict=True)
        now = _median(returns), _median(near), _median(beams), _median(sectors)
        reasons = [complaint] if complaint else []
        reasons += self._sight(now)
        if not reasons:
            self._learn(now)
        reasons += self._losses(sum(packets), sum(lost), sum(partial), _median(spent_ms))
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

    def _losses(self, packets: int, lost: int, partial: int, slow_ms: float) -> list[str]:
        config, reasons = self._config, []
        if lost > config.max_packet_loss_share * max(packets + lost, 1):
            reasons.append(f"{lost / (packets + lost):.1%} of the packets are lost")
        if partial * 2 > len(self._recent):
            reasons.append(f"{partial} of the last {len(self._recent)} revolutions are incomplete")
        if slow_ms > config.budget_ms:
            reasons.append(f"processing takes {slow_ms:.0f} ms a frame, {config.budget_ms:g} are allowed")
        return reasons

    def _learn(self, now: _Typical) -> None:
        if self._usual is None:
            self._usual = now
        a, b, c, d = (old + USUAL_GAIN * (new - old) for old, new in zip(self._usual, now, strict=True))
        self._usual = a, b, c, d


def _median(values: Sequence[float]) -> float:
    """As of ``statistics``, but quick: it is asked for five times a frame."""
    ordered, middle = sorted(values), len(values) // 2
    return ordered[middle] if len(values) % 2 else (ordered[middle - 1] + ordered[middle]) / 2
