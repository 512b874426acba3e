"""Packets of each sensor to a range image: time for a revolution at 10 Hz, and for the rest after its last packet.

Packets are made here, with random ranges. The plain version reads one packet field by field with ``struct``.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable

import numpy as np

from services.infra_lidar.input import hesai, hesai_calibration, robosense, velodyne
from services.infra_lidar.input.models import KINDS
from services.infra_lidar.input.ouster import OusterFormat
from services.infra_lidar.input.revolution import PacketDecoder, batch_of, decode_revolution

RNG = np.random.default_rng(1)
REPEATS = 30
Revolution = tuple[np.ndarray, PacketDecoder, Callable[[bytes], int]]


def vls128() -> Revolution:
    """600 packets of three firing sequences."""
    raw = RNG.integers(1, 200, (600, velodyne.PACKET_BYTES)).astype(np.uint8)
    for block in range(velodyne.BLOCKS):
        azimuth = 60 * np.arange(600) + 20 * (block // 4)
        raw[:, 100 * block : 100 * block + 4] = _columns([0xFF, 0xEE - 0x11 * (block % 4), azimuth & 255, azimuth >> 8])
    raw[:, 1204:] = 0x37, 0xA1
    return raw, velodyne.DECODER, lambda packet: _plain(packet, "<HB", range(4, 1204, 100), 32)


def pandar128() -> Revolution:
    """1800 columns of 128 channels, two a packet, one return."""
    template = np.frombuffer(hesai.silent_packet(), np.uint8)
    raw = np.tile(template, (900, 1))
    body = raw[:, hesai.BODY_AT : hesai.BODY_AT + 2 * 386].reshape(900, 2, 386)
    body[...] = RNG.integers(1, 200, body.shape)
    azimuth = 20 * np.arange(1800).reshape(900, 2)
    body[..., 0], body[..., 1] = azimuth & 255, azimuth >> 8
    tail = hesai.BODY_AT + 2 * 386 + 4
    raw[:, tail + 11 : tail + 15] = 2, 0x37, 88, 2  # standard, strongest, 600 rpm
    decoder = KINDS["hesai"].decoder(hesai_calibration.unknown_angles())
    return raw, decoder, lambda packet: _plain(packet, "<HB", (14, 400), 128)


def ruby_plus() -> Revolution:
    """1800 columns of 128 channels, three a packet, one return."""
    raw = RNG.integers(1, 200, (600, robosense.PACKET_BYTES)).astype(np.uint8)
    raw[:, :4] = list(robosense.MSOP)
    raw[:, 31:33] = 5, 1
    for block, at in enumerate(robosense.BLOCKS_AT):
        azimuth = 60 * np.arange(600) + 20 * block
        raw[:, at : at + 4] = _columns([robosense.BLOCK_FLAG, 1, azimuth >> 8, azimuth & 255])
    decoder = KINDS["robosense"].decoder(robosense.unknown_angles())
    return raw, decoder, lambda packet: _plain(packet, ">HB", (84, 472, 860), 128)


def ouster(profile: str) -> Revolution:
    """2048 columns of 128 beams, 16 a packet."""
    document = {
        "beam_altitude_angles": np.linspace(20, -20, 128).tolist(),
        "beam_azimuth_angles": [0.0] * 128,
        "lidar_to_sensor_transform": np.eye(4).ravel().tolist(),
        "data_format": {
            "columns_per_frame": 2048,
            "columns_per_packet": 16,
            "pixels_per_column": 128,
            "udp_profile_lidar": profile,
        },
    }
    layout = OusterFormat(json.dumps(document))
    p = layout.profile
    raw = RNG.integers(1, 200, (128, layout.packet_bytes)).astype(np.uint8)
    column_bytes = p.column_bytes(layout.beams)
    body = raw[:, p.packet_header : p.packet_header + 16 * column_bytes].reshape(128, 16, column_bytes)
    number = np.arange(2048).reshape(128, 16)
    body[..., 8:11] = _columns([number & 255, number >> 8, 1])
    if p.legacy:
        body[..., -4:] = 0xFF  # valid
    starts = [p.packet_header + p.column_header + k * column_bytes for k in range(16)]
    pattern = "<IB" if p.pixel > 4 else "<HB"
    decoder = KINDS["ouster"].decoder(layout.metadata)
    return raw, decoder, lambda packet: _plain(packet, pattern, starts, 128, p.pixel)


def _columns(values: list[int | np.ndarray]) -> np.ndarray:
    """(n, K) uint8 of K columns, scalars repeated."""
    return np.stack(np.broadcast_arrays(*values), axis=-1).astype(np.uint8)


def _plain(packet: bytes, pattern: str, starts: range | tuple[int, ...] | list[int], count: int, size: int = 0) -> int:
    """Read every range and reflectivity of a packet; how many there are."""
    fields, found = struct.Struct(pattern), []
    for at in starts:
        for k in range(count):
            steps, reflectivity = fields.unpack_from(packet, at + k * (size or fields.size))
            found.append((steps * 0.004, reflectivity))
    return len(found)


def best_ms(run: Callable[[], object]) -> float:
    """Processor time of the fastest of some runs."""
    times = []
    for _ in range(REPEATS):
        started_ns = time.thread_time_ns()
        run()
        times.append((time.thread_time_ns() - started_ns) / 1e6)
    return min(times)


def measure(name: str, revolution: Revolution) -> None:
    """Print a line."""
    raw, decoder, plain = revolution
    image = decode_revolution(raw, decoder)
    whole_ms = best_ms(lambda: decode_revolution(raw, decoder))
    batch = batch_of(raw.shape[1])
    rest = len(raw) % batch or min(batch, len(raw))
    last_ms = best_ms(lambda: decoder.decode(raw[-rest:]))
    packet = raw[0].tobytes()
    plain_ms = best_ms(lambda: plain(packet)) * len(raw)
    print(
        f"{name:34} {len(raw):5} packets {len(image):7} ranges  {whole_ms:6.2f} ms, after the last packet "
        f"{last_ms:5.2f} ms; plain {plain_ms:6.0f} ms, {plain_ms / whole_ms:4.0f} times"
    )


def main() -> None:
    """All sensors."""
    measure("Velodyne VLS-128", vls128())
    measure("Hesai Pandar128 / OT128", pandar128())
    measure("RoboSense Ruby Plus", ruby_plus())
    for profile in ("LEGACY", "RNG19_RFL8_SIG16_NIR16", "RNG15_RFL8_NIR8", "RNG19_RFL8_SIG16_NIR16_DUAL"):
        measure(f"Ouster {profile}", ouster(profile))


if __name__ == "__main__":
    main()
