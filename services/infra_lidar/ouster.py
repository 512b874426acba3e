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

from services.infra_lidar.range_image import RangeImage
from services.infra_lidar.revolutions import ImageRows, PacketDecoder, Revolution, TurnCollector, joined
from services.infra_lidar.vectors import LANES


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
        turned, aside = to_sensor[2, :2], to_sensor[:2, 3]
        if np.abs([*turned, *aside]).max() > 1e-6:
            raise MetadataError("lidar_to_sensor_transform: expected a turn about z and a shift along it")
        self.profile = _PROFILES[self.profile_name]
        p = self.profile
        self.column_bytes = p.column_header + self.beams * p.pixel + p.column_footer
        self.packet_bytes = p.packet_header + self.columns_per_packet * self.column_bytes + p.packet_footer
        encoder = 2.0 * np.pi * (1.0 - np.arange(self.columns_per_frame) / self.columns_per_frame)
        self.heading_rad = encoder + np.arctan2(to_sensor[1, 0], to_sensor[0, 0])
        self.rays = _rays(altitude, azimuth, beam_origin_m, to_sensor[2, 3] / 1000.0)


def _rays(altitude: np.ndarray, azimuth: np.ndarray, beam_origin_m: float, height_m: float) -> np.ndarray:
    """(7, B) float32 as in ``RangeImage``, with beams that do not exist until a vector is full. A range is measured
    from the lidar's origin, along the arm to the beam's and along the beam."""
    flat, none, rings = np.cos(altitude), np.zeros(len(altitude)), np.arange(len(altitude))[::-1]
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)])
    origin = np.stack([none + beam_origin_m, none, none + height_m]) - direction * beam_origin_m
    rays = np.concatenate(
        [direction, origin, rings[None]]
    )  # rings count from the lowest beam, Ouster's from the highest
    return np.pad(rays, ((0, 0), (0, -len(altitude) % LANES))).astype(np.float32)


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
    return PacketDecoder(partial(TurnImage, layout), layout.metadata)


class TurnImage:
    """The range image of the turn that is coming: a row for each valid column."""

    def __init__(self, layout: OusterFormat, packets: int = 0) -> None:
        self._layout = layout
        self._rows = ImageRows(layout.rays.shape[1], packets * layout.columns_per_packet)

    def add(self, packets: list[bytes]) -> None:
        """The next packets."""
        layout = self._layout
        measurement, range_mm, reflectivity = _columns(layout, joined(packets))
        n, beams = range_mm.shape
        room = self._rows.room(n)
        room["range_m"][:n], room["intensity"][:n], room["bank"][:n] = 0.0, 0, 0
        room["range_m"][:n, :beams] = range_mm * np.float32(0.001)
        room["intensity"][:n, :beams] = np.minimum(reflectivity, 255)
        heading_rad = layout.heading_rad[measurement]
        room["cos"][:n], room["sin"][:n] = np.cos(heading_rad), np.sin(heading_rad)
        self._rows.fill(n)

    def take(self) -> RangeImage:
        """The image; the next turn begins."""
        return self._rows.take(self._layout.rays)


def _columns(layout: OusterFormat, raw: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(P, B) uint8 packets to the valid columns: which of the turn (C,), ranges in mm and reflectivities (C, beams)."""
    p = layout.profile
    body = raw[:, p.packet_header : p.packet_header + layout.columns_per_packet * layout.column_bytes]
    columns = body.reshape(-1, layout.column_bytes)
    measurement = columns[:, 8:10].copy().view("<u2")[:, 0]
    if layout.profile_name == "LEGACY":
        valid = columns[:, -4:].copy().view("<u4")[:, 0] == 0xFFFFFFFF
    else:
        valid = (columns[:, 10] & 1).astype(bool)
    valid &= measurement < layout.columns_per_frame
    columns = columns[valid]
    pixels = columns[:, p.column_header : p.column_header + layout.beams * p.pixel].reshape(-1, layout.beams, p.pixel)
    width = np.dtype(p.range_type).itemsize
    steps = pixels[..., :width].copy().view(p.range_type)[..., 0].astype(np.uint32)
    range_mm = (steps & np.uint32(p.range_mask)) * np.uint32(p.range_step_mm)
    at = p.reflectivity_at
    size = np.dtype(p.reflectivity_type).itemsize
    return measurement[valid], range_mm, pixels[..., at : at + size].copy().view(p.reflectivity_type)[..., 0]
