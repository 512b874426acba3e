"""Ouster lidar packets to revolutions, driven by the sensor's metadata. Bytes in, arrays out; no I/O.

Formats LEGACY, RNG19_RFL8_SIG16_NIR16 and its dual-return and low-data-rate relatives (first return of each), and the
geometry from the metadata, as described in Ouster's "Firmware User Manual" v2.x/v3.x, sections "Lidar Data Format" and
"Lidar Range to XYZ".
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from services.infra_lidar.jit import kernel
from services.infra_lidar.revolutions import PacketDecoder, Revolution, TurnCollector, TurnPoints


class MetadataError(ValueError):
    """The sensor's metadata lack what is needed; the text says what."""


@dataclass(frozen=True)
class _Profile:
    """Byte layout of a packet: header sizes, and where in a pixel range and reflectivity lie."""

    packet_header: int
    column_header: int
    column_footer: int
    packet_footer: int
    pixel: int
    range_type: str
    range_mask: int
    range_step_mm: int
    reflectivity_at: int
    reflectivity_type: str


_PROFILES = {
    "LEGACY": _Profile(0, 16, 4, 0, 12, "<u4", 0x000FFFFF, 1, 4, "<u2"),
    "RNG19_RFL8_SIG16_NIR16": _Profile(32, 12, 0, 32, 12, "<u4", 0x0007FFFF, 1, 4, "u1"),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(32, 12, 0, 32, 16, "<u4", 0x0007FFFF, 1, 3, "u1"),
    "RNG15_RFL8_NIR8": _Profile(32, 12, 0, 32, 4, "<u2", 0x7FFF, 8, 2, "u1"),
}


class OusterFormat:
    """Packet layout and beam geometry of one sensor.

    Raises:
        MetadataError: the text is no metadata of a lidar, or of a packet format that is not supported.
    """

    def __init__(self, metadata: str) -> None:
        self.metadata = metadata
        try:
            document = json.loads(metadata)
            flat: dict[str, Any] = {}
            for key, value in document.items():  # nested since firmware 2.5, flat before; data_format stays whole
                flat |= value if isinstance(value, dict) and key not in ("data_format", "lidar_data_format") else {}
            flat |= document
            layout = flat.get("lidar_data_format") or flat["data_format"]
            self.profile_name = str(layout.get("udp_profile_lidar", "LEGACY"))
            self.columns_per_frame = int(layout["columns_per_frame"])
            self.columns_per_packet = int(layout["columns_per_packet"])
            self.beams = int(layout["pixels_per_column"])
            altitude = np.radians(np.array(flat["beam_altitude_angles"], float).reshape(-1))
            azimuth = -np.radians(np.array(flat["beam_azimuth_angles"], float).reshape(-1))
            beam_origin_m = float(flat.get("lidar_origin_to_beam_origin_mm", 0.0)) / 1000.0
            to_sensor = np.reshape(np.array(flat["lidar_to_sensor_transform"], float), (4, 4))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise MetadataError(f"not the metadata of an Ouster lidar: {error!r}") from error
        if self.profile_name not in _PROFILES:
            raise MetadataError(f"packet format {self.profile_name}; known: {', '.join(_PROFILES)}")
        if not self.beams == len(altitude) == len(azimuth):
            raise MetadataError(f"{self.beams} pixels a column, {len(altitude)} and {len(azimuth)} beam angles")
        to_sensor[:3, 3] /= 1000.0
        self.profile = _PROFILES[self.profile_name]
        p = self.profile
        self.column_bytes = p.column_header + self.beams * p.pixel + p.column_footer
        self.packet_bytes = p.packet_header + self.columns_per_packet * self.column_bytes + p.packet_footer
        self.direction, self.origin_m = _rays(self.columns_per_frame, altitude, azimuth, beam_origin_m, to_sensor)


