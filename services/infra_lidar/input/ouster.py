"""Ouster lidar packets to revolutions, driven by the sensor's metadata. Bytes in, arrays out; no I/O.

Every packet profile of firmware 2.x and 3.x (``ouster_profiles``), one or two returns, and the geometry from the
metadata, as described in Ouster's "Firmware User Manual" v2.x/v3.x, sections "Lidar Data Format" and "Lidar Range to
XYZ".
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from services.infra_lidar.input.ouster_metadata import MetadataError, check_beams, check_transform, check_window
from services.infra_lidar.input.ouster_profiles import PACKET_TYPES, PROFILES, frame_id_at
from services.infra_lidar.input.range_image import MOST_BEAMS, RangeImage, RangeImageArrays
from services.infra_lidar.input.revolution import PacketDecoder, PacketOrder, Revolution, RevolutionAssembler
from services.infra_lidar.jit import kernel

FRAME_IDS = 1 << 16
FARTHEST_FRAMES = 10


class OusterFormat:
    """Packet layout and beam geometry of one sensor.

    Raises:
        MetadataError: the text is no metadata of a lidar, of a packet format that is not supported, or has numbers with
            which packets cannot be counted or decoded, or that no sensor has.
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
            altitude_deg = np.array(flat["beam_altitude_angles"], float).reshape(-1)
            azimuth_deg = np.array(flat["beam_azimuth_angles"], float).reshape(-1)
            beam_origin_mm = float(flat.get("lidar_origin_to_beam_origin_mm", 0.0))
            to_sensor = np.reshape(np.array(flat["lidar_to_sensor_transform"], float), (4, 4))
        except (RecursionError, KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            raise MetadataError(f"not the metadata of an Ouster lidar: {error!r}") from error
        if self.profile_name not in PROFILES:
            raise MetadataError(f"packet format {self.profile_name}; known: {', '.join(PROFILES)}")
        self._check_numbers()
        if not self.beams == len(altitude_deg) == len(azimuth_deg):
            raise MetadataError(
                f"pixels_per_column {self.beams}, but {len(altitude_deg)} beam_altitude_angles and {len(azimuth_deg)} "
                f"beam_azimuth_angles"
            )
        check_beams(altitude_deg, azimuth_deg, beam_origin_mm)
        check_transform(to_sensor)
        if layout.get("column_window") is not None:
            check_window(layout["column_window"], self.columns_per_frame)
        self.profile = PROFILES[self.profile_name]
        self.frame_id_at = frame_id_at(self.profile_name, str(layout.get("header_type", "")))
        self.packet_type = PACKET_TYPES[self.frame_id_at]
        p = self.profile
        self.packet_bytes = p.packet_bytes(self.columns_per_packet, self.beams)
        sizes = [p.packet_header, p.column_bytes(self.beams), self.columns_per_packet, p.column_header, p.pixel]
        ranges = [np.dtype(p.range_type).itemsize, p.range_mask, p.range_step_mm]
        others = [
            p.reflectivity_at,
            p.reflectivity_type == "<u2",
            p.legacy,
            p.second_range_at,
            p.second_reflectivity_at,
        ]
        self.places = np.array([*sizes, *ranges, *others], np.int64)  # for the kernel, in its order
        encoder = 2.0 * np.pi * (1.0 - np.arange(self.columns_per_frame) / self.columns_per_frame)
        heading_rad = encoder + np.arctan2(to_sensor[1, 0], to_sensor[0, 0])
        self.cos_sin = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1).astype(np.float32)
        altitude, azimuth = np.radians(altitude_deg), -np.radians(azimuth_deg)
        self.beam_geometry = _beams(altitude, azimuth, beam_origin_mm / 1000.0, to_sensor[2, 3] / 1000.0)

    def _check_numbers(self) -> None:
        """Refuse numbers with which packets cannot be counted or put into range images."""
        for name in ("columns_per_frame", "columns_per_packet"):
            if getattr(self, name) < 1:
                raise MetadataError(f"{name} {getattr(self, name)}: expected 1 or more")
        if self.columns_per_frame % self.columns_per_packet:
            raise MetadataError(
                f"columns_per_frame {self.columns_per_frame}: expected a multiple of columns_per_packet, "
                f"which is {self.columns_per_packet}"
            )
        if self.beams < 1 or MOST_BEAMS % self.beams:
            raise MetadataError(f"pixels_per_column {self.beams}: expected a number that divides {MOST_BEAMS}")


def _beams(altitude: np.ndarray, azimuth: np.ndarray, beam_origin_m: float, height_m: float) -> np.ndarray:
    """(7, B) float32 as in ``RangeImage``, from angles (B,) in radians.

    A range is measured from the lidar's origin: along the arm to the beam's own origin, then along the beam.
    """
    flat, none = np.cos(altitude), np.zeros(len(altitude))
    direction = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(altitude)])
    origin = np.stack([none + beam_origin_m, none, none + height_m]) - direction * beam_origin_m
    rings = np.arange(len(altitude))[::-1]  # counted from the lowest beam; Ouster counts from the highest
    return np.concatenate([direction, origin, rings[None]]).astype(np.float32)


