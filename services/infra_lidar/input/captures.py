"""Recordings of packets: pcap and pcapng captures. Streams in, datagrams out.

The container is read by dpkt; from the link layer on it is done here, because captures of lidars come over VLANs, from
``-i any`` (Linux cooked) and in IP fragments.
"""

from __future__ import annotations

import gzip
import logging
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from ipaddress import ip_address
from typing import BinaryIO, cast

import dpkt

log = logging.getLogger(__name__)

# What dpkt and gzip raise on bytes that are damaged or end too early.
_DAMAGE = (ValueError, dpkt.Error, struct.error, EOFError, OSError, zlib.error)
# Link layers by their number (pcap-linktype(7)): where the EtherType stands, and where the packet begins.
_ETHER_TYPE_AT = {1: (12, 14), 113: (14, 16), 276: (0, 20)}
_BARE_IP_AT = {0: 4, 12: 0, 14: 0, 101: 0, 228: 0, 229: 0}
_VLAN_TYPES = (0x8100, 0x88A8, 0x9100)
_UDP, _IPV6_FRAGMENT = 17, 44
_MAX_FRAGMENTED = 64  # packets that wait for the rest of their fragments


class CaptureError(ValueError):
    """A capture that cannot be read; the text says why."""


@dataclass(frozen=True)
class Datagram:
    """One UDP datagram: UTC ns of its capture, sender's address, destination port, payload."""

    stamp_ns: int
    sender: str
    port: int
    payload: bytes


def read_capture(stream: BinaryIO) -> Iterator[Datagram]:
    """UDP over IPv4 or IPv6 in a pcap or pcapng file, gzipped or not; fragments are joined.

    What follows damaged bytes, or a cut, is left out, and the log says so. The stream is read as the datagrams are
    taken, so memory does not grow with it.

    Raises:
        CaptureError: no capture, damaged at its very beginning, or of an unknown link layer.
    """
    try:
        if stream.read(2) == b"\x1f\x8b":
            stream.seek(0)
            stream = cast(BinaryIO, gzip.GzipFile(fileobj=stream))
        stream.seek(0)
        reader = dpkt.pcap.UniversalReader(stream)
    except _DAMAGE as error:
        raise CaptureError(f"no pcap or pcapng capture, or a damaged one ({_words(error)})") from None
    link = reader.datalink()
    if link not in _ETHER_TYPE_AT and link not in _BARE_IP_AT:
        raise CaptureError(f"link layer {link} is not known")
    fragments = Fragments()
    for stamp_s, frame in _records(reader, str(getattr(stream, "name", "capture"))):
        datagram = _udp(_network_packet(link, frame), fragments)
        if datagram is not None:
            yield Datagram(round(stamp_s * 1_000_000_000), *datagram)


def _records(reader: dpkt.pcap.Reader, name: str) -> Iterator[tuple[float, bytes]]:
    """What the container holds, up to where it is cut or damaged."""
    records, count = iter(reader), 0
    while True:
        try:
            record = next(records)
        except StopIteration:
            return
        except _DAMAGE as error:
            log.warning("%s: cut or damaged behind packet %d (%s); the rest is left out", name, count, _words(error))
            return
        count += 1
        yield record


def _words(error: Exception) -> str:
    """What an error says; its type where it says nothing."""
    return str(error) or type(error).__name__


def _network_packet(link: int, frame: bytes) -> bytes:
    """The IP packet in a frame of the link layer, behind any number of VLAN tags; empty if there is none."""
    if link in _BARE_IP_AT:
        return frame[_BARE_IP_AT[link] :]
    type_at, at = _ETHER_TYPE_AT[link]
    ether_type = int.from_bytes(frame[type_at : type_at + 2], "big")
    while ether_type in _VLAN_TYPES:
        ether_type = int.from_bytes(frame[at + 2 : at + 4], "big")
        at += 4
    return frame[at:] if ether_type in (0x0800, 0x86DD) else b""


class Fragments:
    """IP packets that came in parts, until the last part is there; the oldest are given up when there are too many."""

    def __init__(self) -> None:
        self._parts: dict[tuple[bytes, int], dict[int, bytes]] = {}
        self._length: dict[tuple[bytes, int], int] = {}

    def add(self, key: tuple[bytes, int], offset: int, more: bool, part: bytes) -> bytes | None:
        """One part at its offset; the whole when it is complete, else None."""
        parts = self._parts.setdefault(key, {})
        parts[offset] = part
        if not more:
            self._length[key] = offset + len(part)
        if key in self._length and sum(map(len, parts.values())) >= self._length[key]:
            self._forget(key)
            return b"".join(parts[at] for at in sorted(parts))
        if len(self._parts) > _MAX_FRAGMENTED:
            self._forget(next(iter(self._parts)))
        return None

    def _forget(self, key: tuple[bytes, int]) -> None:
        self._parts.pop(key)
        self._length.pop(key, None)


def _udp(packet: bytes, fragments: Fragments) -> tuple[str, int, bytes] | None:
    """(sender, port, payload) of a complete UDP packet, else None."""
    version = packet[0] >> 4 if packet else 0
    body = _ipv4(packet, fragments) if version == 4 else _ipv6(packet, fragments) if version == 6 else None
    if body is None or len(body) < 8:
        return None
    port, length = struct.unpack_from(">HH", body, 2)
    sender = packet[12:16] if version == 4 else packet[8:24]
    return str(ip_address(sender)), port, body[8 : length or None]


def _ipv4(packet: bytes, fragments: Fragments) -> bytes | None:
    if len(packet) < 28 or packet[9] != _UDP:
        return None
    total, identity, flags = struct.unpack_from(">HHH", packet, 2)
    body = packet[(packet[0] & 15) * 4 : total or None]  # 0: the network card cut the packet, and left no length
    offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
    return fragments.add((packet[12:20], identity), offset, more, body) if offset or more else body


def _ipv6(packet: bytes, fragments: Fragments) -> bytes | None:
    if len(packet) < 48:
        return None
    length, following = struct.unpack_from(">HB", packet, 4)
    body = packet[40 : 40 + length if length else None]
    if following == _UDP:
        return body
    if following != _IPV6_FRAGMENT or len(body) < 8 or body[0] != _UDP:
        return None
    flags, identity = struct.unpack_from(">HI", body, 2)
    return fragments.add((packet[8:40], identity), flags & 0xFFF8, bool(flags & 1), body[8:])
