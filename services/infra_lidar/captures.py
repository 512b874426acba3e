"""Recordings of packets: pcap captures and ROS 2 bags. Bytes and rows in, (stamp, packet) out; no I/O."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

_MAGIC = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000), b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1), b"\xa1\xb2\x3c\x4d": (">", 1),
}  # fmt: skip
_ETHERNET, _LINUX_COOKED, _RAW_IP, _LOOPBACK = 1, 113, 101, 0
_HEADER_OF_LINK = {_ETHERNET: 14, _LINUX_COOKED: 16, _RAW_IP: 0, _LOOPBACK: 4, 276: 20}
_UDP = 17
_VLAN = b"\x81\x00"


class CaptureError(ValueError):
    """Not a capture we can read; the text says why."""


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram: UTC ns of its capture, destination port, payload."""

    stamp_ns: int
    port: int
    payload: bytes


def read_pcap(data: bytes) -> Iterator[Datagram]:
    """UDP over IPv4 in a classic pcap file; fragments are put together, a truncated last record is left out.

    Raises:
        CaptureError: no pcap file, or of a link layer we do not know.
    """
    if data[:4] == b"\x0a\x0d\x0d\x0a":
        raise CaptureError("this is pcapng; convert it with: editcap -F pcap IN OUT")
    if len(data) < 24 or data[:4] not in _MAGIC:
        raise CaptureError("not a pcap file")
    order, nanoseconds = _MAGIC[data[:4]]
    link = struct.unpack_from(order + "I", data, 20)[0] & 0xFFFF
    if link not in _HEADER_OF_LINK:
        raise CaptureError(f"link layer {link} is not known")
    fragments: dict[tuple[bytes, int], dict[int, bytes]] = {}
    at = 24
    while at + 16 <= len(data):
        seconds, fraction, length, _ = struct.unpack_from(order + "IIII", data, at)
        record = data[at + 16 : at + 16 + length]
        at += 16 + length
        skip = _HEADER_OF_LINK[link] + (4 if link == _ETHERNET and record[12:14] == _VLAN else 0)
        datagram = _udp(record[skip:], fragments)
        if datagram is not None:
            yield Datagram(seconds * 1_000_000_000 + fraction * nanoseconds, *datagram)


def _udp(packet: bytes, fragments: dict[tuple[bytes, int], dict[int, bytes]]) -> tuple[int, bytes] | None:
    """(port, payload) of a complete IPv4 UDP packet, else None."""
    if len(packet) < 28 or packet[0] >> 4 != 4 or packet[9] != _UDP:
        return None
    header = (packet[0] & 15) * 4
    total, identity, flags = struct.unpack_from(">HHH", packet, 2)
    body = packet[header : total or None]  # 0: the network card cut the packet, and left no length
    offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
    if offset or more:
        parts = fragments.setdefault((packet[12:20], identity), {})
        parts[offset] = body
        if not more:
            parts[-1] = (offset + len(body)).to_bytes(4, "big")
        if -1 not in parts or sum(len(p) for o, p in parts.items() if o >= 0) < int.from_bytes(parts[-1], "big"):
            if len(fragments) > 64:
                fragments.pop(next(iter(fragments)))
            return None
        del fragments[packet[12:20], identity]
        body = b"".join(parts[o] for o in sorted(o for o in parts if o >= 0))
    if len(body) < 8:
        return None
    port, length = struct.unpack_from(">HH", body, 2)
    return port, body[8 : length or None]


def read_velodyne_scan(message: bytes) -> list[tuple[int, bytes]]:
    """Packets with UTC ns of one ``velodyne_msgs/msg/VelodyneScan`` as ROS 2 serialises it (CDR, little endian).

    Raises:
        CaptureError: the message ends too early or is big endian.
    """
    if len(message) < 20 or message[1] != 1:
        raise CaptureError("not a little-endian CDR message")
    (name_length,) = struct.unpack_from("<I", message, 12)
    at = (16 + name_length + 3) // 4 * 4
    try:
        (count,) = struct.unpack_from("<I", message, at)
        packets = []
        for i in range(count):
            start = at + 4 + i * 1216  # 8 bytes of stamp, 1206 of data, 2 of padding
            seconds, nanoseconds = struct.unpack_from("<iI", message, start)
            data = message[start + 8 : start + 1214]
            if len(data) != 1206:
                raise CaptureError(f"packet {i} of {count} is cut short")
            packets.append((seconds * 1_000_000_000 + nanoseconds, data))
    except struct.error as error:
        raise CaptureError(f"truncated VelodyneScan: {error}") from error
    return packets
