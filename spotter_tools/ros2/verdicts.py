"""Verdict to spotter_msgs/Verdict, SystemHealth to diagnostic_msgs/DiagnosticArray. Pure."""

from __future__ import annotations

import math
from typing import Any

from common import messages as m
from common.ros2.types import build, header
from common.topics import spoken
from spotter_tools.ros2.geometry import VEHICLE

VERDICT, DIAGNOSTICS = "spotter_msgs/msg/Verdict", "diagnostic_msgs/msg/DiagnosticArray"
LEVELS = {"SAFE": 1, "CAUTION": 2, "IMMINENT": 3}  # 0: the field was not filled in
PERMISSIONS = {"STOP": 0, "SLOW": 1, "GO": 2}
OK, WARN, ERROR = 0, 1, 2
STATES = {"online": OK, "degraded": WARN, "disconnected": ERROR}
COLOURS = {"green": OK, "amber": WARN, "red": ERROR}


def verdict(message: m.Verdict, host: str) -> Any:
    """What is not known is NaN."""
    return build(
        VERDICT, header=header(message.stamp_ns, VEHICLE), seq=message.seq % 2**32, level=LEVELS[message.level],
        permission=PERMISSIONS[message.permission], rule=message.rule, because=message.because, blind=message.blind,
        confirmed=message.confirmed, covered_m=_number(message.covered_m),
        max_safe_speed_mps=_number(message.max_safe_speed_mps), source_kind=message.source_kind,
    )  # fmt: skip


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def diagnostics(message: m.SystemHealth, host: str) -> Any:
    """The whole in one status, and one for each sensor with its age, rate, cause and kind of data."""
    whole = _status("spotter", host, COLOURS[message.colour], message.summary, {"vehicle": message.vehicle})
    parts = [
        _status(
            f"spotter: {spoken(name)}", host, STATES[sensor.state], sensor.reason or sensor.state,
            {
                "cause": sensor.cause, "source_kind": sensor.source_kind, "rate_hz": f"{sensor.rate_hz:.1f}",
                "age_ms": "never seen" if sensor.age_ms is None else f"{sensor.age_ms:.0f}",
            },
        )
        for name, sensor in message.sensors.items()
    ]  # fmt: skip
    return build(DIAGNOSTICS, header=header(message.stamp_ns, ""), status=[whole, *parts])


def _status(name: str, host: str, level: int, text: str, values: dict[str, str]) -> Any:
    pairs = [build("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    return build(
        "diagnostic_msgs/msg/DiagnosticStatus", level=level, name=name, message=text, hardware_id=host, values=pairs
    )
