"""Ouster lidar packets, bit by bit from the firmware manual's tables ("Lidar Data Format"), independent of the decoder.

``FIELDS`` has for each profile the bits of a pixel (first, count) and the millimetres of a range step, as the manual
draws them: the pixel is one little-endian number.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field

import numpy as np

FIELDS: dict[str, tuple[int, dict[str, tuple[int, int]], int]] = {  # bytes, fields, mm
    "LEGACY": (12, {"range": (0, 20), "reflectivity": (32, 8)}, 1),
    "RNG19_RFL8_SIG16_NIR16": (12, {"range": (0, 19), "reflectivity": (32, 8)}, 1),
    "RNG19_RFL8_SIG16_NIR16_DUAL": (
        16,
        {"range": (0, 19), "reflectivity": (24, 8), "range2": (32, 19), "reflectivity2": (56, 8)},
        1,
    ),
    "RNG15_RFL8_NIR8": (4, {"range": (0, 15), "reflectivity": (16, 8)}, 8),
    "RNG15_RFL8_NIR8_DUAL": (
        8,
        {"range": (0, 15), "reflectivity": (16, 8), "range2": (32, 15), "reflectivity2": (48, 8)},
        8,
    ),
    "RNG15_RFL8_WIN8": (4, {"range": (0, 15), "reflectivity": (16, 8)}, 8),
    "RNG15_RFL8_NIR8_ZONE16": (8, {"range": (0, 15), "reflectivity": (16, 8)}, 8),
    "RNG19_RFL8_SIG16_NIR16_ZONE16": (12, {"range": (0, 19), "reflectivity": (32, 8)}, 1),
    "RNG19_RFL8_SIG16_NIR16_RGB16": (16, {"range": (0, 19), "reflectivity": (24, 8)}, 1),
}
FIELDS["FUSA_RNG15_RFL8_NIR8_DUAL"] = FIELDS["RNG15_RFL8_NIR8_DUAL"]
FIELDS["RNG19_RFL8_SIG16_ZONE16_DUAL"] = FIELDS["RNG19_RFL8_SIG16_NIR16_DUAL"]
FIELDS["FIVE_WORD_PIXEL"] = 20, *FIELDS["RNG19_RFL8_SIG16_NIR16_DUAL"][1:]
FIELDS["RNG19_RFL8_SIG16_NIR16_RGB16_DUAL"] = FIELDS["FIVE_WORD_PIXEL"]

ALTITUDES_DEG = np.linspace(21.0, -21.0, 128).round(2)
AZIMUTHS_DEG = np.tile([4.2, 1.4, -1.4, -4.2], 32)
ORIGIN_MM, HEIGHT_MM = 27.67, 38.195
COLUMNS = 512


def metadata(profile: str, window: tuple[int, int] = (0, COLUMNS - 1)) -> str:
    """Sensor metadata as the sensor's HTTP interface gives them, firmware 3.x."""
    return json.dumps(
        {
            "beam_intrinsics": {
                "beam_altitude_angles": ALTITUDES_DEG.tolist(),
                "beam_azimuth_angles": AZIMUTHS_DEG.tolist(),
                "beam_to_lidar_transform": [1, 0, 0, ORIGIN_MM, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
                "lidar_origin_to_beam_origin_mm": ORIGIN_MM,
            },
            "lidar_intrinsics": {
                "lidar_to_sensor_transform": [-1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1, HEIGHT_MM, 0, 0, 0, 1],
            },
            "imu_intrinsics": {"imu_to_sensor_transform": np.eye(4).ravel().tolist()},
            "lidar_data_format": {
                "columns_per_frame": COLUMNS,
                "columns_per_packet": 16,
                "pixels_per_column": 128,
                "column_window": list(window),
                "pixel_shift_by_row": [0] * 128,
                "udp_profile_lidar": profile,
                "udp_profile_imu": "LEGACY",
                "fps": 10,
            },
            "sensor_info": {
                "build_rev": "v3.1.0",
                "image_rev": "ousteros-image-prod-bootes-v3.1.0+x",
                "initialization_id": 1,
                "prod_line": "OS-1-128",
                "prod_pn": "840-103575-06",
                "prod_sn": "1",
                "status": "RUNNING",
            },
            "calibration_status": {"reflectivity": {"valid": True, "timestamp": "2024-01-01T00:00:00"}},
            "config_params": {"lidar_mode": f"{COLUMNS}x10", "udp_port_lidar": 7502, "udp_port_imu": 7503},
        }
    )


@dataclass(frozen=True)
class Frame:
    """A turn. ranges: (returns, 128, COLUMNS) in steps of the profile; reflectivity likewise."""

    profile: str
    ranges: np.ndarray
    reflectivity: np.ndarray
    frame_id: int = 7
    dead_columns: frozenset[int] = field(default_factory=frozenset)

    def packets(self) -> list[bytes]:
        """The packets of the turn."""
        return [self.packet(first) for first in range(0, COLUMNS, 16)]

    def packet(self, first: int) -> bytes:
        """That with the columns from ``first`` on."""
        columns = b"".join(self._column(column) for column in range(first, first + 16))
        if self.profile == "LEGACY":
            return columns
        if self.profile.startswith("FUSA"):
            head = struct.pack("<B3sI", 1, b"\1\0\0", self.frame_id)
        else:
            head = struct.pack("<HH", 1, self.frame_id)
        return head.ljust(32, b"\0") + columns + bytes(32)

    def _column(self, column: int) -> bytes:
        valid = column not in self.dead_columns
        size, fields, _ = FIELDS[self.profile]
        stamp_ns = 1_000_000_000 + 100_000_000 * column // COLUMNS
        if self.profile == "LEGACY":
            head = struct.pack("<QHHI", stamp_ns, column, self.frame_id, 0)
        else:
            head = struct.pack("<QHH", stamp_ns, column, valid)
        pixels = b""
        for beam in range(128):
            values = {"range": self.ranges[0, beam, column], "reflectivity": self.reflectivity[0, beam, column]}
            if len(self.ranges) > 1:
                values |= {"range2": self.ranges[1, beam, column], "reflectivity2": self.reflectivity[1, beam, column]}
            word = 0
            for name, value in values.items():
                at, bits = fields[name]
                assert int(value) < 1 << bits
                word |= int(value) << at
            pixels += word.to_bytes(size, "little")
        return head + pixels + (struct.pack("<I", 0xFFFFFFFF if valid else 0) if self.profile == "LEGACY" else b"")


def point_of(column: int, beam: int, range_m: float) -> np.ndarray:
    """(3,) m in the sensor frame: the manual's "Lidar Range to XYZ", one pixel at a time."""
    encoder = 2.0 * np.pi * (1.0 - column / COLUMNS)
    azimuth, altitude = -np.radians(AZIMUTHS_DEG[beam]), np.radians(ALTITUDES_DEG[beam])
    n = ORIGIN_MM / 1000.0
    x = (range_m - n) * np.cos(encoder + azimuth) * np.cos(altitude) + n * np.cos(encoder)
    y = (range_m - n) * np.sin(encoder + azimuth) * np.cos(altitude) + n * np.sin(encoder)
    z = (range_m - n) * np.sin(altitude)
    return np.array([-x, -y, z + HEIGHT_MM / 1000.0])
