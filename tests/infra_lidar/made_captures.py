"""Captures built byte by byte: UDP over IPv4 and IPv6, on several link layers, in pcap and pcapng."""

from __future__ import annotations

import struct

ETHERNET, COOKED, COOKED2 = 1, 113, 276


def udp(payload: bytes, port: int = 2368) -> bytes:
    return struct.pack(">HHHH", 9, port, len(payload) + 8, 0) + payload


def ipv4(payload: bytes, sender: str = "192.168.1.201", port: int = 2368) -> bytes:
    body = udp(payload, port)
    address = bytes(map(int, sender.split(".")))
    return struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(body), 1, 0, 64, 17, 0, address, b"\xff" * 4) + body


def ipv6(body: bytes, following: int = 17) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), following, 64) + bytes(15) + b"\x01" + bytes(16) + body


def ethernet(packet: bytes, tags: tuple[int, ...] = ()) -> bytes:
    kind = struct.pack(">H", 0x86DD if packet[0] >> 4 == 6 else 0x0800)
    vlan = b"".join(struct.pack(">HH", tag, 7) for tag in tags)
    return bytes(12) + vlan + kind + packet


def cooked(packet: bytes, tags: tuple[int, ...] = ()) -> bytes:
    types = [*tags, 0x0800]
    inner = b"".join(struct.pack(">HH", 7, following) for following in types[1:])
    return bytes(14) + struct.pack(">H", types[0]) + inner + packet


def pcap(*frames: bytes, link: int = ETHERNET, order: str = "<", nanoseconds: bool = False) -> bytes:
    data = struct.pack(order + "IHHIIII", 0xA1B23C4D if nanoseconds else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for number, frame in enumerate(frames):
        data += struct.pack(order + "IIII", 100 + number, 5, len(frame), len(frame)) + frame
    return data


def pcapng(*frames: bytes, link: int = ETHERNET, order: str = "<") -> bytes:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        length = struct.pack(order + "I", len(body) + 12)
        return struct.pack(order + "I", kind) + length + body + length

    data = block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))
    data += block(1, struct.pack(order + "HHI", link, 0, 65535))
    for number, frame in enumerate(frames):
        stamp = (100 + number) * 1_000_000 + 5
        head = struct.pack(order + "IIIII", 0, stamp >> 32, stamp & 0xFFFFFFFF, len(frame), len(frame))
        data += block(6, head + frame)
    return data