def _rays(
    columns: int, altitude: np.ndarray, azimuth: np.ndarray, beam_origin_m: float, to_sensor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """direction, origin (W, B, 3) float32: a point is direction * range + origin, in the sensor frame."""
    encoder = 2.0 * np.pi * (1.0 - np.arange(columns) / columns)[:, None]
    heading = encoder + azimuth
    direction = np.stack(
        [np.cos(heading) * np.cos(altitude), np.sin(heading) * np.cos(altitude),
         np.broadcast_to(np.sin(altitude), heading.shape)], axis=-1,
    )  # fmt: skip
    arm = np.stack([np.cos(encoder), np.sin(encoder), np.zeros_like(encoder)], axis=-1) * beam_origin_m
    origin = arm - direction * beam_origin_m  # ranges are measured from the origin of the lidar, along the arm
    rotation = to_sensor[:3, :3]
    return (
        (direction @ rotation.T).astype(np.float32),
        (origin @ rotation.T + to_sensor[:3, 3]).astype(np.float32),
    )


class OusterParser:
    """Feed it packets in order; it returns whole revolutions. ``rejected`` counts packets of another size."""

    def __init__(self, layout: OusterFormat) -> None:
        self._format = layout
        self._frame_id: int | None = None
        self._next_packet: int | None = None
        self.turns = TurnCollector(decoder(layout))
        self.rejected = 0

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet and the UTC ns at which it came; the revolution that ended before it, if one did."""
        layout = self._format
        if len(packet) != layout.packet_bytes:
            self.rejected += 1
            return None
        at = layout.profile.packet_header
        column = int.from_bytes(packet[at + 8 : at + 10], "little")
        frame_at = at + 10 if layout.profile_name == "LEGACY" else 2
        frame_id = int.from_bytes(packet[frame_at : frame_at + 2], "little")
        if column >= layout.columns_per_frame:
            self.rejected += 1
            return None
        index = column // layout.columns_per_packet
        packets = layout.columns_per_frame // layout.columns_per_packet
        lost = 0 if self._next_packet is None else (index - self._next_packet) % packets
        new_frame = self._frame_id is not None and frame_id != self._frame_id
        ended = self.turns.finish() if new_frame or self.turns.full else None
        degrees = 360.0 / packets
        self._frame_id, self._next_packet = frame_id, (index + 1) % packets
        self.turns.add(packet, index * degrees, (index + 1) * degrees - 1e-6, stamp_ns, lost)
        return ended

    def flush(self) -> Revolution | None:
        """What has been collected since the last revolution: the end of a recording."""
        return self.turns.finish()


def decoder(layout: OusterFormat) -> PacketDecoder:
    """For the packets of a sensor with this layout."""
    decode, per_packet = partial(_decode_packets, layout), layout.columns_per_packet * layout.beams
    return PacketDecoder(partial(TurnPoints, decode, per_packet), layout.metadata)


def decode_nothing() -> None:
    """Compile or load what decodes, before the first packet comes."""
    rays, points = np.zeros((1, 1, 3), np.float32), np.empty((1, 5), np.float32)
    _project(np.zeros((1, 1), np.uint32), np.zeros((1, 1), np.uint16), np.zeros(1, np.uint16), rays, rays, points)


def _decode_packets(layout: OusterFormat, raw: np.ndarray, points: np.ndarray) -> int:
    """(P, B) uint8 packets into points, those of the valid columns; returns of range 0 are left out."""
    p = layout.profile
    body = raw[:, p.packet_header : p.packet_header + layout.columns_per_packet * layout.column_bytes]
    columns = body.reshape(-1, layout.column_bytes)
    measurement = columns[:, 8:10].copy().view("<u2")[:, 0]
    if layout.profile_name == "LEGACY":
        valid = columns[:, -4:].copy().view("<u4")[:, 0] == 0xFFFFFFFF
    else:
        valid = (columns[:, 10] & 1).astype(bool)
    valid &= measurement < layout.columns_per_frame
    columns, measurement = columns[valid], measurement[valid]
    pixels = columns[:, p.column_header : p.column_header + layout.beams * p.pixel].reshape(-1, layout.beams, p.pixel)
    width = np.dtype(p.range_type).itemsize
    steps = pixels[..., :width].copy().view(p.range_type)[..., 0].astype(np.uint32)
    range_mm = (steps & np.uint32(p.range_mask)) * np.uint32(p.range_step_mm)
    at = p.reflectivity_at
    size = np.dtype(p.reflectivity_type).itemsize
    reflectivity = pixels[..., at : at + size].copy().view(p.reflectivity_type)[..., 0].astype(np.uint16)
    return int(_project(range_mm, reflectivity, measurement, layout.direction, layout.origin_m, points))


@kernel
def _project(range_mm, reflectivity, measurement, direction, origin_m, points):  # type: ignore[no-untyped-def]
    """Ranges (C, B) of columns ``measurement`` (C,) to points (M, 5); returns M."""
    m = 0
    for c in range(range_mm.shape[0]):
        column = measurement[c]
        for b in range(range_mm.shape[1]):
            range_m = np.float32(range_mm[c, b]) * np.float32(0.001)
            for axis in range(3):
                points[m, axis] = direction[column, b, axis] * range_m + origin_m[column, b, axis]
            points[m, 3] = min(reflectivity[c, b], 255)
            points[m, 4] = range_mm.shape[1] - 1 - b  # rings count from the lowest beam, Ouster's from the highest
            m += range_mm[c, b] > 0
    return m
