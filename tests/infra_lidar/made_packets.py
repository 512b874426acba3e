"""Packets of a Velodyne VLS-128 and of an Ouster, built byte by byte."""

import json
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np


def vls_packet(azimuth_deg, steps=2500, time_us=0, mode=0x37, product=0xA1, flags=(0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)):
    """Three firing sequences of all lasers at the same distance, the head 0.2 degrees on each time."""
    blocks = b""
    for block in range(12):
        azimuth = round((azimuth_deg + 0.2 * (block // 4)) * 100) % 36000
        blocks += struct.pack("<HH", flags[block % 4], azimuth) + struct.pack("<HB", steps, 77) * 32
    return blocks + struct.pack("<IBB", time_us, mode, product)


def revolutions_of(parser, first_deg=0.0, **how):
    """Feed a whole revolution; the revolutions that came out."""
    done = [parser.feed(vls_packet((first_deg + 0.6 * k) % 360, time_us=166 * k, **how), k) for k in range(610)]
    return [revolution for revolution in done if revolution is not None]


def metadata(profile="RNG19_RFL8_SIG16_NIR16", columns=64, beams=4, **change):
    document = {
        "beam_altitude_angles": [20.0, 0.0, -10.0, -20.0], "beam_azimuth_angles": [0.0, 0.0, 0.0, 0.0],
        "lidar_origin_to_beam_origin_mm": 0.0, "lidar_to_sensor_transform": np.eye(4).ravel().tolist(),
        "data_format": {
            "columns_per_frame": columns, "columns_per_packet": 16, "pixels_per_column": beams,
            "udp_profile_lidar": profile,
        },
    }  # fmt: skip
    return json.dumps(document | change)


def ouster_packet(layout, frame_id, first_column, range_mm=8000, valid=1):
    p = layout.profile
    head = struct.pack("<HH", 1, frame_id).ljust(p.packet_header, b"\0") if p.packet_header else b""
    body = b""
    for column in range(first_column, first_column + 16):
        if layout.profile_name == "LEGACY":
            body += struct.pack("<QHHI", 0, column, frame_id, 0)
        else:
            body += struct.pack("<QHH", 0, column, valid)
        step = range_mm // p.range_step_mm
        pixel = bytearray(p.pixel)
        pixel[: 2 if p.range_type == "<u2" else 3] = step.to_bytes(2 if p.range_type == "<u2" else 3, "little")
        pixel[p.reflectivity_at] = 0x32
        body += bytes(pixel) * layout.beams
        if layout.profile_name == "LEGACY":
            body += struct.pack("<I", 0xFFFFFFFF if valid else 0)
    return head + body + bytes(p.packet_footer)


@contextmanager
def sending(packets: Sequence[bytes], port: int) -> Iterator[None]:
    """Send the packets to a UDP port of this machine, over and over."""
    ended = threading.Event()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not ended.is_set():
                for at in range(0, len(packets), 20):  # in bursts that the receiver's buffer holds
                    for packet in packets[at : at + 20]:
                        sender.sendto(packet, ("127.0.0.1", port))
                    ended.wait(0.002)

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
