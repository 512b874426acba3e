"""Which signals of a DBC file are the vehicle's motion, in the units that the file states."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from common.config import ConfigError
from services.jetson.ego.config import CanConfig
from services.jetson.ego.measurement import Measurement, Rejected

UNITS = {
    "speed_mps": {"m/s": 1.0, "km/h": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704, "mm/s": 1e-3},
    "yaw_rate_radps": {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180, "mrad/s": 1e-3},
    "steering_rad": {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "mrad": 1e-3},
    "battery_v": {"V": 1.0, "mV": 1e-3},
}


class CanSignals:
    """Frames to measurements.

    Raises:
        ConfigError: no such file, message or signal, or a unit that is not known.
    """

    def __init__(self, config: CanConfig) -> None:
        if not config.dbc:
            raise ConfigError('[can] dbc is missing: expected the file with the bus\'s signals, e.g. dbc = "car.dbc"')
        try:
            import cantools
        except ImportError:
            raise ConfigError("[can]: library cantools is missing: install the extra vehicle") from None
        self._wrong_frame: type[Exception] = cantools.database.DecodeError
        try:
            self._database: Any = cantools.database.load_file(Path(config.dbc))
        except (OSError, cantools.database.UnsupportedDatabaseFormatError) as error:
            raise ConfigError(f"[can] dbc = {config.dbc!r}: {error}") from None
        wanted = {
            "speed_mps": config.speed,
            "yaw_rate_radps": config.yaw_rate,
            "steering_rad": config.steering,
            "battery_v": config.battery,
        }
        self._signals: dict[int, list[tuple[str, str, float]]] = {}  # by frame id: (field, signal, factor)
        for field, name in wanted.items():
            if name:
                self._find(field, name)
        if not self._signals:
            raise ConfigError('[can]: name at least one signal, e.g. speed = "Motion.WheelSpeed"')

    @property
    def frame_ids(self) -> tuple[int, ...]:
        """Identifiers of the frames that hold a signal."""
        return tuple(self._signals)

    def measure(self, at_s: float, frame_id: int, data: bytes) -> Measurement | Rejected | None:
        """The measurement in a frame; None when the frame is not one of ours."""
        if frame_id not in self._signals:
            return None
        try:
            decoded = self._database.decode_message(frame_id, data, decode_choices=False)
        except (self._wrong_frame, ValueError, KeyError):  # too short, or a multiplexer that does not exist
            return Rejected("can", "nonsense")
        fields = {
            field: float(decoded[signal]) * factor
            for field, signal, factor in self._signals[frame_id]
            if signal in decoded
        }
        return Measurement(at_s, "can", **fields)

    def _find(self, field: str, name: str) -> None:
        message_name, _, signal_name = name.partition(".")
        try:
            message = self._database.get_message_by_name(message_name)
            signal = message.get_signal_by_name(signal_name)
        except KeyError:
            known = ", ".join(f"{m.name}.{s.name}" for m in self._database.messages for s in m.signals)
            raise ConfigError(f"[can] {name!r}: no such signal in the DBC file; there are: {known}") from None
        if signal.unit not in UNITS[field]:
            allowed = ", ".join(UNITS[field])
            raise ConfigError(f"[can] {name!r}: the DBC file gives its unit as {signal.unit!r}; allowed: {allowed}")
        self._signals.setdefault(message.frame_id, []).append((field, signal_name, UNITS[field][signal.unit]))