class OusterParser:
    """Feed it packets; it returns whole revolutions.

    ``rejected`` counts packets of another size, ``order`` doubled and late ones.
    """

    def __init__(self, layout: OusterFormat) -> None:
        self._format = layout
        self._frame_id: int | None = None
        self._packets = layout.columns_per_frame // layout.columns_per_packet
        self.order = PacketOrder(FRAME_IDS * self._packets, FARTHEST_FRAMES * self._packets)
        self.assembler = RevolutionAssembler(decoder(layout))
        self.rejected = 0

    def accepts(self, packet: bytes) -> bool:
        """Whether the packet has the size that the metadata tell and begins as a lidar packet with a valid column."""
        sized = len(packet) == self._format.packet_bytes and packet.startswith(self._format.packet_type)
        return sized and self._column(packet) < self._format.columns_per_frame

    def _column(self, packet: bytes) -> int:
        """Of the first measurement in it."""
        at = self._format.profile.packet_header
        return int.from_bytes(packet[at + 8 : at + 10], "little")

    def feed(self, packet: bytes, stamp_ns: int) -> Revolution | None:
        """One packet and the UTC ns at which it came; the revolution that ended before it, if one did."""
        layout = self._format
        if not self.accepts(packet):
            self.rejected += 1
            return None
        frame_id = int.from_bytes(packet[layout.frame_id_at : layout.frame_id_at + 2], "little")
        index = self._column(packet) // layout.columns_per_packet
        lost = self.order.missing(frame_id * self._packets + index, 1.0)
        new_frame = self._frame_id is not None and frame_id != self._frame_id
        if lost is None or (lost < 0 and new_frame):
            return None  # a double, or so late that its revolution has ended
        ended = self.assembler.finish() if new_frame or self.assembler.room <= 0 else None
        degrees = 360.0 / self._packets
        self._frame_id = frame_id
        self.assembler.add([packet], index * degrees, (index + 1) * degrees - 1e-6, stamp_ns, lost)
        return ended

    def feed_all(self, packets: Sequence[bytes], stamps_ns: Sequence[int]) -> list[Revolution]:
        """Packets as ``feed`` takes them, one after the other; the revolutions that ended."""
        fed = (self.feed(packet, stamp_ns) for packet, stamp_ns in zip(packets, stamps_ns, strict=True))
        return [revolution for revolution in fed if revolution is not None]

    def flush(self) -> Revolution | None:
        """The revolution that has been collected so far, at the end of a recording; None if there is none."""
        return self.assembler.finish()


def smallest_format() -> OusterFormat:
    """Of a made-up sensor with one beam and one column: to compile the decoder before the real metadata are there."""
    layout = {"columns_per_frame": 1, "columns_per_packet": 1, "pixels_per_column": 1}
    angles = {"beam_altitude_angles": [0.0], "beam_azimuth_angles": [0.0]}
    return OusterFormat(json.dumps({"data_format": layout, "lidar_to_sensor_transform": np.eye(4).tolist(), **angles}))


def decoder(layout: OusterFormat) -> PacketDecoder:
    """For the packets of a sensor with this layout."""
    return PacketDecoder(partial(decode, layout), layout.metadata, "ouster")


def decode(layout: OusterFormat, raw: np.ndarray) -> RangeImage:
    """The rows of packets (P, B) uint8, one for each valid column and return.

    A second return at the range of the first is none.
    """
    p = layout.profile
    columns = len(raw) * layout.columns_per_packet
    n = columns * (1 if p.second_range_at < 0 else 2)
    range_m, intensity = np.empty((n, layout.beams), np.float32), np.empty((n, layout.beams), np.uint8)
    cos, sin, bank = np.empty(n, np.float32), np.empty(n, np.float32), np.zeros(n, np.uint8)
    rows = RangeImageArrays(range_m, intensity, cos, sin, bank, layout.beam_geometry)
    m = _decode(raw, layout.places, layout.cos_sin, rows)
    return RangeImage(range_m[:m], intensity[:m], cos[:m], sin[:m], bank[:m], layout.beam_geometry)


@kernel
def _decode(raw: np.ndarray, places: np.ndarray, cos_sin: np.ndarray, rows: RangeImageArrays) -> int:
    """Write packets (P, B) uint8 to rows, one for each valid column and return; returns the number of rows.

    places: ``OusterFormat.places``. cos_sin: (columns of a frame, 2) float32.
    """
    first, size, count, header, pixel, range_bytes, mask = places[:7]
    step_m = np.float32(places[7]) * np.float32(0.001)
    reflectivity_at, wide, legacy, second_at, second_reflectivity_at = places[8:]
    m = 0
    for p in range(raw.shape[0]):
        for c in range(count):
            at = first + c * size
            column, end = raw[p, at + 8] + 256 * raw[p, at + 9], at + size
            if legacy:
                valid = raw[p, end - 4] & raw[p, end - 3] & raw[p, end - 2] & raw[p, end - 1] == 0xFF
            else:
                valid = raw[p, at + 10] & 1 == 1
            if not valid or column >= cos_sin.shape[0]:
                continue
            for second in range(1 if second_at < 0 else 2):
                rows.cos[m], rows.sin[m] = cos_sin[column, 0], cos_sin[column, 1]
                for k in range(rows.range_m.shape[1]):
                    byte = at + header + k * pixel
                    of_range = byte + (second_at if second else 0)
                    steps = np.int64(raw[p, of_range]) | np.int64(raw[p, of_range + 1]) << 8
                    if range_bytes == 4:
                        steps |= np.int64(raw[p, of_range + 2]) << 16
                    range_m = np.float32(steps & mask) * step_m
                    again = second == 1 and range_m == rows.range_m[m - 1, k]
                    rows.range_m[m, k] = np.float32(0.0) if again else range_m
                    of_reflectivity = byte + (second_reflectivity_at if second else reflectivity_at)
                    over = wide and raw[p, of_reflectivity + 1] > 0
                    rows.intensity[m, k] = 255 if over else raw[p, of_reflectivity]
                m += 1
    return m
