"""The latency budget: how old each input's measurement was when it first reached a verdict."""

from __future__ import annotations

from collections import deque

from services.jetson.fusion.evidence import SensorInput

WINDOW = 256  # inputs


class LatencyBook:
    """Collects, per input, the age at its first verdict and the part that fusion itself took."""

    def __init__(self, budgets_ms: dict[str, float]) -> None:
        self._budgets_ms = budgets_ms
        self._age_ms: dict[str, deque[float]] = {name: deque(maxlen=WINDOW) for name in budgets_ms}
        self._fusion_ms: deque[float] = deque(maxlen=WINDOW)
        self._last_stamp_ns: dict[str, int] = {}

    def add(self, sensors: dict[str, SensorInput]) -> None:
        """Call once per verdict; an input counts when it is new."""
        for name, sensor in sensors.items():
            if sensor.age_s is None or not sensor.stamp_ns or self._last_stamp_ns.get(name) == sensor.stamp_ns:
                continue
            self._last_stamp_ns[name] = sensor.stamp_ns
            self._age_ms[name].append(sensor.age_s * 1e3)
            self._fusion_ms.append(sensor.stage_ms.get("fusion", 0.0))

    def summary(self) -> dict[str, float]:
        """``radar_p50``, ``radar_p99``, ..., ``fusion_p50``, ``fusion_p99`` in milliseconds."""
        table: dict[str, float] = {}
        for name, values in [*self._age_ms.items(), ("fusion", self._fusion_ms)]:
            if values:
                ordered = sorted(values)
                table |= {f"{name}_p{share}": round(_percentile(ordered, share), 3) for share in (50, 99)}
        return table

    def over_budget(self) -> dict[str, str]:
        """By sensor: a sentence when its 99th percentile is over its budget."""
        table = self.summary()
        return {
            name: f"late: p99 {table[f'{name}_p99']:.0f} ms from measurement to verdict, budget {budget_ms:.0f} ms"
            for name, budget_ms in self._budgets_ms.items()
            if table.get(f"{name}_p99", 0.0) > budget_ms
        }


def _percentile(ordered: list[float], share: int) -> float:
    """The percentile of values that rise, linear between neighbours: as numpy's, which is slow for so few."""
    place = share / 100.0 * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return ordered[below] + (place - below) * (ordered[above] - ordered[below])
