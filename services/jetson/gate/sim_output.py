"""A simulated car behind the real actuator logic: the receiver of the firmware, and a body that brakes."""

from __future__ import annotations

from common.source_url import SourceUrl
from services.jetson.gate.config import GateConfig
from services.jetson.gate.firmware.micropython.gate_receiver import TICKS_MASK, GateReceiver
from services.jetson.gate.frames import PERMISSIONS, WHY, permission_frame
from services.jetson.gate.pipeline import Decision


class Brakes:
    """A car that wants ``wanted_mps`` and gets what it is allowed; pure, time is an argument.

    Raises:
        ValueError: a deceleration or acceleration that is not positive.
    """

    def __init__(self, wanted_mps: float, brake_mps2: float, accelerate_mps2: float) -> None:
        if brake_mps2 <= 0.0 or accelerate_mps2 <= 0.0:
            raise ValueError(f"brake {brake_mps2} and accelerate {accelerate_mps2} m/s2: expected more than 0")
        self.speed_mps = 0.0
        self._wanted_mps, self._brake_mps2, self._accelerate_mps2 = wanted_mps, brake_mps2, accelerate_mps2
        self._last_s: float | None = None

    def step(self, now_s: float, limit_mps: float) -> float:
        """The speed at ``now_s`` in metres per second, when at most ``limit_mps`` was allowed since the last step."""
        passed_s = 0.0 if self._last_s is None else max(0.0, now_s - self._last_s)
        self._last_s = now_s
        target_mps = min(self._wanted_mps, limit_mps)
        if self.speed_mps > target_mps:
            self.speed_mps = max(target_mps, self.speed_mps - self._brake_mps2 * passed_s)
        else:
            self.speed_mps = min(target_mps, self.speed_mps + self._accelerate_mps2 * passed_s)
        return self.speed_mps


class SimulatedCar:
    """``sim:?wanted=2&brake=4&accelerate=1``: what the permission would do to a car."""

    hold_s = 0.02

    def __init__(self, url: SourceUrl, config: GateConfig) -> None:
        self.url = url
        self._permit_s, self._seq = config.limits.permit_s, 0
        self._receiver = GateReceiver()
        numbers = (url.number("wanted", 1.0), url.number("brake", 4.0), url.number("accelerate", 1.0))
        self._brakes = Brakes(*numbers)

    @property
    def speed_mps(self) -> float:
        """Speed of the simulated car, m/s."""
        return self._brakes.speed_mps

    def send(self, now_s: float, decision: Decision, verdict_seq: int) -> None:
        self._seq = (self._seq + 1) & 0xFF
        now_ms = int(now_s * 1e3) & TICKS_MASK
        for byte in permission_frame(self._seq, decision, self._permit_s, verdict_seq):
            self._receiver.feed(byte, now_ms)
        self.listen(now_s)

    def listen(self, now_s: float) -> None:
        self._receiver.tick(int(now_s * 1e3) & TICKS_MASK)
        self._brakes.step(now_s, self._receiver.limit_mm_s * 1e-3)

    def fault(self, now_s: float) -> str:
        return ""

    def presses(self) -> int:
        return 0

    def words(self) -> str:
        does = f"{PERMISSIONS[self._receiver.permission]} ({WHY[self._receiver.why]})"
        return f"{does}, simulated car at {self.speed_mps:.1f} m/s"

    def close(self) -> None:
        return
