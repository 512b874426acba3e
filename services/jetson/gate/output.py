"""Where permissions go: one object for each URL in ``outputs``, all with the same few methods."""

from __future__ import annotations

from typing import Protocol

from common.config import ConfigError
from common.source_url import SourceUrl, parse_source
from services.jetson.gate.config import GateConfig
from services.jetson.gate.pipeline import Decision

STOP_BUDGET_S = 0.3  # from whatever dies or freezes to STOP at the actuator

SCHEMES: dict[str, tuple[str, ...]] = {
    "serial": ("baud", "reports"),
    "gpio": ("enable", "full", "mode", "active", "hold"),
    "can": ("id", "interface", "bitrate"),
    "sim": ("brake", "accelerate", "wanted"),
}


class Output(Protocol):
    """An actuator. No method blocks or raises once it is open; what is wrong comes out of ``fault``."""

    url: SourceUrl
    hold_s: float  # how long the actuator goes on after it was told to stop, or after the last sign of life

    def send(self, now_s: float, decision: Decision, verdict_seq: int) -> None:
        """Pass a decision on, at every round of the loop."""

    def listen(self, now_s: float) -> None:
        """Take what the actuator says, without telling it anything; ``send`` does so too."""

    def fault(self, now_s: float) -> str:
        """Why the actuator does not do, or may not know, what it is told; empty when all is well."""

    def presses(self) -> int:
        """How often a person has pressed the actuator's acknowledge button since the last call."""

    def words(self) -> str:
        """What the actuator says that it does, for people; empty when it has no way to say so."""

    def close(self) -> None:
        """Tell it to stop, and let go."""


def open_outputs(config: GateConfig) -> list[Output]:
    """The outputs of a configuration. A device that is away is no error: it is tried again.

    Raises:
        ConfigError: an unknown scheme or parameter, a missing library, or an output that cannot stop in time.
    """
    outputs = [_open(parse_source(text, SCHEMES), config) for text in config.outputs]
    for output in outputs:
        total_s = config.limits.verdict_age_s + config.period_s + output.hold_s
        if total_s > STOP_BUDGET_S + 1e-9:
            for one in outputs:
                one.close()
            raise ConfigError(
                f"output {output.url}: a frozen fusion would be STOP after {total_s:.3f} s, allowed {STOP_BUDGET_S} s "
                f"(verdict_age_s {config.limits.verdict_age_s} + period_s {config.period_s} + hold {output.hold_s:g}): "
                f"set limits.verdict_age_s = {STOP_BUDGET_S - config.period_s - output.hold_s:.3f} or less"
            )
    return outputs


def _open(url: SourceUrl, config: GateConfig) -> Output:
    """Libraries are imported only where they are needed."""
    match url.scheme:
        case "serial":
            from services.jetson.gate.serial_output import serial_output

            return serial_output(url, config)
        case "gpio":
            from services.jetson.gate.gpio_output import gpio_output

            return gpio_output(url, config)
        case "can":
            from services.jetson.gate.can_output import CanOutput

            return CanOutput(url, config)
    from services.jetson.gate.sim_output import SimulatedCar

    return SimulatedCar(url, config)
